"""New pairs of a gallery: compared strip by strip, and durable before anybody sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

from spdz.foundations.errors import Wrapped
from spdz.foundations.stats import Stats
from spdz.gallery.ledger import NO_NOTES, Ledger
from spdz.gallery.slots import Notes
from spdz.gallery.strip import Strip, between
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms, compare
from spdz.readings.gallery_plan import GalleryPlan
from spdz.readings.party import Party
from spdz.readings.streams import RecordStream
from spdz.rounds.coroutine import Protocol
from spdz.session.pairs import read_pairs
from spdz.session.shelf import Shelf
from spdz.session.strips import (
    STRIP_PAIRS,
    Block,
    Cell,
    Step,
    cells,
    encode_results,
    oriented,
    pieces,
    within,
)

CELL_BYTES = 64 << 20
"""Most stored bytes of the pairs that are compared at a time."""


class Connection(Interface):
    """What comparing needs of a session."""

    def reader(self, stream: RecordStream, stats: Stats) -> Party:
        """A party that draws on some records."""

    def run(self, protocol: Protocol[Any], stats: Stats) -> Any:
        """Run a protocol on the connection."""

    def keep_step(self, strip: Strip) -> None:
        """Wait for the peer at a strip of which nothing is compared."""


@dataclass(slots=True)
class Comparing:
    """The side of a gallery session that compares.

    Attributes:
        tape: The gallery's tape.
        terms: What it is for.
        plan: What the meter saw of the terms.
        ledger: What was compared.
        shelves: The slots of party 0 and of party 1.
        again: Strips to run first, which were broken off.
    """

    tape: GalleryTape
    terms: Terms
    plan: GalleryPlan
    ledger: Ledger
    shelves: tuple[Shelf, Shelf]
    again: list[Strip] = field(default_factory=list)

    def new(
        self,
        connection: Connection,
        step: Step,
        on_block: Callable[[Block], None],
        notes: tuple[Notes, Notes],
    ) -> None:
        """Compare all pairs of filled slots that are not done.

        Args:
            connection: The session.
            step: Takes the results.
            on_block: Called with every block as soon as it is checked and durable.
            notes: What the ledger is still to remember of the slots; it does before anything is sent.
        """
        for strip in self._strips():
            self._run_strip(strip, connection, step, on_block, notes)
            notes = NO_NOTES
        self.ledger.note(notes)

    def _strips(self) -> Iterator[Strip]:
        """What is broken off or not done, read on when the strip before is done."""
        while self.again:
            yield self.again.pop(0)
        first, second = self.ledger.slots
        for strip in between(self.ledger.done, (first.filled, second.filled)):
            yield from pieces(strip, self._most_pairs)

    @property
    def _most_pairs(self) -> int:
        return max(1, min(STRIP_PAIRS, CELL_BYTES // max(1, *self.plan.pair.correction_bytes)))

    def _run_strip(
        self,
        strip: Strip,
        connection: Connection,
        step: Step,
        on_block: Callable[[Block], None],
        notes: tuple[Notes, Notes],
    ) -> None:
        """Compare a strip, keep its results, then show them."""
        kept = within(strip, self.ledger.done)  # the peer has missed it
        if kept:
            self.ledger.note(notes)
        else:
            self.ledger.begin(strip, notes)
        stats, (first, second) = step.comparing.stats, (set(slots.voids) for slots in self.ledger.slots)
        parts: list[Cell] = []
        try:
            for rows, columns in cells(strip, (first, second), self._most_pairs):
                parts.append((rows, columns, self._run_cell(rows, columns, connection, stats)))
        except Wrapped:  # it would be so again
            if not kept:
                self.ledger.burn(strip)
            raise
        if not parts:  # no side may be further ahead than a strip that both have begun
            connection.keep_step(strip)
        if kept:
            return
        self.ledger.commit(strip, encode_results(strip, parts, bits=self.plan.bits))
        for part in parts:
            block = oriented(self.tape.header.party, part)
            step.blocks.append(block)
            on_block(block)

    def _run_cell(self, rows: range, columns: range, connection: Connection, stats: Stats) -> Any:
        party = connection.reader(read_pairs(self.tape, rows, columns), stats)
        sides = (self.shelves[0].filled(rows), self.shelves[1].filled(columns))
        return connection.run(compare(party, self.terms, *sides), stats)
