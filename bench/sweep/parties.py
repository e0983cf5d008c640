"""What the two processes do for one cell: a secure comparison, and the exchange in the clear."""

from __future__ import annotations

import cProfile
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.sweep.ahead import Ahead, reserved
from bench.sweep.floor import WARM_UP, Frames, bare_trials, both_directions, recorded_frames
from bench.sweep.phases import phases
from bench.sweep.plain import PLAIN
from spdz.channels import Channel, FrameKind
from spdz.channels.tcp import connect, listen
from spdz.foundations.types import FloatArray
from spdz.readings.program import Program
from spdz.session import Session
from spdz.tape import Tape

FLOOR_TRIALS = 15
"""Replays of a cell's frames; their median is the floor."""

_WAIT = 30.0


@dataclass(frozen=True, slots=True)
class Figures:
    """What one process measured.

    Attributes:
        seconds: Of each trial.
        values: What each trial gave.
        frames: What both parties send in a trial.
        floor: Seconds of each replay of these frames.
        phases: Seconds of each phase of the profiled trial; empty where none was.
        profiled: Seconds of the profiled trial; 0 where none was.
        ahead: What was done before the first trial; None where nothing is.
    """

    seconds: list[float]
    values: list[float]
    frames: Frames
    floor: list[float]
    phases: dict[str, float] = field(default_factory=dict)
    profiled: float = 0.0
    ahead: Ahead | None = None


@dataclass(frozen=True, slots=True)
class SecureWork:
    """A party's part of a secure cell: warm-up, trials, one more under a profiler in party 0, the floor.

    Timed: quantise, mask, exchange, compute, open, check, decode. Apart from it: what is done ahead.

    Attributes:
        program: The score.
        vectors: This party's descriptors, shape (trials, N): one a trial.
        port: Where party 0 listens for this cell.
        tape: This party's tape, with WARM_UP + trials + 1 jobs.
        state: Where the tape keeps its state.
    """

    program: Program
    vectors: FloatArray
    port: int
    tape: Path
    state: Path

    def __call__(self, index: int, line: socket.socket) -> Figures:
        """Measure."""
        tape = Tape.open(self.tape, state_dir=self.state)
        channel = _channel(index, self.port)
        with Session(tape, channel) as session:
            ahead = reserved(session, WARM_UP + len(self.vectors) + 1, self.program)

            def once(vector: FloatArray) -> Any:
                return session.run(self.program, vector)

            for _ in range(WARM_UP - 1):
                once(self.vectors[0])
            with recorded_frames(channel) as recorded:
                stats = once(self.vectors[0]).stats
            frames = both_directions(recorded, index)
            if (stats.rounds, stats.bytes_sent) != (len(frames), sum(sent for sent, _ in recorded)):
                raise RuntimeError("the frames that were recorded are not those that the engine counted")
            seconds, results = _timed(once, self.vectors)
            profile = cProfile.Profile() if index == 0 else None
            started = time.perf_counter()
            if profile is None:
                once(self.vectors[0])
            else:
                profile.runcall(once, self.vectors[0])
            profiled = time.perf_counter() - started
        floor = bare_trials(line, index, frames, FLOOR_TRIALS)
        where = phases(profile) if profile is not None else {}
        values = [float(one.value) for one in results]
        return Figures(seconds, values, frames, floor, where, profiled, ahead)


@dataclass(frozen=True, slots=True)
class ClearWork:
    """A party's part of the exchange in the clear: send eight bytes a number, receive as many, compute.

    Attributes:
        score: The score's name.
        vectors: This party's descriptors, shape (trials, N).
        port: Where party 0 listens for this cell.
    """

    score: str
    vectors: FloatArray
    port: int

    def __call__(self, index: int, line: socket.socket) -> Figures:
        """Measure."""
        score, expect = PLAIN[self.score], 8 * self.vectors.shape[1]
        with _channel(index, self.port) as channel:

            def once(vector: FloatArray) -> float:
                peer = np.frombuffer(channel.exchange(FrameKind.DATA, [vector], expect))
                return score(vector, peer) if index == 0 else score(peer, vector)

            for _ in range(WARM_UP - 1):
                once(self.vectors[0])
            with recorded_frames(channel) as recorded:
                once(self.vectors[0])
            seconds, values = _timed(once, self.vectors)
        frames = both_directions(recorded, index)
        return Figures(seconds, values, frames, bare_trials(line, index, frames, FLOOR_TRIALS))


def _channel(index: int, port: int) -> Channel:
    address = f"127.0.0.1:{port}"
    return listen(address, wait=_WAIT) if index == 0 else connect(address, wait=_WAIT)


def _timed(once: Callable[[FloatArray], Any], vectors: FloatArray) -> tuple[list[float], list[Any]]:
    seconds, results = [], []
    for vector in vectors:
        started = time.perf_counter()
        results.append(once(vector))
        seconds.append(time.perf_counter() - started)
    return seconds, results
