"""Measure the ratios that are guarded, all in one pair of processes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from math import inf
from pathlib import Path

from bench.check.ratios import Key
from bench.inputs import draw
from bench.parties import free_port
from bench.sweep.floor import WARM_UP
from bench.sweep.parties import SecureWork
from bench.sweep.standing import StandingPair
from dealer.tapes import deal_tapes
from protocols.scores import SCORES
from protocols.textbook import TEXTBOOK
from spdz.foundations.types import SECURITIES, Security
from spdz.readings.program import Program

Cell = tuple[str, int, Security]

CELLS: tuple[Cell, ...] = tuple(
    (score, n, security)
    for n, scores in ((16, tuple(SCORES)), (1536, ("S2", "S4", "S6", "S7", "S10")), (8192, ("S2", "S10")))
    for score in scores
    for security in SECURITIES
)
"""What is guarded: every score where the engine's own work is all there is, and the paper's extremes."""

BLOCKS = 3
"""Blocks of trials of a check; twice as many for ratios that are to be committed."""

_MAX_NORM = 1.0
_COORDINATES = 1 << 17
_MOST_TRIALS, _FEWEST_TRIALS = 30, 16


def trials_of(n: int) -> int:
    """Counted comparisons of a repetition: fewer of long descriptors, whose tapes are large."""
    return max(_FEWEST_TRIALS, min(_MOST_TRIALS, _COORDINATES // n))


def keys_of(cell: Cell) -> list[Key]:
    """The ratios of a cell."""
    return [Key(*cell, "floor"), *([Key(*cell, "textbook")] if cell[0] in TEXTBOOK else [])]


def measure(cells: Iterable[Cell], blocks: int, on_cell: Callable[[Cell], None]) -> dict[Key, float]:
    """The ratios of cells: the least time of ours over the least of the other.

    The least of many trials is what no neighbour on the machine disturbed. It moves by a quarter where
    medians move fivefold. The trials come in blocks, with all other cells between them.

    Args:
        cells: What to measure.
        blocks: How many.
        on_cell: Called before each block of each cell.

    Raises:
        RuntimeError: if a measured process died.
    """
    wanted = list(cells)
    ours: dict[Cell, float] = dict.fromkeys(wanted, inf)
    others: dict[Key, float] = {key: inf for cell in wanted for key in keys_of(cell)}
    with StandingPair() as pair:
        for _ in range(blocks):
            for cell in wanted:
                on_cell(cell)
                score, n, security = cell
                time, floor = _least(pair, SCORES[score].within(_MAX_NORM), n, security)
                ours[cell] = min(ours[cell], time)
                others[Key(*cell, "floor")] = min(others[Key(*cell, "floor")], floor)
                if score in TEXTBOOK:
                    key = Key(*cell, "textbook")
                    time, _ = _least(pair, TEXTBOOK[score].within(_MAX_NORM), n, security)
                    others[key] = min(others[key], time)
    return {key: round(ours[cell] / others[key], 3) for cell in wanted for key in keys_of(cell)}


def _least(pair: StandingPair, program: Program, n: int, security: Security) -> tuple[float, float]:
    """The least seconds of a comparison, and of its frames over a bare socket; the slower party's."""
    trials = trials_of(n)
    vectors = draw("unit", trials, n, seed=1)
    with tempfile.TemporaryDirectory(prefix="spdz-check-") as folder:
        paths, state = (Path(folder, "0.tape"), Path(folder, "1.tape")), Path(folder, "state")
        deal_tapes(paths, ("zero", "one"), program, ((n,), (n,)), WARM_UP + trials + 1, security)
        port = free_port()
        first, second = pair.run(
            SecureWork(program, vectors[0], port, paths[0], state),
            SecureWork(program, vectors[1], port, paths[1], state),
        )
    ours = min(map(max, zip(first.seconds, second.seconds, strict=True)))
    return ours, min(map(max, zip(first.floor, second.floor, strict=True)))
