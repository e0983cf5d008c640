"""What one side of a gallery holds, read without a connection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np

from spdz.foundations.types import IntArray
from spdz.gallery.ledger import Ledger
from spdz.gallery.strip import between
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.session.admission import check_rule, checked_plan
from spdz.session.shelf import Shelf
from spdz.session.strips import Block, held_slots, stored_blocks
from spdz.values.input_mask import unpack


class Stored:
    """A gallery's tape and ledger, locked while this is open; a context manager.

    Args:
        tape: The gallery's tape.
        terms: What it is for.
        state_dir: Where the second record is kept.

    Raises:
        TapeMismatch: if the tape was dealt for something else, or has answered something else.
        TapeError: as :meth:`GalleryTape.open` and :meth:`Ledger.open`.
    """

    def __init__(self, tape: Path, terms: Terms, state_dir: Path | None) -> None:
        with ExitStack() as resources:
            self._tape = resources.enter_context(GalleryTape.open(tape, state_dir=state_dir))
            header = self._tape.header
            self._plan, self._terms, self._party = checked_plan(self._tape, terms), terms, header.party
            self._ledger = resources.enter_context(
                Ledger.open(tape.with_suffix(".ledger"), header.tape, header.party, state_dir=state_dir)
            )
            check_rule(self._ledger.text, self._plan, terms)
            self._resources = resources.pop_all()

    def __enter__(self) -> Stored:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    @property
    def filled(self) -> list[int]:
        """Own slots that hold a descriptor."""
        return held_slots(self._ledger, self._party)

    @property
    def room(self) -> int:
        """Own slots that are not used."""
        return int(self._tape.header.capacity[self._party]) - self._ledger.slots[self._party].filled

    @property
    def unfinished(self) -> bool:
        """Whether pairs of filled slots wait to be compared."""
        first, second = self._ledger.slots
        return bool(self._ledger.flight or between(self._ledger.done, (first.filled, second.filled)))

    def results(self) -> Iterator[Block]:
        """All results so far."""
        return stored_blocks(self._ledger, self._party, bits=self._plan.bits)

    def plain(self, slots: Sequence[int]) -> IntArray:
        """The quantised descriptors in own slots, raw."""
        terms, own, shelf = (
            self._terms,
            self._ledger.slots[self._party],
            Shelf(self._tape, self._terms, self._party),
        )
        words = [own.eps(slot, slot + 1)[0] for slot in slots]
        raw = b"".join(one for one in words if one is not None)
        if not slots:
            return np.empty((0, terms.dim), dtype=np.int64)
        shelf.place(slots, unpack(raw, (len(slots), terms.dim), terms.word_bits, terms.entry))
        return shelf.plain(slots)
