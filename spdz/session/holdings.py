"""What one side of a connected gallery holds: slots, room, results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from spdz.foundations.types import IntArray
from spdz.gallery.ledger import Ledger
from spdz.gallery.strip import between
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery_plan import GalleryPlan
from spdz.session.comparing import Comparing
from spdz.session.conversation import Conversing
from spdz.session.filling import Filling
from spdz.session.shelf import Shelf
from spdz.session.strips import Block, held_slots, stored_blocks


class Holdings(Conversing):
    """The part of a gallery session that sends nothing."""

    _tape: GalleryTape
    _ledger: Ledger
    _plan: GalleryPlan
    _shelves: tuple[Shelf, Shelf]
    _filling: Filling
    _comparing: Comparing

    @property
    def party(self) -> int:
        """0 or 1."""
        return int(self._tape.header.party)

    @property
    def capacity(self) -> tuple[int, int]:
        """Slots of this side and of the peer."""
        own, peer = (self._tape.header.capacity[owner] for owner in (self.party, 1 - self.party))
        return own, peer

    @property
    def room(self) -> int:
        """Own slots that are neither used nor waited for."""
        return self._filling.room

    @property
    def due(self) -> int:
        """Own descriptors that are in slots and that the next step sends, before it brings any others."""
        return len([slot for slot in self.filled if slot >= self._filling.sent])

    def require_room(self, more: int) -> None:
        """Raise :class:`TapeExhausted` unless there are slots for so many more descriptors."""
        self._filling.refuse_more_than(self.room, more)

    def results(self) -> Iterator[Block]:
        """All results so far, as they were committed, strip by strip."""
        return stored_blocks(self._ledger, self.party, bits=self._plan.bits)

    def plain(self, slots: Sequence[int]) -> IntArray:
        """The quantised descriptors in own slots, raw.

        Raises:
            ValueError: if a slot holds none.
        """
        if not set(slots) <= set(self.filled):
            raise ValueError("a descriptor is asked for that is in no slot: see `filled`")
        return self._shelves[self.party].plain(slots)

    @property
    def unfinished(self) -> bool:
        """Whether pairs of filled slots wait to be compared, as after a step that was broken off."""
        first, second = self._ledger.slots
        return bool(self._comparing.again or between(self._ledger.done, (first.filled, second.filled)))

    @property
    def open_pairs(self) -> int:
        """How many pairs of slots that both sides know wait to be compared."""
        done = self._ledger.done[self.party], self._ledger.done[1 - self.party]
        before = [
            sum(slot < end for slot in held)
            for held, end in zip((self.filled, self.peer_filled), done, strict=True)
        ]
        return (len(self.filled) - self.due) * len(self.peer_filled) - before[0] * before[1]

    @property
    def filled(self) -> list[int]:
        """Own slots that hold a descriptor."""
        return held_slots(self._ledger, self.party)

    @property
    def peer_filled(self) -> list[int]:
        """The peer's slots that hold a descriptor."""
        return held_slots(self._ledger, 1 - self.party)
