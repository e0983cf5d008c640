"""Every descriptor of one robot against every descriptor of the other.

The grid of pairs is covered with the tapes' tiles. Within a tile each descriptor is masked and sent once,
and each pair costs one dealt scalar, one opened element and (for a candidate bit) one DCF key. Tiles at the
border are filled up with copies of the last descriptor. Several tiles travel in the same rounds.

What the peer learns besides the results: how many descriptors there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from protocols.catalog import Purpose
from spdz.errors import ProtocolViolation, TapeExhausted
from spdz.meter import measure
from spdz.program import Program, quantise
from spdz.session import Session
from spdz.stats import Stats
from spdz.tape import TapeHeader

_BATCH_BYTES = 2 << 20
"""Tiles share rounds up to about this many bytes of masked descriptors."""

_BATCH_DEALT_BYTES = 64 << 20
"""... this many dealt bytes, which are read ahead,"""

_BATCH_JOBS = 64
"""... and up to this many jobs, so that one lost batch costs little."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Result of a matching.

    Attributes:
        decisions: (own, peer's) array: booleans, or scores where the tapes reveal scores.
        stats: This party's cost.
        jobs: Jobs used.
    """

    decisions: npt.NDArray[Any]
    stats: Stats
    jobs: int

    @property
    def pairs(self) -> int:
        """Comparisons made."""
        return int(self.decisions.size)


def match(
    session: Session,
    descriptors: npt.ArrayLike,
    threshold: float | None = None,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Matches:
    """Compare all own descriptors with all of the peer's. Both robots call this at the same time.

    Args:
        session: An open session.
        descriptors: Own descriptors, shape (n, N).
        threshold: Public threshold in the score's units, the same on both sides (None where the tapes
            reveal scores).
        progress: Called with jobs done and jobs in all.

    Returns:
        Which pairs match.

    Raises:
        ValueError: for bad descriptors; nothing is consumed.
        TapeExhausted: if the tapes do not hold enough jobs for all pairs; nothing is consumed.
        SpdzError: if anything else goes wrong; the session is dead.
    """
    purpose, program, own = check(session.header, descriptors, threshold)
    note = session.exchange_note({"descriptors": len(own)})
    theirs = note.get("descriptors")
    if type(theirs) is not int or not 1 <= theirs <= 1 << 24:
        raise ProtocolViolation("the peer's number of descriptors is not a sensible number")
    own_axis, peer_axis = session.party, 1 - session.party
    peer_blocks = -(-theirs // purpose.tile[peer_axis])
    needed = -(-len(own) // purpose.tile[own_axis]) * peer_blocks
    if needed > session.remaining:
        raise TapeExhausted(
            f"{len(own)} x {theirs} descriptors need {needed} jobs of {purpose.pairs} comparisons, and "
            f"{session.remaining} are left; deal more with `python -m spdz.dealer` (a larger --count, or "
            "--tile for fewer bytes)"
        )
    own_blocks = _blocks(own, purpose.tile[own_axis])
    grid = [(i, j) for i in range(len(own_blocks)) for j in range(peer_blocks)]
    if session.party == 1:  # both sides walk the grid in the order of party 0
        grid.sort(key=lambda place: (place[1], place[0]))
    kind = np.bool_ if purpose.reveal == "bit" else np.float64
    table = np.zeros((len(own_blocks) * purpose.tile[own_axis], peer_blocks * purpose.tile[peer_axis]), kind)
    stats, done = Stats(), 0
    shape = session.shapes[session.party]
    dealt = max(measure(program, session.shapes, session.header.security).correction_bytes)
    masked = 16 * own.shape[1] * max(purpose.tile)
    batch = max(1, min(_BATCH_JOBS, _BATCH_BYTES // masked, _BATCH_DEALT_BYTES // max(dealt, 1)))
    while done < len(grid):
        places = grid[done : done + batch]
        result = session.run_many(program, [own_blocks[i].reshape(shape) for i, _ in places])
        for (i, j), value in zip(places, result.value, strict=True):
            rows, columns = purpose.tile[own_axis], purpose.tile[peer_axis]
            block = value if session.party == 0 else value.T
            table[i * rows : (i + 1) * rows, j * columns : (j + 1) * columns] = block
        stats.add(result.stats)
        done += len(places)
        progress(done, len(grid))
    return Matches(table[: len(own), :theirs], stats, len(grid))


def check(
    header: TapeHeader, descriptors: npt.ArrayLike, threshold: float | None
) -> tuple[Purpose, Program, npt.NDArray[Any]]:
    """Whether descriptors and threshold suit a tape, as far as this robot can tell alone.

    Returns:
        The tape's purpose, the program to run, and the descriptors as an array.

    Raises:
        ValueError: naming what does not suit.
    """
    purpose = Purpose.from_json(header.program)
    program = purpose.program(threshold)
    own = np.asarray(descriptors)
    if own.ndim != 2 or own.shape[1] != purpose.dim or len(own) == 0:
        raise ValueError(
            f"expected descriptors of shape (n, {purpose.dim}) with n >= 1 for these tapes, got {own.shape}"
        )
    quantise(program, own, "descriptors")
    return purpose, program, own


def _blocks(descriptors: npt.NDArray[Any], size: int) -> list[npt.NDArray[Any]]:
    """Cut into blocks of ``size`` rows, the last one filled up with copies of the last descriptor.

    Every result is opened, those of the filling too: for a zero row they would tell the peer's norms.
    """
    missing = -len(descriptors) % size
    padded = np.concatenate([descriptors, np.repeat(descriptors[-1:], missing, axis=0)])
    return [padded[start : start + size] for start in range(0, len(padded), size)]
