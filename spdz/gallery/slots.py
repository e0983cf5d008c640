"""One party's slots of a gallery, each filled at most once and for ever.

What is sent for a slot is stored here first and sent again only from here, never masked anew; what the peer
sends is stored before anything is computed on it. A void slot holds nothing and never will. ``head`` lets two
robots see that they hold the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from spdz.foundations.errors import TapeMismatch
from spdz.gallery.heads import digest_of, extended
from spdz.gallery.journal import BURY, FILL, Journal
from spdz.gallery.mark import Mark, Side
from spdz.gallery.runs import joined, runs_of, slots_in
from spdz.gallery.store import Change, Store, damage, sealed, slot_key, unsealed

Notes: TypeAlias = Mapping[int, bytes]
"""Slots of a party, and what is to be remembered of each."""

_NOTE = "UPDATE slots SET note = ? WHERE key = ?"


class Slots:
    """One party's slots in an open ledger; errors as :class:`spdz.gallery.ledger.Ledger`.

    Args:
        journal: The ledger's file and mark.
        owner: The party, 0 or 1.
    """

    def __init__(self, journal: Journal, owner: int) -> None:
        self._journal, self._owner = journal, owner

    @property
    def filled(self) -> int:
        """Number of slots that are used for ever, void ones included: 0 to filled - 1."""
        return self._side.filled

    def head(self, count: int) -> bytes:
        """The chained hash over slots 0 to count - 1 as they are now, 32 bytes.

        Raises:
            ValueError: Fewer are filled.
        """
        if not 0 <= count <= self.filled:
            raise ValueError(f"party {self._owner} has filled {self.filled} slots, not {count}")
        return self._journal.heads[self._owner][count]

    @property
    def voids(self) -> list[int]:
        """Slots that hold nothing, ascending."""
        return slots_in(self._side.void)

    @property
    def ready(self) -> int:
        """Slots, from the first on, that are void or have a note."""
        runs = joined(self._side.void, self._side.noted)
        return runs[0][1] if runs and runs[0][0] == 0 else 0

    def fill(self, entries: Sequence[tuple[int, bytes | None]], text: bytes | None = None) -> None:
        """Use the next slots.

        Args:
            entries: Slot numbers, from ``filled`` on, and what is sent for each; None: void.
            text: What the gallery computes, to pin in the same step
                (:meth:`spdz.gallery.ledger.Ledger.pin_text`).

        Raises:
            ValueError: The numbers are not the next.
            TapeMismatch: Another text is pinned.
        """
        journal = self._journal
        with journal.at_work():
            mark, side = journal.mark if text is None else journal.pinned(text), self._side
            after = side.filled + len(entries)
            if [slot for slot, _ in entries] != list(range(side.filled, after)):
                raise ValueError(
                    f"slots are filled in order: the next of party {self._owner} is {side.filled}"
                )
            if not entries:
                if mark != journal.mark:
                    journal.step(mark, [])
                return
            rows = [(slot_key(self._owner, slot), digest_of(eps), eps) for slot, eps in entries]
            heads = extended(journal.heads[self._owner], [digest for _, digest, _ in rows])
            void = joined(side.void, runs_of(slot for slot, eps in entries if eps is None))
            side = replace(side, filled=after, head=heads[-1], void=void)
            journal.step(mark.with_side(self._owner, side), [(FILL, rows)])
            journal.heads[self._owner][:] = heads

    def void(self, slots: Iterable[int]) -> None:
        """Make filled slots void, for ever: the peer has lost what they hold. Void ones may be named.

        The heads over them change to what they would be had the slots been void from the start.

        Raises:
            ValueError: One of them is not filled.
        """
        journal = self._journal
        with journal.at_work():
            side = self._side
            slots = set(slots)
            self._refuse_unfilled(slots)
            new = sorted(slots - set(slots_in(side.void)))
            if not new:
                return
            digests = journal.digests(self._owner, new[0])
            for slot in new:
                digests[slot - new[0]] = None
            heads = extended(journal.heads[self._owner][: new[0] + 1], digests)
            side = replace(side, head=heads[-1], void=joined(side.void, runs_of(new)))
            rows = [(slot_key(self._owner, slot),) for slot in new]
            journal.step(journal.mark.with_side(self._owner, side), [(BURY, rows)])
            journal.heads[self._owner][:] = heads

    def eps(self, start: int, stop: int) -> list[bytes | None]:
        """What was sent for slots start to stop - 1; None for void ones.

        Raises:
            ValueError: One of them is not filled.
            TapeDamaged: The bytes are not those that were stored.
        """
        with self._journal.at_work() as store:
            self._refuse_unfilled(range(start, stop))
            where = slot_key(self._owner, start), slot_key(self._owner, stop)
            rows = store.all("SELECT digest, eps FROM slots WHERE key >= ? AND key < ? ORDER BY key", *where)
            with damage():
                for slot, (digest, eps) in enumerate(rows, start):
                    if digest_of(eps) != digest:
                        raise ValueError(f"the checksum of {self._name(slot)} does not hold")
            return [eps for _, eps in rows]

    def noting(self, store: Store, mark: Mark, notes: Notes) -> tuple[Mark, list[Change]]:
        """What it takes to note something, at work: :meth:`spdz.gallery.ledger.Ledger.note`."""
        side = self._side
        self._refuse_unfilled(notes)
        if set(notes) & set(slots_in(side.void)):
            raise ValueError(f"a void slot of party {self._owner} takes no note")
        held = {slot: self._note(store, slot) for slot in notes}
        for slot, data in notes.items():
            if held[slot] not in (None, data):
                raise TapeMismatch(
                    f"{self._journal.path}: another note was made of {self._name(slot)}. Its masks must not "
                    "show a second value"
                )
        new = {slot: data for slot, data in notes.items() if held[slot] is None}
        if not new:
            return mark, []
        rows = [(sealed(data, self._name(slot)), slot_key(self._owner, slot)) for slot, data in new.items()]
        side = replace(side, noted=joined(side.noted, runs_of(new)))
        return mark.with_side(self._owner, side), [(_NOTE, rows)]

    def noted(self, slot: int) -> bytes | None:
        """A slot's note, if it has one; a void slot has none.

        Raises:
            ValueError: It is not filled.
            TapeDamaged: The note is not what was stored.
        """
        with self._journal.at_work() as store:
            self._refuse_unfilled([slot])
            return self._note(store, slot)

    @property
    def _side(self) -> Side:
        return self._journal.mark.sides[self._owner]

    def _refuse_unfilled(self, slots: Iterable[int]) -> None:
        filled = self.filled
        unfilled = sorted(slot for slot in slots if not 0 <= slot < filled)
        if unfilled:
            raise ValueError(f"{self._name(unfilled[0])} is not filled: {filled} are")

    def _note(self, store: Store, slot: int) -> bytes | None:
        [(stored,)] = store.all("SELECT note FROM slots WHERE key = ?", slot_key(self._owner, slot))
        with damage():
            return None if stored is None else unsealed(stored, self._name(slot))

    def _name(self, slot: int) -> str:
        return f"slot {slot} of party {self._owner}"
