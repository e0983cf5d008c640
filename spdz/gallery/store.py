"""The ledger's file: an SQLite data base in which every durable step is one transaction.

::

    record   one row: the mark (spdz.gallery.mark) as of the last step
    slots    owner << 32 | slot, SHA-256 of eps (NULL: void), note, eps
    strips   number, rows and columns from and to, results (NULL: burnt)

Write-ahead log with ``synchronous=FULL``: a commit appends to ``NAME-wal`` and syncs that, once; when it
returns, the step is on the disk. From 1,000 pages (4 MB) on, the log is written back into the file, which is
synced before the log begins anew ("Write-Ahead Logging", sections 2.1 and 3.2). Closing writes back all, so
that at rest the file alone is whole. While it is open ``NAME-wal`` and ``NAME-shm`` are there as well, with
the file's mode, and another process may read with ``mode=ro``. The file without a log that was not written
back is an older ledger, and so is one whose log ends in a torn step: the mark notices. Notes and results
carry a checksum that binds them to their place; slots are held by the record's heads.

A fork waits until no ledger of this process is at work, so that the child finds SQLite whole when it opens
its own. The child never closes what it has inherited ("How To Corrupt An SQLite Database File", section 2.6):
when the parent has let go of the file, SQLite would delete the log by its name, a later process's, with all
that is in it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Any, TypeAlias
from weakref import WeakSet

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery.mark import Mark
from spdz.gallery.strip import Strip
from spdz.tape.durable import create_private, sync, sync_folder

AT_WORK = Lock()
"""Held while any ledger of this process is at work, and across a fork."""

_OPEN: WeakSet[Store] = WeakSet()


def _keep_in_child() -> None:
    """Have a forked child never close the parent's connections, not even when it ends."""
    for store in _OPEN:
        store.keep()
    AT_WORK.release()


os.register_at_fork(before=AT_WORK.acquire, after_in_parent=AT_WORK.release, after_in_child=_keep_in_child)

Change: TypeAlias = tuple[str, Sequence[tuple[object, ...]]]
"""An SQL statement and the rows to run it with."""

_APPLICATION = 0x73706C67  # "splg"
_DIGEST = 16
_LOG_PAGES, _PAGE = 1000, 4096
_SETTINGS = (
    "synchronous=FULL",
    "fullfsync=ON",  # as durable.sync on macOS
    f"wal_autocheckpoint={_LOG_PAGES}",
    f"journal_size_limit={_LOG_PAGES * _PAGE}",
)
_TABLES = (
    "CREATE TABLE record (id INTEGER PRIMARY KEY CHECK (id = 0), mark BLOB NOT NULL)",
    "CREATE TABLE slots (key INTEGER PRIMARY KEY, digest BLOB, note BLOB, eps BLOB)",
    "CREATE TABLE strips (number INTEGER PRIMARY KEY, row INTEGER NOT NULL, row_end INTEGER NOT NULL, "
    "col INTEGER NOT NULL, col_end INTEGER NOT NULL, results BLOB)",
)


class Store:
    """An open ledger file; for one thread at a time.

    Args:
        path: The file; created with mode 0600 if missing.
        first: The record of a ledger that was never used, for a new file.

    Raises:
        sqlite3.Error: SQLite refuses.
        OSError: The file cannot be created.
    """

    def __init__(self, path: Path, first: Mark) -> None:
        self.path = path
        with suppress(FileExistsError):
            os.close(create_private(path))
            sync_folder(path.parent)
        _sync_log(path)
        self._base = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        try:
            for setting in _SETTINGS:
                self.all(f"PRAGMA {setting}")
            tables = self.all("SELECT count(*) FROM sqlite_master")  # finishes an interrupted commit
            if self._journal_mode() != "wal":  # new, or stopped before it was
                self._journal_mode("TRUNCATE")  # unlike DELETE durable when a commit returns (pager.c)
            if path.stat().st_size == 0:
                with self._transaction():
                    for statement in (f"PRAGMA application_id={_APPLICATION}", *_TABLES):
                        self._base.execute(statement)
                    self._base.execute("INSERT INTO record VALUES (0, ?)", [first.encode()])
            elif tables == [(0,)] or self.all("PRAGMA application_id") != [(_APPLICATION,)]:
                raise sqlite3.DatabaseError("another application's data base")
            if self._journal_mode("WAL") != "wal":
                raise sqlite3.OperationalError("its file system has no shared memory for a write-ahead log")
        except BaseException:
            self._base.close()
            raise
        _OPEN.add(self)

    def all(self, query: str, *values: object) -> list[Any]:
        """All rows of a query: a cursor left half read would keep a lock on the file."""
        return self._base.execute(query, values).fetchall()

    def record(self) -> Mark:
        """The mark as of the last step.

        Raises:
            ValueError: It is not whole.
        """
        rows = self.all("SELECT mark FROM record")
        return Mark.decode(rows[0][0] if rows else b"")

    def store(self, mark: Mark, changes: Iterable[Change]) -> None:
        """One step: all of it is on the disk on return, or none."""
        with self._transaction():
            for statement, rows in changes:
                self._base.executemany(statement, rows)
            self._base.execute("UPDATE record SET mark = ?", [mark.encode()])

    def keep(self) -> None:
        """Never close the connection in this process, not even when nothing refers to it any more."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._base))

    def close(self) -> None:
        """Close the file; the log is written back first, also while another process reads."""
        with suppress(sqlite3.Error):  # closed, or the disk fails: what the log has is durable there
            self.all("PRAGMA wal_checkpoint(TRUNCATE)")
        self._base.close()

    def _journal_mode(self, wanted: str = "") -> str:
        return str(self.all(f"PRAGMA journal_mode{wanted and f'={wanted}'}")[0][0])

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._base.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._base.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._base.execute("ROLLBACK")
            raise


def _sync_log(path: Path) -> None:
    """A killed process may have left steps in the log that the disk has not, and SQLite believes them."""
    log = path.with_name(f"{path.name}-wal")
    with suppress(FileNotFoundError):
        descriptor = os.open(log, os.O_RDWR | os.O_CLOEXEC)
        try:
            sync(descriptor)
        finally:
            os.close(descriptor)
        sync_folder(path.parent)


def slot_key(owner: int, slot: int) -> int:
    """Where a slot is among both parties' slots."""
    return owner << 32 | slot


def strip_row(strip: Strip, results: bytes | None) -> tuple[object, ...]:
    """A row of ``strips`` but for its number."""
    where = strip.rows.start, strip.rows.stop, strip.columns.start, strip.columns.stop
    return *where, None if results is None else sealed(results, f"strip {strip}")


def sealed(data: bytes, where: str) -> bytes:
    """Bytes after a checksum that binds them to their place."""
    return hashlib.blake2b(where.encode() + b"\0" + data, digest_size=_DIGEST).digest() + data


def unsealed(stored: bytes, where: str) -> bytes:
    """The bytes that :func:`sealed` was given.

    Raises:
        ValueError: The checksum does not hold.
    """
    data = stored[_DIGEST:]
    if sealed(data, where) != stored:
        raise ValueError(f"the checksum of {where} does not hold")
    return data


class LedgerDamage(Exception):
    """What a ledger holds is not whole; the message says where."""


@contextmanager
def damage() -> Iterator[None]:
    """What does not fit together in here is damage of the ledger."""
    try:
        yield
    except ValueError as error:
        raise LedgerDamage(str(error)) from error


@contextmanager
def disk_errors(path: Path, mark: Path) -> Iterator[None]:
    """Give what fails in a ledger at ``path``, whose mark is at ``mark``, the name of its error."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise TapeError(
            f"{path}: the ledger could not be read or written ({reason}). Nothing was sent; "
            "see that the disk works and has room, and open it again"
        ) from error
    except (sqlite3.DatabaseError, LedgerDamage) as error:
        if mark.exists():
            way_out = (
                f"Move it away and open the gallery again: what its mark {mark} remembers stays used, and "
                "the slots that are left can be filled"
            )
        else:
            way_out = "Deal new tapes for both robots"
        raise TapeDamaged(f"{path}: the ledger is damaged ({error}). {way_out}") from error
