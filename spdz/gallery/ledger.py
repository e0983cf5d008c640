"""The ledger of a gallery: what was filled, compared and found, which must outlive every crash.

A gallery's masks stand for a whole mission, so what was masked with them must be remembered as long:

- *Slots*, of party 0 (rows) and party 1 (columns), are filled in order, each at most once
  (:mod:`spdz.gallery.slots`).
- *The text*, what the gallery computes, is pinned once: under another threshold the same masks would bisect
  the score.
- *Pairs* are used in strips beside the rectangle that is done (:mod:`spdz.gallery.strip`). ``begin`` one
  before any share of it is sent; then either its results are committed or it is burnt, and it is done.

Every method that changes something returns when the disk has it, in the ledger and in its mark
(:mod:`spdz.gallery.mark`); only then may anything be sent, or shown to the caller. A ledger restored from a
backup is brought up to its mark when it is opened (:mod:`spdz.gallery.recovery`).

The caller holds the gallery tape's lock, which keeps other processes and copies away. No secret of the tape
is in here: masked descriptors, what the peer sent, and results.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from spdz.gallery.journal import STRIP, Journal
from spdz.gallery.mark import Mark
from spdz.gallery.slots import Notes, Slots
from spdz.gallery.store import Change, Store, damage, strip_row, unsealed
from spdz.gallery.strip import Rectangle, Strip, grown

NO_NOTES: tuple[Notes, Notes] = ({}, {})


class Ledger:
    """An open ledger. Use :meth:`open`; a context manager; safe to share between threads.

    Raises ``TapeInUse`` in a fork of the process that opened it, and ``TapeError`` when it is closed, or
    after any error of the disk until it is opened again: then it is known again what the disk holds.

    Attributes:
        slots: Of party 0 (rows) and of party 1 (columns).
    """

    def __init__(self, journal: Journal) -> None:
        self.slots = Slots(journal, 0), Slots(journal, 1)
        self._journal = journal

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], tape: str, party: int, *, state_dir: Path | None = None
    ) -> Ledger:
        """Open a ledger, or begin one.

        Args:
            path: The file, beside the gallery's tape.
            tape: The gallery tape's hex id.
            party: Whose ledger it is, 0 or 1.
            state_dir: Where its mark is kept; by default as for tapes. Always give the same one.

        Raises:
            TapeMismatch: It is another gallery's, or the other party's.
            TapeDamaged: It, or its mark, is not whole, or they contradict each other.
            TapeDestroyed: It was destroyed, or is a copy of one that was.
            TapeError: It, or its mark, cannot be read or written.
        """
        return cls(Journal.open(Path(path), tape, party, state_dir))

    @property
    def rolled_back(self) -> bool:
        """Whether the ledger was behind its mark when it was opened, hence restored from a backup.

        Slots and pairs used since are void and burnt.
        """
        return self._journal.rolled_back

    @property
    def text(self) -> bytes | None:
        """What the gallery computes, once it is pinned."""
        return self._journal.mark.text

    def pin_text(self, text: bytes) -> None:
        """Pin what the gallery computes, for ever.

        Raises:
            TapeMismatch: Another one is pinned.
            ValueError: It is longer than 65,536 bytes.
        """
        with self._journal.at_work():
            mark = self._journal.pinned(text)
            if mark != self._journal.mark:
                self._journal.step(mark, [])

    @property
    def done(self) -> Rectangle:
        """(R, C): the pairs of rows 0 to R - 1 and columns 0 to C - 1 are used, burnt ones included."""
        return self._journal.mark.done

    @property
    def flight(self) -> Strip | None:
        """The strip that was begun and neither committed nor burnt."""
        return self._journal.mark.flight

    def note(self, notes: tuple[Notes, Notes]) -> None:
        """Remember something of slots for ever, such as what the peer sent to prepare them.

        Args:
            notes: Of slots of party 0 and of party 1.

        Raises:
            TapeMismatch: A slot has another note. Nothing was changed.
            ValueError: A slot is void or not filled.
        """
        with self._journal.at_work() as store:
            self._note(store, notes, self._journal.mark)

    def begin(self, strip: Strip, notes: tuple[Notes, Notes] = NO_NOTES) -> None:
        """Use a strip's pairs. Beginning the one in flight once more, to run it again, changes nothing.

        Args:
            strip: Which.
            notes: To remember in the same step, as by :meth:`note`.

        Raises:
            TapeMismatch: As :meth:`note`.
            ValueError: Another is in flight, it is not beside what is done, its slots are not all filled, or
                no text is pinned; or as :meth:`note`. Nothing was changed.
        """
        with self._journal.at_work() as store:
            mark = self._journal.mark
            _refuse_strip(mark, strip)
            if mark.text is None:
                raise ValueError("pin what the gallery computes before a strip begins")
            self._note(store, notes, replace(mark, flight=strip))

    def commit(self, strip: Strip, results: bytes) -> None:
        """Keep the checked results of the strip in flight. It is done.

        Raises:
            ValueError: It is not in flight.
        """
        with self._journal.at_work():
            if self._journal.mark.flight != strip:
                raise ValueError(f"{strip} are not in flight, but {self._journal.mark.flight or 'nothing'}")
            self._finish(strip, results)

    def burn(self, strip: Strip) -> None:
        """Give up the strip in flight, or one that only the peer has begun. It is done, without results.

        Raises:
            ValueError: Another is in flight, it is not beside what is done, or its slots are not all filled.
        """
        with self._journal.at_work():
            _refuse_strip(self._journal.mark, strip)
            self._finish(strip, None)

    def results(self, after: int = 0) -> Iterator[tuple[Strip, bytes]]:
        """The strips that were committed, in order, and their results, read one by one.

        Args:
            after: How many of the first are left out.

        Raises:
            TapeDamaged: The results are not those that were stored.
        """
        with self._journal.at_work():
            strips = self._journal.strips("results IS NOT NULL")[after:]
        for number, strip in strips:
            with self._journal.at_work() as store:
                [(stored,)] = store.all("SELECT results FROM strips WHERE number = ?", number)
                with damage():
                    results = unsealed(stored, f"strip {strip}")
            yield strip, results

    def burnt(self) -> list[Strip]:
        """The strips that were given up, in order."""
        with self._journal.at_work():
            return [strip for _, strip in self._journal.strips("results IS NULL")]

    def destroy(self) -> None:
        """Refuse this ledger and its copies from now on: a MAC check failed. A second call does nothing."""
        self._journal.destroy()

    def close(self) -> None:
        """Close the file. A second call does nothing; in a fork it stays the parent's."""
        self._journal.close()

    def __repr__(self) -> str:
        return repr(self._journal)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _note(self, store: Store, notes: tuple[Notes, Notes], mark: Mark) -> None:
        """Step to ``mark`` with the notes, at work, unless that changes nothing."""
        changes: list[Change] = []
        for slots, new in zip(self.slots, notes, strict=True):
            mark, more = slots.noting(store, mark, new)
            changes += more
        if mark != self._journal.mark:
            self._journal.step(mark, changes)

    def _finish(self, strip: Strip, results: bytes | None) -> None:
        mark = self._journal.mark
        done = replace(mark, done=grown(mark.done, strip), flight=None)
        self._journal.step(done, [(STRIP, [strip_row(strip, results)])])


def _refuse_strip(mark: Mark, strip: Strip) -> None:
    if mark.flight not in (None, strip):
        raise ValueError(f"{mark.flight} are in flight")
    filled = mark.sides[0].filled, mark.sides[1].filled
    if strip.rows.stop > filled[0] or strip.columns.stop > filled[1]:
        raise ValueError(f"{strip} are not all filled: {filled[0]} x {filled[1]} are")
    grown(mark.done, strip)
