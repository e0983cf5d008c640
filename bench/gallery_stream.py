"""Keyframes that keep coming on both sides, all compared with all: do the robots keep up?"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench import gallery_tapes as tapes
from bench.parties import Note, free_port, memory, pin, run_processes
from spdz.console.progress import Report

STRETCHES = 10
"""Lines that a stream prints."""


@dataclass(frozen=True, slots=True)
class StreamRow:
    """A stretch of a stream. Of what the parties differ in it is the larger one's.

    Attributes:
        n: Length of a descriptor.
        security: The security model.
        rate: Keyframes a second on either side.
        second: End of the stretch, since the start.
        keyframes: Compared so far, of both sides.
        pairs: Compared so far.
        backlog: Most own keyframes that had come and were not compared when a step ended.
        delay_ms: From a keyframe's coming to checked and durable bits: median, 95 %, largest.
        rss_mb: Memory of each party's process at the end, in MB; 0 where the system does not tell.
    """

    n: int
    security: str
    rate: float
    second: float
    keyframes: int
    pairs: int
    backlog: int
    delay_ms: tuple[float, float, float]
    rss_mb: tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Task:
    folder: Path
    asked: tapes.Asked
    port: int
    rate: float
    count: int


@dataclass(frozen=True, slots=True)
class _Stretch:
    """One party's part of a row."""

    second: float
    keyframes: int
    pairs: int
    backlog: int
    delays: list[float]
    rss_mb: float


def measure_stream(
    asked: tapes.Asked,
    rate: float,
    seconds: float,
    *,
    dealing: AbstractContextManager[Report],
    on_row: Callable[[StreamRow], None],
) -> None:
    """Deal, then let keyframes come on both sides.

    Args:
        asked: What to measure.
        rate: Keyframes a second on either side.
        seconds: How long.
        dealing: Gives what is told of the progress of dealing.
        on_row: Called with every stretch as it ends.
    """
    count = max(1, round(rate * seconds))
    waiting: tuple[list[_Stretch], list[_Stretch]] = ([], [])

    def note(index: int, stretch: _Stretch) -> None:
        waiting[index].append(stretch)
        if all(waiting):
            on_row(_row(asked, rate, waiting[0].pop(0), waiting[1].pop(0)))

    with TemporaryDirectory(prefix="spdz-bench-") as temporary:
        folder = Path(temporary)
        with dealing as report:
            tapes.deal(tapes.Dealing((folder,), asked, (count, count)), report)
        run_processes(_party, _Task(folder, asked, free_port(), rate, count), on_note=note)


def _row(asked: tapes.Asked, rate: float, first: _Stretch, second: _Stretch) -> StreamRow:
    delays = np.array(first.delays + second.delays) * 1e3
    middle, most, largest = (round(float(ms), 1) for ms in np.percentile(delays, [50, 95, 100]))
    return StreamRow(
        n=asked.purpose.dim,
        security=asked.security,
        rate=rate,
        second=round(max(first.second, second.second), 1),
        keyframes=first.keyframes,
        pairs=first.pairs,
        backlog=max(first.backlog, second.backlog),
        delay_ms=(middle, most, largest),
        rss_mb=(first.rss_mb, second.rss_mb),
    )


def _party(index: int, task: _Task, pipe: Any) -> None:
    """Add what has come, step, and again; both see the same numbers, so both end after the same step."""
    pin(index)
    generator = np.random.default_rng([task.asked.seed, index])
    with tapes.open_side(task.folder, index, task.asked, task.port) as gallery:
        gallery.step()
        started = time.perf_counter()
        added, own, peer, pairs = 0, 0, 0, 0
        backlog, delays, stretches = 0, [], 0
        while own < task.count or peer < task.count:
            if index == 0:  # the peer waits for this side's next step
                time.sleep(max(0.0, started + min(own, peer) / task.rate - time.perf_counter()))
            come = min(task.count, math.floor((time.perf_counter() - started) * task.rate) + 1)
            rows = tapes.unit(generator.standard_normal((come - added, task.asked.purpose.dim)))
            gallery.add(rows)
            added = come
            step = gallery.step()
            now = time.perf_counter() - started
            delays += [now - k / task.rate for k in range(own, own + len(step.own))]
            own, peer = own + len(step.own), peer + len(step.peer)
            pairs += sum(block.results.size for block in step.blocks)
            backlog = max(backlog, min(task.count, math.floor(now * task.rate) + 1) - own)
            # What both sides know decides where a stretch ends.
            if (own + peer) * STRETCHES >= 2 * task.count * (stretches + 1):
                pipe.send(Note(_Stretch(now, own + peer, pairs, backlog, delays, memory())))
                backlog, delays = 0, []
                stretches = (own + peer) * STRETCHES // (2 * task.count)
    pipe.send(None)
