"""A ledger's file and its mark, moved on together one durable step after another.

A step is stored in the file, then in the mark, and then the call returns. Opening brings the two together,
and sees that what the file holds fits its record: heads, void slots, notes, and strips that make up the
rectangle. It reads 32 bytes a slot, none of what was sent.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError, TapeInUse, TapeMismatch
from spdz.gallery.heads import extended, first_head
from spdz.gallery.mark import MAX_TEXT, Mark
from spdz.gallery.mark_file import MarkFile
from spdz.gallery.recovery import Digests, check_ahead, recovery
from spdz.gallery.runs import joined, runs_of
from spdz.gallery.store import AT_WORK, Change, Store, damage, disk_errors, slot_key, strip_row
from spdz.gallery.strip import Rectangle, Strip, grown
from spdz.tape.high_water import default_state_dir

BURY = "UPDATE slots SET digest = NULL, note = NULL, eps = NULL WHERE key = ?"
FILL = "INSERT INTO slots VALUES (?, ?, NULL, ?)"
STRIP = "INSERT INTO strips (row, row_end, col, col_end, results) VALUES (?, ?, ?, ?, ?)"


class Journal:
    """An open ledger file with its mark. Use :meth:`open`.

    Attributes:
        path: The file.
        rolled_back: Whether it was behind its mark when it was opened.
        heads: Of party 0 and of party 1: the heads over 0, 1, ... of its slots.
    """

    def __init__(self, store: Store, marks: MarkFile, mark: Mark) -> None:
        self.path = store.path
        self.rolled_back = False
        self.heads = tuple([first_head(mark.tape, owner)] for owner in (0, 1))
        self._store, self._marks, self._mark = store, marks, mark
        self._process = os.getpid()
        self._ready = self._closed = False

    @classmethod
    def open(cls, path: Path, tape: str, party: int, state_dir: Path | None) -> Journal:
        """Open a file, or begin one; errors as :meth:`spdz.gallery.ledger.Ledger.open`."""
        marks = MarkFile(state_dir or default_state_dir(), tape, party)
        with AT_WORK, disk_errors(path, marks.path):
            marked = marks.read()
            store = Store(path, Mark.first(tape, party))
            try:
                with damage():
                    journal = cls(store, marks, store.record())
                journal._recover(tape, party, marked)
            except BaseException:
                store.close()
                raise
        return journal

    @property
    def mark(self) -> Mark:
        """The record as of the last step.

        Raises:
            TapeDestroyed: It was destroyed.
            TapeError: It is closed, or a step failed.
        """
        if self._mark.destroyed:
            raise self._is_destroyed()
        if not self._ready:
            raise TapeError(f"{self.path}: the ledger is closed, or recording a step failed: open it again")
        return self._mark

    @contextmanager
    def at_work(self) -> Iterator[Store]:
        """One thread at a time, in the process that opened it; errors of the disk get their names.

        Raises:
            TapeInUse: This is a fork.
        """
        if os.getpid() != self._process:
            raise TapeInUse(
                f"{self.path}: the ledger belongs to process {self._process}, which forked this one"
            )
        with AT_WORK, disk_errors(self.path, self._marks.path):
            yield self._store

    def step(self, mark: Mark, changes: Sequence[Change]) -> None:
        """Make ``mark`` and ``changes`` durable, all or nothing, at work."""
        mark = replace(mark, sequence=mark.sequence + 1)
        self._ready = False  # until the disk has it, it is not known what the disk has
        self._store.store(mark, changes)
        self._marks.write(mark)
        self._mark, self._ready = mark, True

    def pinned(self, text: bytes) -> Mark:
        """The record with the program's text pinned.

        Raises:
            TapeMismatch: Another one is pinned.
            ValueError: It is longer than 65,536 bytes.
        """
        if len(text) > MAX_TEXT:
            raise ValueError(f"a text has at most {MAX_TEXT} bytes, not {len(text)}")
        mark = self.mark
        if mark.text not in (None, text):
            raise TapeMismatch(
                f"{self.path}: this gallery is pinned to another program, threshold or "
                "resolution, and its masks must never answer two. Use those, or deal new tapes"
            )
        return replace(mark, text=text)

    def digests(self, owner: int, start: int = 0) -> list[bytes | None]:
        """Of a party's slots from ``start`` on; None for void ones."""
        where = slot_key(owner, start), slot_key(owner + 1, 0)
        query = "SELECT digest FROM slots WHERE key >= ? AND key < ? ORDER BY key"
        return [digest for (digest,) in self._store.all(query, *where)]

    def strips(self, which: str = "TRUE") -> list[tuple[int, Strip]]:
        """Number and place of the strips for which an SQL condition holds, in order."""
        query = f"SELECT number, row, row_end, col, col_end FROM strips WHERE {which} ORDER BY number"
        return [
            (number, Strip(range(row, row_end), range(column, column_end)))
            for number, row, row_end, column, column_end in self._store.all(query)
        ]

    def destroy(self) -> None:
        """Have this file, its mark and every copy refused from now on. A second call does nothing."""
        with self.at_work():
            if self._closed:
                raise TapeError(f"{self.path}: the ledger is closed")
            if not self._mark.destroyed:
                self._destroy(self._mark)

    def close(self) -> None:
        """Close the file. A second call does nothing; in a fork it stays the parent's."""
        self._ready = False
        if os.getpid() == self._process:
            with AT_WORK:
                self._closed = True
                self._store.close()

    def __repr__(self) -> str:
        rows, columns = self._mark.done
        return f"<ledger of gallery {self._mark.tape}: {rows} x {columns} pairs done>"

    def _recover(self, tape: str, party: int, marked: Mark | None) -> None:
        record = self._mark
        if (record.tape, record.party) != (tape, party):
            raise TapeMismatch(
                f"{self.path}: the ledger is of gallery {record.tape}, party {record.party}, not of {tape}, "
                f"party {party}, beside it: one of the two files is of another dealing. Put back the tape "
                "that was used with this ledger, or deal again"
            )
        if record.destroyed or (marked is not None and marked.destroyed):
            self._destroy(record)
            raise self._is_destroyed()
        if marked is not None and self._marks.torn and record.sequence <= marked.sequence:
            raise self._marks.damaged()
        with damage():
            digests = self._check(record)
        self.heads = tuple(extended(heads, held) for heads, held in zip(self.heads, digests, strict=True))
        try:
            if marked is not None and marked.sequence > record.sequence:
                self._catch_up(record, digests, marked)
                self.rolled_back = True
            elif marked != record:
                if marked is not None:
                    check_ahead(record, digests, marked)
                self._marks.write(record)
        except ValueError as error:
            raise TapeDamaged(
                f"{self.path}: {error}, although they are of one gallery, so it is unknown which slots were "
                f"used ({self._marks.path}). Deal new tapes for both robots"
            ) from error
        self._ready = True

    def _check(self, record: Mark) -> tuple[Digests, Digests]:
        """See that slots and strips are those of the record, and give the slots' digests.

        Raises:
            ValueError: They are not.
        """
        found = []
        for owner, side in enumerate(record.sides):
            digests = self.digests(owner)
            where = slot_key(owner, 0), slot_key(owner + 1, 0)
            query = "SELECT key - ? FROM slots WHERE key >= ? AND key < ? AND note IS NOT NULL"
            noted = runs_of(slot for (slot,) in self._store.all(query, where[0], *where))
            void = runs_of(slot for slot, digest in enumerate(digests) if digest is None)
            head = extended(self.heads[owner], digests)[-1]
            if (len(digests), head, void) != (side.filled, side.head, side.void):
                raise ValueError(f"the slots of party {owner} are not those of the record")
            if joined(noted, void) != joined(side.noted, void):
                raise ValueError(f"the notes of party {owner} are not those of the record")
            found.append(digests)
        done: Rectangle = (0, 0)
        for _, strip in self.strips():
            done = grown(done, strip)
        if done != record.done:
            raise ValueError(f"strips of {done[0]} x {done[1]} pairs for {record.done[0]} x {record.done[1]}")
        return found[0], found[1]

    def _catch_up(self, record: Mark, digests: tuple[Digests, Digests], marked: Mark) -> None:
        plan = recovery(record, digests, marked)
        changes: list[Change] = [(STRIP, [strip_row(strip, None) for strip in plan.burnt])]
        for owner, (held, void) in enumerate(zip(digests, plan.void, strict=True)):
            known = [(slot_key(owner, slot),) for slot in void if slot < len(held)]
            unknown = [(slot_key(owner, slot), None, None) for slot in void if slot >= len(held)]
            changes += [(BURY, known), (FILL, unknown)]
        self.step(plan.mark, changes)
        self.heads = tuple(
            extended([first_head(record.tape, owner)], self.digests(owner)) for owner in (0, 1)
        )

    def _destroy(self, mark: Mark) -> None:
        self._ready = False
        mark = replace(mark, sequence=mark.sequence + 1, destroyed=True)
        try:
            self._marks.write(mark)
        finally:
            self._store.store(mark, [])
        self._mark = mark

    def _is_destroyed(self) -> TapeDestroyed:
        return TapeDestroyed(
            f"{self.path}: the gallery was destroyed, because a MAC check failed. A copy of its ledger "
            "cannot be used either. Deal new tapes for both robots"
        )
