"""Both parties over one emulated link: each cell's comparison, its bare floor, and the plaintext exchange.

Both start every trial together, at a barrier that is not part of the link. On a slow link two parties that do
not would stay apart: who is late finds the other's frame waiting, and the other one waits for both.
"""

from __future__ import annotations

import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import numpy as np

from bench.links.emulation import Ends, emulated
from bench.links.link import Link
from bench.parties import Note, pin, run_processes
from bench.sweep.floor import Frames, bare_socket, bare_trials, both_directions, recorded_frames
from dealer.tapes import deal_tapes
from protocols.scores import SCORES
from spdz.channels import Channel
from spdz.channels.tcp import connect, listen
from spdz.foundations.stats import Stats
from spdz.foundations.types import Security
from spdz.readings.clear import Clear
from spdz.readings.meter import measure
from spdz.readings.program import Program, declare, quantise, run
from spdz.rounds.mac_check import drive
from spdz.session import Session
from spdz.session.driver import run_channel
from spdz.tape import Tape

WARM_UP = 1
"""Uncounted comparisons on a connection before the counted ones, and uncounted replays of the floor."""

_MAX_NORM = 1.0
_WAIT = 60.0
_PROBES = 3
_PROBE_SECONDS = 0.25
_TOLERATED = 0.95


@dataclass(frozen=True, slots=True)
class Cell:
    """What is compared over the link; ``security`` None is the plaintext exchange."""

    score: str
    n: int
    security: Security | None


@dataclass(frozen=True, slots=True)
class Timed:
    """One party's figures of a cell: seconds a trial, those of the bare floor, and what a comparison sent."""

    seconds: list[float]
    floor: list[float]
    stats: Stats


@dataclass(frozen=True, slots=True)
class Figures:
    """Both parties' figures of a cell, in milliseconds of the slower one: medians, and the longest trial."""

    ms: float
    max_ms: float
    floor_ms: float
    trials: int
    bytes_sent: int
    rounds: int


@dataclass(frozen=True, slots=True)
class _Task:
    cells: Sequence[Cell]
    trials: Sequence[int]
    inputs: dict[int, tuple[Any, Any]]
    ends: Ends
    folder: Path
    probe_bytes: int
    together: Barrier


class LinkError(Exception):
    """The emulated link is not what it should be."""


def trials_for(cell: Cell, link: Link, most: int, seconds: float) -> int:
    """How many trials of a cell fit into some seconds, going by its rounds and bytes; at least one."""
    if cell.security is None:
        least = link.least_ms(1, 8 * cell.n)
    else:
        plan = measure(_program(cell), ((cell.n,), (cell.n,)), cell.security)
        least = link.least_ms(plan.rounds, max(plan.elements_sent) * 16)
    return max(1, min(most, int(seconds * 1e3 / (least + 1))))


def measure_link(
    link: Link,
    via: str,
    cells: Sequence[Cell],
    inputs: dict[int, tuple[Any, Any]],
    on_cell: Callable[[Cell, Figures, float], None],
    *,
    most: int = 10,
    seconds: float = 4.0,
) -> None:
    """Measure cells over a link, one after the other, in one pair of processes.

    Args:
        link: The link.
        via: How it is emulated: of :data:`bench.links.emulation.VIAS`.
        cells: What to measure.
        inputs: Both parties' vectors, of norm 1, by length.
        on_cell: Called with a cell, its figures, and the link's measured round trip in milliseconds.
        most: Trials of a cell at most.
        seconds: Its time limit: fewer trials where the link is slow, at least one.

    Raises:
        OSError: if the link cannot be emulated.
        LinkError: if what is emulated is quicker than the link: then no figure holds.
    """
    trials = [trials_for(cell, link, most, seconds) for cell in cells]
    together = multiprocessing.get_context("spawn").Barrier(2)
    probe = round(link.mbit * 1e6 / 8 * _PROBE_SECONDS)
    with tempfile.TemporaryDirectory(prefix="spdz-links-") as folder, emulated(link, via) as ends:
        task = _Task(cells, trials, inputs, ends, Path(folder), probe, together)
        for number in range(len(cells)):
            _deal(task, number)
        meeting = _Meeting(link, cells, probe, on_cell)
        run_processes(_party, task, on_note=meeting.hear)


class _Meeting:
    """Puts together what both parties tell, cell by cell; the link's own probe comes first."""

    def __init__(
        self, link: Link, cells: Sequence[Cell], probe: int, on_cell: Callable[[Cell, Figures, float], None]
    ) -> None:
        self._link, self._cells, self._probe, self._on_cell = link, cells, probe, on_cell
        self._heard: tuple[list[Any], list[Any]] = ([], [])
        self._done = 0
        self._round_trip = 0.0

    def hear(self, index: int, what: Any) -> None:
        self._heard[index].append(what)
        while min(map(len, self._heard)) > self._done:
            first, second = (heard[self._done] for heard in self._heard)
            if self._done == 0:
                self._round_trip = checked_probe(self._link, self._probe, *first)
            else:
                self._on_cell(self._cells[self._done - 1], figures(first, second), round(self._round_trip, 2))
            self._done += 1


def figures(first: Timed, second: Timed) -> Figures:
    """Both parties' figures put together: of each trial, the slower party."""
    slower = [max(pair) * 1e3 for pair in zip(first.seconds, second.seconds, strict=True)]
    floor = [max(pair) * 1e3 for pair in zip(first.floor, second.floor, strict=True)]
    return Figures(
        ms=round(statistics.median(slower), 3),
        max_ms=round(max(slower), 3),
        floor_ms=round(statistics.median(floor), 3),
        trials=len(slower),
        bytes_sent=max(first.stats.bytes_sent, second.stats.bytes_sent),
        rounds=first.stats.rounds,
    )


def checked_probe(link: Link, size: int, pings: Sequence[float], there: float, back: float) -> float:
    """The measured round trip in milliseconds.

    Args:
        link: The link that should be emulated.
        size: Bytes of the long message.
        pings: Seconds of a byte there and a byte back.
        there: Seconds of a long message from party 0 and a byte back.
        back: Seconds of a byte from party 0 and a long message back.

    Raises:
        LinkError: if a byte or a long message is quicker than the link allows.
    """
    trip = statistics.median(pings) * 1e3
    least = link.least_ms(2, 0) * _TOLERATED, link.least_ms(2, size) * _TOLERATED
    if trip < least[0] or min(there, back) * 1e3 < least[1]:
        raise LinkError(
            f"the emulated link {link.name} is too quick: {trip:.2f} ms there and back (at least "
            f"{least[0]:.2f}), {there * 1e3:.1f} and {back * 1e3:.1f} ms for {size} bytes (at least "
            f"{least[1]:.1f}). "
            "Choose another emulation: --via tun or --via proxy"
        )
    return trip


# -- in the parties' processes -------------------------------------------------------------------------------


def _paths(folder: Path, number: int) -> tuple[Path, Path]:
    return Path(folder, f"{number}-0.tape"), Path(folder, f"{number}-1.tape")


def _program(cell: Cell) -> Program:
    return SCORES[cell.score].within(_MAX_NORM)


def _deal(task: _Task, number: int) -> None:
    cell = task.cells[number]
    if cell.security is not None:
        jobs = task.trials[number] + WARM_UP
        shapes = ((cell.n,), (cell.n,))
        paths = _paths(task.folder, number)
        deal_tapes(paths, ("zero", "one"), _program(cell), shapes, jobs, cell.security)


def _party(index: int, task: _Task, pipe: Any) -> None:
    pin(index)
    pipe.send(Note(_probe(index, task)))
    for number, cell in enumerate(task.cells):
        trials = task.trials[number]
        seconds, frames, stats = (_plain if cell.security is None else _secure)(index, task, number, trials)
        floor = _bare(index, task, both_directions(frames, index), trials)
        pipe.send(Note(Timed(seconds, floor, stats)))
    pipe.send(None)


def _probe(index: int, task: _Task) -> tuple[list[float], float, float]:
    size = task.probe_bytes
    pings = _bare(index, task, [(1, 0), (0, 1)], _PROBES)
    (there,) = _bare(index, task, [(size, 0), (0, 1)], 1, warm_up=0)
    (back,) = _bare(index, task, [(1, 0), (0, size)], 1, warm_up=0)
    return pings, there, back


def _bare(index: int, task: _Task, frames: Frames, trials: int, warm_up: int = WARM_UP) -> list[float]:
    host, port = task.ends.listens if index == 0 else task.ends.calls
    with bare_socket(index, port, host) as sock:
        bare_trials(sock, index, frames, warm_up, 0)
        return [_started(task, lambda: bare_trials(sock, index, frames, 1, 0)) for _ in range(trials)]


def _started(task: _Task, once: Callable[[], Any]) -> float:
    """Seconds of a trial that both parties start together."""
    task.together.wait(_WAIT)
    started = time.perf_counter()
    once()
    return time.perf_counter() - started


def _channel(index: int, task: _Task) -> Channel:
    host, port = task.ends.listens if index == 0 else task.ends.calls
    address = f"{host}:{port}"
    return listen(address, wait=_WAIT) if index == 0 else connect(address, wait=_WAIT)


_Run = tuple[list[float], list[tuple[int, int]], Stats]


def _timed(task: _Task, channel: Channel, trials: int, once: Callable[[], Stats]) -> _Run:
    """Warm up, noting the frames, and time the trials."""
    with recorded_frames(channel) as frames:
        stats = once()
    for _ in range(WARM_UP - 1):
        once()
    return [_started(task, once) for _ in range(trials)], list(frames), stats


def _secure(index: int, task: _Task, number: int, trials: int) -> _Run:
    """As :mod:`bench.pair` times it: from floats to the opened and checked result."""
    cell = task.cells[number]
    program, vector = _program(cell), task.inputs[cell.n][index]
    tape = Tape.open(_paths(task.folder, number)[index], state_dir=task.folder / f"state-{index}")
    channel = _channel(index, task)
    with Session(tape, channel) as session:
        session.reserve(trials + WARM_UP, program)
        return _timed(task, channel, trials, lambda: session.run(program, vector).stats)


def _plain(index: int, task: _Task, number: int, trials: int) -> _Run:
    """Both send their descriptor as it is."""
    cell = task.cells[number]
    program, vector = _program(cell), task.inputs[cell.n][index]
    shapes = (np.shape(vector), np.shape(vector))
    with _channel(index, task) as channel:

        def once() -> Stats:
            stats = Stats()
            inputs = declare(program, shapes, {index: quantise(program, vector, "x")})
            run_channel(drive(run(Clear(index), program, inputs), None), channel, stats)
            return stats

        return _timed(task, channel, trials, once)
