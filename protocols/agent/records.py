"""An agent's durable records: one SQLite file beside its tapes, in which every step is one transaction.

::

    keyframes   number, stamp, payload
    vectors     gallery, keyframe, vector and a digest of it as quantised, in the order in which they came
    links       a peer and a gallery
    slots       link, own slot: the keyframe in it
    matches     link, own slot, the peer's slot: keyframe, state, verdicts
    promised    link, the peer's slot: a digest of what the peer will show of it
    opened      link, the peer's slot: what the peer has shown of it, kept as evidence
    news        number: a match and the state that it reached
    strikes     peer, match, why, when
    about       name, value

What was compared is in the galleries' ledgers and nowhere else; what stands here is read from there again
after a crash. The records hold this robot's own descriptors and payloads, and what peers showed: mode 0600.
"""

from __future__ import annotations

import os
import sqlite3
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spdz.tape.durable import create_private, sync_folder

FILE = "agent.db"
_SETTINGS = ("busy_timeout=500", "locking_mode=EXCLUSIVE", "journal_mode=WAL", "synchronous=FULL")
_APPLICATION = 0x73706167  # "spag"
_SCHEMA = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE keyframes (id INTEGER PRIMARY KEY, stamp REAL, payload BLOB NOT NULL);
CREATE TABLE vectors (
    place INTEGER PRIMARY KEY AUTOINCREMENT, gallery TEXT NOT NULL, keyframe INTEGER NOT NULL,
    digest BLOB NOT NULL, vector BLOB NOT NULL, UNIQUE (gallery, keyframe)
);
CREATE TABLE links (
    link INTEGER PRIMARY KEY AUTOINCREMENT, peer TEXT NOT NULL, gallery TEXT NOT NULL, UNIQUE (peer, gallery)
);
CREATE TABLE slots (
    link INTEGER NOT NULL, slot INTEGER NOT NULL, keyframe INTEGER, PRIMARY KEY (link, slot)
);
CREATE TABLE matches (
    match INTEGER PRIMARY KEY AUTOINCREMENT, link INTEGER NOT NULL, slot INTEGER NOT NULL,
    peer_slot INTEGER NOT NULL, keyframe INTEGER, state TEXT NOT NULL, why TEXT NOT NULL DEFAULT '',
    transform TEXT, weight REAL, peer_state TEXT, told INTEGER NOT NULL DEFAULT 0,
    shown INTEGER NOT NULL DEFAULT 0,
    UNIQUE (link, slot, peer_slot)
);
CREATE TABLE promised (
    link INTEGER NOT NULL, slot INTEGER NOT NULL, digest TEXT NOT NULL, PRIMARY KEY (link, slot)
);
CREATE TABLE opened (
    link INTEGER NOT NULL, slot INTEGER NOT NULL, keyframe INTEGER, stamp REAL, vector BLOB NOT NULL,
    payload BLOB NOT NULL, PRIMARY KEY (link, slot)
);
CREATE TABLE news (
    number INTEGER PRIMARY KEY AUTOINCREMENT, match INTEGER NOT NULL, state TEXT NOT NULL,
    UNIQUE (match, state)
);
CREATE TABLE strikes (
    number INTEGER PRIMARY KEY AUTOINCREMENT, peer TEXT NOT NULL, match INTEGER UNIQUE, why TEXT NOT NULL,
    at REAL NOT NULL
);
"""
_TABLES = tuple(statement for statement in _SCHEMA.split(";") if statement.strip())


class RecordsError(OSError):
    """An agent's records cannot be read or written; nothing was lost that was told before."""


class Records:
    """The open file; any thread may use it.

    Args:
        folder: The robot's folder.
        mission: The mission's id: records of another mission are refused.

    Raises:
        RecordsError: if the file is damaged, foreign, of another mission or cannot be made.
    """

    def __init__(self, folder: Path, mission: str) -> None:
        self.path = folder / FILE
        self._lock = threading.RLock()
        with self._errors():
            with suppress(FileExistsError):
                os.close(create_private(self.path))
                sync_folder(folder)
            self._base = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False)
        self._close = weakref.finalize(self, self._base.close)
        try:
            with self._errors():
                self._prepare(mission)
        except BaseException:
            self._close()
            raise

    def _prepare(self, mission: str) -> None:
        for setting in _SETTINGS:
            self._base.execute(f"PRAGMA {setting}")
        if not self.all("SELECT name FROM sqlite_master"):
            with self.transaction():
                for statement in (f"PRAGMA application_id={_APPLICATION}", *_TABLES):
                    self._base.execute(statement)
                self.run("INSERT INTO about VALUES ('mission', ?)", mission)
        if self.all("PRAGMA application_id") != [(_APPLICATION,)]:
            raise sqlite3.DatabaseError("it is another application's data base")
        if self.all("SELECT value FROM about WHERE name = 'mission'") != [(mission,)]:
            raise sqlite3.DatabaseError("it is of another mission: move it away, or give the right folder")

    def link(self, peer: str, gallery: str) -> int:
        """The number of a gallery with a peer."""
        with self.transaction():
            self.run("INSERT OR IGNORE INTO links (peer, gallery) VALUES (?, ?)", peer, gallery)
            return int(self.all("SELECT link FROM links WHERE peer = ? AND gallery = ?", peer, gallery)[0][0])

    def all(self, query: str, *values: object) -> list[Any]:
        """All rows of a query."""
        with self._errors():
            return self._base.execute(query, values).fetchall()

    def run(self, statement: str, *values: object) -> int:
        """Run a statement; returns how many rows it changed."""
        with self._errors():
            return self._base.execute(statement, values).rowcount

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """What happens within it is durable together, or did not happen; may be nested."""
        with self._lock, self._errors():
            if self._base.in_transaction:
                yield
                return
            self._base.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._base.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):
                    self._base.execute("ROLLBACK")
                raise

    def close(self) -> None:
        """Close the file; safe to call twice."""
        with self._lock:
            self._close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        with self._lock:
            try:
                yield
            except (sqlite3.Error, OSError) as error:
                if isinstance(error, RecordsError):
                    raise
                if "locked" in str(error):
                    raise RecordsError(
                        f"another agent works in {self.path.parent}: stop that one first"
                    ) from error
                raise RecordsError(f"the agent's records {self.path} cannot be used: {error}") from error
