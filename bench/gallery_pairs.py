"""All pairs of two galleries that both robots hold masked already: pairs a second, bytes, tape."""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench import gallery_tapes as tapes
from bench.parties import Note, free_port, pin, run_processes
from dealer.mission import deal_mission
from protocols.catalog import Purpose
from protocols.matching import match
from spdz.console.progress import Report
from spdz.foundations.types import FloatArray
from spdz.session import Session
from spdz.session.connect import open_session

TILE = 256
"""Descriptors a side of the job tiles that galleries are compared with."""


@dataclass(frozen=True, slots=True)
class GalleryRow:
    """One measured gallery. Of what the parties differ in it is the larger one's.

    Attributes:
        n: Length of a descriptor.
        rows: Descriptors of party 0.
        columns: Descriptors of party 1.
        security: The security model.
        resolution: ``2^-16``, or ``exact``.
        pairs_per_s: Of the median trial, from descriptors that both hold masked to checked bits.
        best_pairs_per_s: Of the quickest trial.
        bytes_per_pair: Bytes sent.
        tape_bytes_per_pair: Bytes stored.
        bytes_per_descriptor: Bytes sent for an own descriptor, its proof and the peer's included.
        tape_bytes_per_descriptor: Bytes stored for a descriptor, the proof of its norm included.
        tape_bytes_per_descriptor_unproved: The same without the proof.
        dealt_pairs_per_s: Dealing on one core, slots included, the quickest gallery.
        differ: Decisions unlike the clear ones by more than the resolution, of all trials.
        engine: ``spdz``.
        threshold: Of the decisions.
        trials: Galleries counted.
    """

    n: int
    rows: int
    columns: int
    security: str
    resolution: str
    pairs_per_s: float
    best_pairs_per_s: float
    bytes_per_pair: float
    tape_bytes_per_pair: float
    bytes_per_descriptor: float
    tape_bytes_per_descriptor: int
    tape_bytes_per_descriptor_unproved: int
    dealt_pairs_per_s: float
    differ: int
    engine: str
    threshold: float
    trials: int


@dataclass(frozen=True, slots=True)
class TileRow:
    """The same pairs the way of jobs, tile by tile, measured in turn with the gallery.

    Attributes:
        tile: Descriptors of either party in a job.
        pairs_per_s: Of the median trial, from plain descriptors: a job has no others.
        bytes_per_pair: Bytes sent.
        tape_bytes_per_pair: Bytes stored.
        time_factor: How many times the gallery's time a pair, best trials compared.
    """

    tile: tuple[int, int]
    pairs_per_s: float
    bytes_per_pair: float
    tape_bytes_per_pair: float
    time_factor: float


@dataclass(frozen=True, slots=True)
class _Task:
    folder: Path
    asked: tapes.Asked
    inputs: tuple[FloatArray, FloatArray]
    trials: int
    tiles: bool
    port: int


@dataclass(slots=True)
class _Measured:
    """One party's: seconds and decisions (rows, columns) of each trial, bytes sent in the last."""

    seconds: list[float] = field(default_factory=list)
    decisions: list[Any] = field(default_factory=list)
    tile_seconds: list[float] = field(default_factory=list)
    pair_bytes: int = 0
    slot_bytes: int = 0
    tile_bytes: int = 0


def measure_pairs(
    asked: tapes.Asked,
    counts: tuple[int, int],
    trials: int,
    *,
    tiles: bool,
    report: Report,
) -> tuple[GalleryRow, TileRow | None]:
    """Deal, run both parties, and return what they measured; one more gallery, not counted, warms up.

    Args:
        asked: What to measure.
        counts: Descriptors of party 0 and of party 1.
        trials: Galleries counted.
        tiles: Whether to run the same pairs as jobs, in turn with the galleries.
        report: Told of progress.
    """
    inputs = tapes.places(counts, asked)
    pairs = counts[0] * counts[1]
    with TemporaryDirectory(prefix="spdz-bench-") as temporary:
        folder = Path(temporary)
        folders = tuple(_gallery(folder, trial) for trial in range(trials + 1))
        dealt = tapes.deal(tapes.Dealing(folders, asked, counts), report)
        stored = tapes.stored(folders[0], asked)
        job_bytes = _deal_tiles(folder, asked, counts, trials + 1) if tiles else 0.0
        task = _Task(folder, asked, inputs, trials, tiles, free_port())
        both: list[_Measured] = run_processes(_party, task, on_note=lambda index, done: report(*done))
    slower = _slower(both, "seconds")
    row = GalleryRow(
        n=asked.purpose.dim,
        rows=counts[0],
        columns=counts[1],
        security=asked.security,
        resolution=asked.purpose.step_text,
        pairs_per_s=_rate(pairs, statistics.median(slower)),
        best_pairs_per_s=_rate(pairs, min(slower)),
        bytes_per_pair=round(max(one.pair_bytes for one in both) / pairs, 3),
        tape_bytes_per_pair=stored.pair,
        bytes_per_descriptor=round(max(one.slot_bytes / n for one, n in zip(both, counts, strict=True)), 1),
        tape_bytes_per_descriptor=stored.slot,
        tape_bytes_per_descriptor_unproved=stored.unproved,
        dealt_pairs_per_s=round(max(dealt), 1),
        differ=sum(tapes.differing(asked, bits, *inputs) for one in both for bits in one.decisions),
        engine="spdz",
        threshold=asked.threshold,
        trials=trials,
    )
    if not tiles:
        return row, None
    slower_tiles = _slower(both, "tile_seconds")
    return row, TileRow(
        tile=_tile(counts),
        pairs_per_s=_rate(pairs, statistics.median(slower_tiles)),
        bytes_per_pair=round(max(one.tile_bytes for one in both) / pairs, 3),
        tape_bytes_per_pair=round(job_bytes, 2),
        time_factor=round(min(slower_tiles) / min(slower), 2),
    )


def _slower(both: list[_Measured], which: str) -> list[float]:
    return [max(seconds) for seconds in zip(*(getattr(one, which) for one in both), strict=True)]


def _rate(pairs: int, seconds: float) -> float:
    return round(pairs / seconds, 1)


def _gallery(folder: Path, trial: int) -> Path:
    return folder / f"gallery-{trial}"


def _tile(counts: tuple[int, int]) -> tuple[int, int]:
    return min(counts[0], TILE), min(counts[1], TILE)


def _deal_tiles(folder: Path, asked: tapes.Asked, counts: tuple[int, int], times: int) -> float:
    """Deal jobs for all pairs, so many times; returns the larger party's stored bytes a pair."""
    tile = _tile(counts)
    jobs = -(-counts[0] // tile[0]) * -(-counts[1] // tile[1])
    purpose = Purpose("S10", asked.purpose.dim, tile=tile, max_norm=asked.purpose.max_norm)
    deal_mission(folder / "tiles", tapes.AGENTS, purpose, times * jobs * purpose.pairs, asked.security)
    sizes = [_tile_tape(folder, party).stat().st_size for party in (0, 1)]
    return max(sizes) / (times * jobs * purpose.pairs)


def _tile_tape(folder: Path, party: int) -> Path:
    return folder / "tiles" / tapes.AGENTS[party] / f"{tapes.AGENTS[1 - party]}.tape"


def _party(index: int, task: _Task, pipe: Any) -> None:
    """Timed of a gallery: reading the pairs' tape, all rounds and checks, and making the bits durable."""
    pin(index)
    found, own = _Measured(), task.inputs[index]
    with ExitStack() as stack:
        session = stack.enter_context(_open_tiles(index, task)) if task.tiles else None
        for trial in range(task.trials + 1):
            with tapes.open_side(_gallery(task.folder, trial), index, task.asked, task.port) as gallery:
                gallery.add(own)
                step = gallery.step()
            if trial:
                found.seconds.append(step.comparing.seconds)
                found.decisions.append(_by_rows(index, tapes.decided(step.blocks, step.own, step.peer)))
            found.pair_bytes, found.slot_bytes = (
                step.comparing.stats.bytes_sent,
                step.filling.stats.bytes_sent,
            )
            if session is not None:
                started = time.perf_counter()
                matches = match(session, own, task.asked.threshold)
                if trial:
                    found.tile_seconds.append(time.perf_counter() - started)
                found.tile_bytes = matches.stats.bytes_sent
            pipe.send(Note((trial + 1, task.trials + 1)))
    pipe.send(found)


def _open_tiles(index: int, task: _Task) -> Session:
    address = f"127.0.0.1:{task.port}"
    return open_session(
        _tile_tape(task.folder, index),
        listen=address if index == 0 else None,
        connect=address if index == 1 else None,
        timeout=tapes.TIMEOUT,
        state_dir=task.folder / f"state-{index}",
    )


def _by_rows(party: int, decisions: Any) -> Any:
    return decisions if party == 0 else decisions.T
