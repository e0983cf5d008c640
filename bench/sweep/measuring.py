"""One cell of the sweep: deal for it, have it measured, and put the figures of both parties together."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from bench.exact import ONE, exact_score, raw
from bench.inputs import draw
from bench.parties import free_port
from bench.sweep.baseline import Baseline
from bench.sweep.cells import Cell
from bench.sweep.floor import WARM_UP, Frames
from bench.sweep.parties import ClearWork, Figures, SecureWork
from bench.sweep.phases import scaled
from bench.sweep.results import PROFILED, Trial
from bench.sweep.standing import StandingPair
from dealer.tapes import deal_tapes
from protocols.scores import SCORES
from spdz.console.progress import progress_bar
from spdz.foundations.types import SECURITIES, FloatArray
from spdz.tape import Tape

MAX_NORM = 1.0
"""The largest norm that the tapes serve: descriptors are unit vectors."""


@dataclass(frozen=True, slots=True)
class Bench:
    """What every cell is measured with.

    Attributes:
        pair: The two processes.
        baseline: The C++ baseline; None without a compiler.
        folder: Where tapes lie while they are used.
        trials: Counted trials of a cell.
        seed: Of the descriptors.
        quiet: Show no progress of dealing. While trials run there is none: it would disturb them.
    """

    pair: StandingPair
    baseline: Baseline | None
    folder: Path
    trials: int
    seed: int
    quiet: bool = True

    def measure(self, cell: Cell, place: str = "") -> list[Trial]:
        """All trials of a cell.

        Args:
            cell: The cell.
            place: Which of how many it is, for the progress line.

        Raises:
            RuntimeError: if a process died, or both parties did not send the same frames.
            ValueError: if the cell cannot be dealt for, or needs the C++ baseline that is not there.
            subprocess.SubprocessError: if the C++ baseline fails.
        """
        if cell.protocol in SECURITIES:
            return self._secure(cell, place)
        if cell.protocol == "numpy":
            x, y = self._pairs(cell.n)
            port = free_port()
            works = ClearWork(cell.score, x, port), ClearWork(cell.score, y, port)
            return self._trials(cell, self.pair.run(*works), [0, 0])
        return self._cpp(cell)

    def _pairs(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Unit vectors on the engine's grid, shape (trials, n) each: all protocols get the same numbers."""
        x, y = (np.rint(half * ONE) / ONE for half in draw("unit", self.trials, n, self.seed))
        return x, y

    def _secure(self, cell: Cell, place: str) -> list[Trial]:
        program, (x, y) = SCORES[cell.score].within(MAX_NORM), self._pairs(cell.n)
        security = next(one for one in SECURITIES if one == cell.protocol)
        jobs = WARM_UP + self.trials + 1
        with tempfile.TemporaryDirectory(prefix="tapes-", dir=self.folder) as folder:
            paths, state = (Path(folder, "0.tape"), Path(folder, "1.tape")), Path(folder, "state")
            with progress_bar(f"{place} {cell}: dealing", quiet=self.quiet) as report:
                deal_tapes(
                    paths,
                    ("zero", "one"),
                    program,
                    ((cell.n,), (cell.n,)),
                    jobs,
                    security,
                    progress=lambda dealt: report(dealt, jobs),
                )
            stored = []
            for path in paths:
                with Tape.open(path, state_dir=state) as tape:
                    stored.append(tape.header.correction_bytes)
            port = free_port()
            works = [
                SecureWork(program, half, port, path, state) for half, path in zip((x, y), paths, strict=True)
            ]
            figures = self.pair.run(works[0], works[1])
        trials = [trial.but(**_ahead(figures)) for trial in self._trials(cell, figures, stored)]
        return [*trials, _profiled(trials, figures[0])]

    def _trials(self, cell: Cell, figures: tuple[Figures, Figures], stored: Sequence[int]) -> list[Trial]:
        first, second = figures
        if first.frames != second.frames:
            raise RuntimeError("the two parties disagree about the frames that they exchanged")
        floor = statistics.median(map(max, zip(first.floor, second.floor, strict=True)))
        values = zip(first.values, second.values, strict=True)
        seconds = map(max, zip(first.seconds, second.seconds, strict=True))
        exact = self._exact(cell)
        return [
            _trial(
                cell,
                number,
                time,
                first.frames,
                stored,
                error=max(abs(value - exact[number]) for value in both),
                floor=floor,
            )
            for number, (time, both) in enumerate(zip(seconds, values, strict=True))
        ]

    def _cpp(self, cell: Cell) -> list[Trial]:
        if self.baseline is None:
            raise ValueError("there is no C++ compiler")
        values, seconds = self.baseline.measure(cell.score, *self._pairs(cell.n))
        sent, exact = [(8 * cell.n, 8 * cell.n)], self._exact(cell)
        return [
            _trial(cell, number, time, sent, [0, 0], error=abs(value - exact[number]), floor=None)
            for number, (value, time) in enumerate(zip(values, seconds, strict=True))
        ]

    def _exact(self, cell: Cell) -> tuple[float, ...]:
        return _exact_scores(cell.score, cell.n, self.trials, self.seed)


@lru_cache(maxsize=1)  # the protocols of a score and a length follow each other
def _exact_scores(score: str, n: int, trials: int, seed: int) -> tuple[float, ...]:
    pairs = zip(*draw("unit", trials, n, seed), strict=True)
    return tuple(float(exact_score(score, raw(x), raw(y))) for x, y in pairs)


def _trial(
    cell: Cell,
    number: int,
    seconds: float,
    frames: Frames,
    stored: Sequence[int],
    *,
    error: float,
    floor: float | None,
) -> Trial:
    return Trial(
        protocol=cell.protocol,
        score=cell.score,
        n=cell.n,
        trial=number,
        ms=_ms(seconds),
        bytes_sent=[sum(pair[party] for pair in frames) for party in (0, 1)],
        rounds=len(frames),
        messages=2 * len(frames),
        tape_bytes=list(stored),
        error=error,
        floor_ms=None if floor is None else _ms(floor),
    )


def _ahead(figures: tuple[Figures, Figures]) -> dict[str, float]:
    """What was done before the trials, of the slower party: it is the same of all of a cell."""
    found = [one.ahead for one in figures if one.ahead is not None]
    return {
        "ahead_ms": _ms(max(one.a_job for one in found)),
        "compile_ms": _ms(max(one.compiling for one in found)),
    }


def _profiled(trials: Sequence[Trial], figures: Figures) -> Trial:
    """The extra trial: its phases, scaled to what the cell takes without a profiler."""
    median = statistics.median(trial.ms for trial in trials)
    return trials[0].but(
        trial=PROFILED,
        ms=_ms(figures.profiled),
        error=None,
        phases={phase: round(value, 6) for phase, value in scaled(figures.phases, median).items()},
    )


def _ms(seconds: float) -> float:
    return round(seconds * 1e3, 9)
