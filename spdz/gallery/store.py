"""The ledger's file: an SQLite data base in which every durable step is one transaction.

::

    record   one row: the mark (spdz.gallery.mark) as of the last step
    slots    owner << 32 | slot, SHA-256 of eps (NULL: void), note, eps
    strips   number, rows and columns from and to, results (NULL: burnt)

Rollback journal, truncated at each commit, with ``synchronous=FULL``: when a commit returns, the pages are on
the disk, and so is the journal's new length (SQLite's pager syncs it, ``pager_end_transaction``; Mozilla bug
1072773). Unlike a write-ahead log it leaves one file at rest, which is copied whole, and no lock in the
connection that a fork would take along. Notes and results carry a checksum that binds them to their place;
slots are held by the record's heads.

SQLite must not be forked inside a transaction ("How To Corrupt An SQLite Database File", section 2.6): the
child would roll the parent's back when it ends. So a fork waits until no ledger of this process is at work.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Any, TypeAlias

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery.mark import Mark
from spdz.gallery.strip import Strip
from spdz.tape.durable import create_private, sync_folder

AT_WORK = Lock()
"""Held while any ledger of this process is at work, and across a fork."""

os.register_at_fork(before=AT_WORK.acquire, after_in_parent=AT_WORK.release, after_in_child=AT_WORK.release)

Change: TypeAlias = tuple[str, Sequence[tuple[object, ...]]]
"""An SQL statement and the rows to run it with."""

_APPLICATION = 0x73706C67  # "splg"
_DIGEST = 16
_SETTINGS = (
    "journal_mode=TRUNCATE",
    "synchronous=FULL",
    "fullfsync=ON",
)  # fullfsync: as durable.sync on macOS
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
        self._base = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        try:
            for setting in _SETTINGS:
                self.all(f"PRAGMA {setting}")
            tables = self.all("SELECT count(*) FROM sqlite_master")  # finishes an interrupted commit
            if path.stat().st_size == 0:
                with self._transaction():
                    for statement in (f"PRAGMA application_id={_APPLICATION}", *_TABLES):
                        self._base.execute(statement)
                    self._base.execute("INSERT INTO record VALUES (0, ?)", [first.encode()])
            elif tables == [(0,)] or self.all("PRAGMA application_id") != [(_APPLICATION,)]:
                raise sqlite3.DatabaseError("another application's data base")
        except BaseException:
            self._base.close()
            raise

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

    def close(self) -> None:
        """Close the file."""
        self._base.close()

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
