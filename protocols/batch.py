"""One batch of descriptors on its way to being compared with the peer's, tile by tile.

The grid of pairs is covered with the tapes' tiles, which both robots walk in one order. A tile's result is
final as soon as the run that contains it has passed its MAC check. So a batch remembers how many tiles are
done, and a new connection goes on after them.

Tiles at the border are filled up with copies of the last descriptor: every result is opened, those of the
filling too, and for a zero row they would tell the peer's norms.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from protocols.batching import jobs_together
from protocols.catalog import Purpose
from spdz.foundations.errors import OutOfStep, TapeExhausted
from spdz.foundations.stats import Stats
from spdz.foundations.types import Security
from spdz.readings.meter import measure
from spdz.readings.program import Program
from spdz.session import Session


@dataclass(frozen=True, slots=True)
class Block:
    """Decided pairs of a batch.

    Attributes:
        batch: Number of the batch.
        rows: Own descriptors, as positions in the batch: ``range(start, stop)``.
        columns: The peer's.
        decisions: Their results, shape (rows, columns): booleans, or scores where the tapes reveal scores.
    """

    batch: int
    rows: range
    columns: range
    decisions: npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Matches:
    """Result of a matching.

    Attributes:
        decisions: (own, peer's) array: booleans, or scores where the tapes reveal scores.
        decided: The same shape: which of them have been decided. All, unless the matching was broken off.
        stats: This party's cost, with what was run again after a broken connection.
        jobs: Jobs used, with those that were lost with a connection.
        batch: Number of the batch.
    """

    decisions: npt.NDArray[Any]
    decided: npt.NDArray[np.bool_]
    stats: Stats
    jobs: int
    batch: int = 0

    @property
    def pairs(self) -> int:
        """Comparisons made."""
        return int(np.count_nonzero(self.decided))

    @property
    def complete(self) -> bool:
        """Whether every pair has been decided."""
        return bool(self.decided.all())

    @property
    def blocks(self) -> list[tuple[range, range]]:
        """Which pairs have been decided, as few rectangles: (own positions, the peer's positions)."""
        found, start = [], 0
        if not self.decided.size:
            return []
        changes = np.flatnonzero((self.decided[1:] != self.decided[:-1]).any(axis=1)) + 1
        for stop in [*changes.tolist(), len(self.decided)]:
            edges = np.flatnonzero(np.diff(self.decided[start].astype(np.int8), prepend=0, append=0)).tolist()
            rows = range(start, stop)
            found += [(rows, range(*pair)) for pair in zip(edges[::2], edges[1::2], strict=True)]
            start = stop
        return found


class Batch:
    """A batch of own descriptors and what is known of its comparison with the peer's.

    Args:
        number: Its number, the same on both sides (also an attribute).
        own: Own descriptors, shape (n, N); n may be 0.
        purpose: What the tapes were dealt for.
        party: 0 or 1.

    Attributes:
        token: Random; tells the peer whether it has met this very batch before.
        met: The token of the peer's batch that the state below is about; empty if there is none.
        done: Tiles decided.
    """

    def __init__(self, number: int, own: npt.NDArray[Any], purpose: Purpose, party: int) -> None:
        self.number, self.token, self.met, self.done = number, secrets.token_hex(8), "", 0
        self._own, self._purpose, self._party = own, purpose, party
        self._stats, self._jobs, self._ended = Stats(), 0, False
        self._lay_out(0)

    def __len__(self) -> int:
        """Own descriptors."""
        return len(self._own)

    def holds(self, own: npt.NDArray[Any]) -> bool:
        """Whether these are its own descriptors."""
        return bool(np.array_equal(self._own, own))

    @property
    def tiles(self) -> int:
        """Tiles that cover all pairs with the peer's batch that was met."""
        return self._blocks[0] * self._blocks[1]

    @property
    def matches(self) -> Matches:
        """What has been decided so far."""
        stats = Stats()
        stats.add(self._stats)
        return Matches(self._table, self._decided, stats, self._jobs, self.number)

    def meet(self, token: str, count: int, done: int, jobs_left: int) -> None:
        """Go on against the peer's batch of this number.

        Args:
            token: The peer's batch's token.
            count: Its number of descriptors.
            done: Tiles that both sides have decided; 0 unless both have met this very batch before.
            jobs_left: On the tapes.

        A robot that was restarted brings the same batch under another token. All tiles are run again for it,
        and what was decided here stays.

        Raises:
            OutOfStep: if something has been decided against another number of descriptors.
            TapeExhausted: if the tapes cannot finish the batch; nothing has changed. Both find the same.
                It also bounds what a peer's number makes this side allocate.
        """
        before = self._decided.shape[1]
        if count != before and (self._ended or self._decided.any()):
            raise OutOfStep(
                f"the peer's batch {self.number} had {before} descriptors, and now it has {count}: a robot "
                "that was restarted goes on with the same batch"
            )
        first, second = self._cover(count)
        needed = first * second - (min(self.done, done) if token == self.met else 0)
        if needed > jobs_left:
            raise TapeExhausted(
                f"{len(self._own)} x {count} descriptors need {needed} job{'s' * (needed != 1)} of "
                f"{self._purpose.pairs} comparisons, and {jobs_left} are left; deal more with "
                "`python -m spdz.dealer` (a larger --count, or --tile for fewer bytes)"
            )
        if count != before:
            self._lay_out(count)
        self.done = min(self.done, done) if token == self.met else 0
        self.met = token

    def run(
        self,
        session: Session,
        program: Program,
        together: int,
        on_block: Callable[[Block], None] = lambda block: None,
    ) -> Iterator[int]:
        """Compare what is left.

        Args:
            session: An open session.
            program: What a job computes.
            together: How many tiles share rounds (:func:`tiles_together`).
            on_block: Called with every block of pairs as soon as it is decided, once.

        Yields:
            The number of tiles done, after each exchange of several.
        """
        tile = self._purpose.tile[self._party], self._purpose.tile[1 - self._party]
        shape = session.shapes[self._party]
        while self.done < self.tiles:
            places = [self._place(k) for k in range(self.done, min(self.done + together, self.tiles))]
            left = session.remaining
            try:
                result = session.run_many(program, [self._rows(i, tile[0]).reshape(shape) for i, _ in places])
            finally:
                self._jobs += left - session.remaining
            self._stats.add(result.stats)
            for (i, j), value in zip(places, result.value, strict=True):
                rows = range(i * tile[0], min((i + 1) * tile[0], len(self._own)))
                columns = range(j * tile[1], min((j + 1) * tile[1], self._decided.shape[1]))
                decided = value if self._party == 0 else value.T
                self._decide(
                    Block(self.number, rows, columns, decided[: len(rows), : len(columns)]), on_block
                )
                self.done += 1
            yield self.done
        self._ended = True

    def _lay_out(self, count: int) -> None:
        """Cover all pairs with tiles; nothing is decided."""
        self._blocks, self.done = self._cover(count), 0
        kind = np.bool_ if self._purpose.reveal == "bit" else np.float64
        self._table = np.zeros((len(self._own), count), kind)
        self._decided = np.zeros(self._table.shape, np.bool_)

    def _cover(self, count: int) -> tuple[int, int]:
        """Blocks of own and of the peer's descriptors that tiles are made of."""
        own, theirs = self._purpose.tile[self._party], self._purpose.tile[1 - self._party]
        return -(-len(self._own) // own), -(-count // theirs)

    def _place(self, k: int) -> tuple[int, int]:
        """Own and peer's block of tile k: both sides walk party 0's blocks, and party 1's within each."""
        if self._party == 0:
            return divmod(k, self._blocks[1])
        theirs, own = divmod(k, self._blocks[0])
        return own, theirs

    def _decide(self, block: Block, on_block: Callable[[Block], None]) -> None:
        """Keep the first decision: a tile that the peer has missed is run again for the peer alone."""
        where = slice(block.rows.start, block.rows.stop), slice(block.columns.start, block.columns.stop)
        if not self._decided[where].all():
            self._table[where] = block.decisions
            self._decided[where] = True
            on_block(block)

    def _rows(self, i: int, size: int) -> npt.NDArray[Any]:
        """Block i of the own descriptors, filled up with copies of the last one."""
        block = self._own[i * size : (i + 1) * size]
        return np.concatenate([block, np.repeat(self._own[-1:], size - len(block), axis=0)])


def tiles_together(purpose: Purpose, program: Program, security: Security) -> int:
    """How many tiles share rounds: enough to fill a round trip, few enough that a lost one costs little."""
    plan = measure(program, purpose.shapes, security)
    return jobs_together(purpose.tile, purpose.dim, plan.correction_bytes)
