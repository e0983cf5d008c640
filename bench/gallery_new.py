"""A keyframe comes, and many descriptors of the other robot stand: how long, and how much memory."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench import gallery_tapes as tapes
from bench.parties import Note, free_port, most_memory, pin, run_processes
from spdz.console.progress import Report
from spdz.foundations.types import FloatArray

_TOGETHER = 250
"""Descriptors that come together until all stand."""


@dataclass(frozen=True, slots=True)
class NewRow:
    """Keyframes against descriptors that stand. Of what the parties differ in it is the larger one's.

    Attributes:
        n: Length of a descriptor.
        new: Keyframes that come at a time, at party 0.
        stored: Descriptors that stand, at party 1.
        security: The security model.
        resolution: ``2^-16``, or ``exact``.
        median_ms: From the plain descriptor to bits that are checked and durable.
        min_ms: The quickest.
        max_ms: The slowest.
        comparing_ms: The median of comparing alone; the rest masks, sends, and proves.
        bytes_sent: Bytes sent a time.
        tape_bytes: Size of a tape.
        max_rss_mb: Most memory of each party's process, in MB, Python and NumPy included.
        differ: Decisions unlike the clear ones by more than the resolution.
        engine: ``spdz``.
        threshold: Of the decisions.
        trials: Arrivals counted; one more warms up.
    """

    n: int
    new: int
    stored: int
    security: str
    resolution: str
    median_ms: float
    min_ms: float
    max_ms: float
    comparing_ms: float
    bytes_sent: int
    tape_bytes: int
    max_rss_mb: tuple[float, float]
    differ: int
    engine: str
    threshold: float
    trials: int


@dataclass(frozen=True, slots=True)
class _Task:
    folder: Path
    asked: tapes.Asked
    port: int
    counts: tuple[int, int]
    new: int


@dataclass(slots=True)
class _Measured:
    """One party's: seconds of each step and of its comparing, decisions, bytes of a step, most MB."""

    seconds: list[float] = field(default_factory=list)
    comparing: list[float] = field(default_factory=list)
    decisions: list[Any] = field(default_factory=list)
    bytes_sent: int = 0
    max_rss_mb: float = 0.0


def measure_new(asked: tapes.Asked, new: int, stored: int, trials: int, *, report: Report) -> NewRow:
    """Deal, fill one side, and let keyframes come at the other.

    Args:
        asked: What to measure.
        new: Keyframes at a time.
        stored: Descriptors that stand.
        trials: Arrivals counted.
        report: Told of progress.
    """
    counts = (new * (trials + 1), stored)
    inputs = tapes.places(counts, asked)
    with TemporaryDirectory(prefix="spdz-bench-") as temporary:
        folder = Path(temporary)
        tapes.deal(tapes.Dealing((folder,), asked, counts), report)
        tape_bytes = max(tapes.tape_path(folder, party).stat().st_size for party in (0, 1))
        for party in (0, 1):
            inputs[party].tofile(_file(folder, party))
        task = _Task(folder, asked, free_port(), counts, new)
        first, second = run_processes(_party, task, on_note=lambda _, done: report(*done))
    slower = [max(pair) * 1e3 for pair in zip(first.seconds, second.seconds, strict=True)]
    comparing = [max(pair) * 1e3 for pair in zip(first.comparing, second.comparing, strict=True)]
    decided = [np.concatenate(first.decisions), np.concatenate(second.decisions, axis=1).T]
    return NewRow(
        n=asked.purpose.dim,
        new=new,
        stored=stored,
        security=asked.security,
        resolution=asked.purpose.step_text,
        median_ms=round(statistics.median(slower), 2),
        min_ms=round(min(slower), 2),
        max_ms=round(max(slower), 2),
        comparing_ms=round(statistics.median(comparing), 2),
        bytes_sent=max(first.bytes_sent, second.bytes_sent),
        tape_bytes=tape_bytes,
        max_rss_mb=(first.max_rss_mb, second.max_rss_mb),
        differ=sum(tapes.differing(asked, one, inputs[0][new:], inputs[1]) for one in decided),
        engine="spdz",
        threshold=asked.threshold,
        trials=trials,
    )


def _file(folder: Path, party: int) -> Path:
    return folder / f"{party}.float64"


def _read(task: _Task, party: int, start: int, count: int) -> FloatArray:
    """Some of a party's own descriptors: read a part at a time, so that its memory is a robot's."""
    dim = task.asked.purpose.dim
    offset = start * dim * np.dtype(np.float64).itemsize
    return np.fromfile(_file(task.folder, party), count=count * dim, offset=offset).reshape(-1, dim)


def _party(index: int, task: _Task, pipe: Any) -> None:
    """Timed: the whole of a step, from the plain descriptors on."""
    pin(index)
    found, (coming, standing) = _Measured(), task.counts
    with tapes.open_side(task.folder, index, task.asked, task.port) as gallery:
        slots: list[int] = []
        for start in range(0, standing, _TOGETHER):
            if index == 1:
                gallery.add(_read(task, 1, start, _TOGETHER))
            step = gallery.step()
            slots += step.peer if index == 0 else step.own
            pipe.send(Note((len(slots), standing + coming)))
        for start in range(0, coming, task.new):
            new = _read(task, 0, start, task.new)
            started = time.perf_counter()
            if index == 0:
                gallery.add(new)
            step = gallery.step()
            seconds = time.perf_counter() - started
            if start:
                found.seconds.append(seconds)
                found.comparing.append(step.comparing.seconds)
                which = (step.own, slots) if index == 0 else (slots, step.peer)
                found.decisions.append(tapes.decided(step.blocks, *which))
            found.bytes_sent = step.stats.bytes_sent
            pipe.send(Note((len(slots) + start + task.new, standing + coming)))
    found.max_rss_mb = most_memory()
    pipe.send(found)
