"""How the pairs of a step are cut, and how their results are kept and shown."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.foundations.stats import Stats
from spdz.gallery.ledger import Ledger
from spdz.gallery.strip import Rectangle, Strip

STRIP_PAIRS = 1 << 16
"""Most pairs of a strip, unless it is one row or column."""

Results = npt.NDArray[Any]
Cell = tuple[range, range, Results]
"""Rows, columns and the results of all their pairs."""


@dataclass(frozen=True, slots=True)
class Block:
    """The results of some pairs, checked and durable.

    Attributes:
        own: This side's slots.
        peer: The peer's slots.
        results: Decisions or scores of all pairs, shape (len(own), len(peer)).
    """

    own: range
    peer: range
    results: Results = field(repr=False)


@dataclass(slots=True)
class Phase:
    """What one part of a step cost this side.

    Attributes:
        seconds: Wall clock, the peer's part and the disk included.
        stats: Rounds, bytes and correlations.
    """

    seconds: float = 0.0
    stats: Stats = field(default_factory=Stats)

    @contextmanager
    def timed(self) -> Iterator[Stats]:
        """Time a part of it, and give the counters."""
        started = time.perf_counter()
        try:
            yield self.stats
        finally:
            self.seconds += time.perf_counter() - started


@dataclass(slots=True)
class Step:
    """What one step brought.

    Attributes:
        own: Slots that this side's new descriptors are in, in the order in which they were added.
        peer: New slots of the peer's.
        blocks: Results, in the order in which they were checked.
        filling: Cost of masking, sending, preparing and proving new slots.
        comparing: Cost of comparing, from slots that both sides hold to results that are checked and durable.
    """

    own: list[int] = field(default_factory=list)
    peer: list[int] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    filling: Phase = field(default_factory=Phase)
    comparing: Phase = field(default_factory=Phase)

    @property
    def stats(self) -> Stats:
        """This side's cost of all of it."""
        total = Stats()
        for phase in (self.filling, self.comparing):
            total.add(phase.stats)
        return total

    def forget(self, own: Collection[int], peer: Collection[int]) -> None:
        """Leave out slots that were lost since an earlier session has begun this step."""
        self.own[:] = [slot for slot in self.own if slot not in own]
        self.peer[:] = [slot for slot in self.peer if slot not in peer]

    @property
    def matches(self) -> list[tuple[int, int]]:
        """Own slot and peer's slot of every pair that was decided with True."""
        return [
            (block.own.start + int(i), block.peer.start + int(j))
            for block in self.blocks
            for i, j in np.argwhere(block.results)
        ]


def pieces(strip: Strip, most: int) -> Iterator[Strip]:
    """A strip in strips of at most so many pairs, or of one row or column, each beside the one before."""
    rows, columns = strip.rows, strip.columns
    by_rows = columns.start == 0
    long, across = (rows, columns) if by_rows else (columns, rows)
    size = max(1, most // len(across))
    for start in range(long.start, long.stop, size):
        part = range(start, min(start + size, long.stop))
        yield Strip(part, columns) if by_rows else Strip(rows, part)


def cells(strip: Strip, void: Sequence[set[int]], most: int) -> Iterator[tuple[range, range]]:
    """The parts of a strip that hold no void slot and at most so many pairs."""
    for rows in runs(strip.rows, void[0]):
        for columns in runs(strip.columns, void[1]):
            if len(rows) * len(columns) <= most:
                yield rows, columns
                continue
            yield from _squares(rows, columns, most)


def _squares(rows: range, columns: range, most: int) -> Iterator[tuple[range, range]]:
    side = max(1, most // min(len(rows), len(columns)))
    if len(rows) >= len(columns):
        for start in range(rows.start, rows.stop, side):
            yield range(start, min(start + side, rows.stop)), columns
    else:
        for start in range(columns.start, columns.stop, side):
            yield rows, range(start, min(start + side, columns.stop))


def runs(slots: range, void: set[int]) -> Iterable[range]:
    """Consecutive slots that are not void."""
    start = slots.start
    for slot in (*sorted(one for one in void if one in slots), slots.stop):
        if start < slot:
            yield range(start, slot)
        start = slot + 1


def within(strip: Strip, done: Rectangle) -> bool:
    """Whether all pairs of a strip are done."""
    return strip.rows.stop <= done[0] and strip.columns.stop <= done[1]


def encode_results(strip: Strip, parts: Sequence[Cell], *, bits: bool) -> bytes:
    """A strip's results as bytes: a bit a pair, or a float64; False or NaN for pairs with a void slot."""
    whole: Results = np.full((len(strip.rows), len(strip.columns)), False if bits else np.nan)
    for rows, columns, results in parts:
        at = slice(rows.start - strip.rows.start, rows.stop - strip.rows.start)
        across = slice(columns.start - strip.columns.start, columns.stop - strip.columns.start)
        whole[at, across] = results
    return np.packbits(whole).tobytes() if bits else whole.astype("<f8").tobytes()


def decode_results(strip: Strip, stored: bytes, *, bits: bool) -> Results:
    """The inverse of :func:`encode_results`: shape (rows, columns)."""
    shape = (len(strip.rows), len(strip.columns))
    if not bits:
        return np.frombuffer(stored, dtype="<f8").reshape(shape)
    return (
        np.unpackbits(np.frombuffer(stored, dtype=np.uint8), count=strip.pairs)
        .astype(np.bool_)
        .reshape(shape)
    )


def held_slots(ledger: Ledger, owner: int) -> list[int]:
    """Slots of one party that hold a descriptor."""
    slots, void = ledger.slots[owner], set(ledger.slots[owner].voids)
    return [slot for slot in range(slots.filled) if slot not in void]


def stored_blocks(ledger: Ledger, party: int, *, bits: bool) -> Iterator[Block]:
    """All results that a ledger keeps, as one party sees them, in the order in which they were committed."""
    for strip, stored in ledger.results():
        results = decode_results(strip, stored, bits=bits)
        yield oriented(party, (strip.rows, strip.columns, results))


def oriented(party: int, cell: Cell) -> Block:
    """Results as one party sees them."""
    rows, columns, results = cell
    return Block(rows, columns, results) if party == 0 else Block(columns, rows, results.T)
