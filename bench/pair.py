"""Two parties as two processes over loopback TCP, each pinned to a core, and what they measured."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.parties import free_port, pin, run_processes
from bench.sweep.ahead import Ahead, reserved
from dealer.tapes import deal_tapes
from spdz.channels import Channel
from spdz.channels.tcp import connect, listen
from spdz.foundations.stats import Stats
from spdz.foundations.types import Security
from spdz.readings.clear import Clear
from spdz.readings.program import Program, declare, quantise, run
from spdz.rounds.mac_check import drive
from spdz.session import Session
from spdz.session.driver import run_channel
from spdz.tape import Tape

WARM_UP = 3
"""Runs before the counted ones."""


@dataclass(frozen=True, slots=True)
class Task:
    """What either process runs; ``tapes`` is None for the clear baseline."""

    program: Program
    inputs: tuple[Any, Any]
    trials: int
    port: int
    tapes: tuple[Path, Path] | None
    state: Path


@dataclass(frozen=True, slots=True)
class Measured:
    """One process's figures: seconds a trial, the last value, costs of one trial, and what was done ahead."""

    seconds: list[float]
    value: Any
    stats: Stats
    ahead: Ahead | None = None


def measure_secure(
    program: Program, inputs: tuple[Any, Any], security: Security, trials: int
) -> tuple[Measured, Measured, int]:
    """Deal tapes, run both parties, and return their figures and the stored bytes a run."""
    shapes = (np.shape(inputs[0]), np.shape(inputs[1]))
    with tempfile.TemporaryDirectory(prefix="spdz-bench-") as folder:
        paths = (Path(folder, "0.tape"), Path(folder, "1.tape"))
        deal_tapes(paths, ("zero", "one"), program, shapes, trials + WARM_UP, security)
        with Tape.open(paths[0], state_dir=Path(folder, "state")) as tape:
            stored = tape.header.correction_bytes
        with Tape.open(paths[1], state_dir=Path(folder, "state")) as tape:
            stored = max(stored, tape.header.correction_bytes)
        task = Task(program, inputs, trials, free_port(), paths, Path(folder, "state"))
        first, second = run_processes(_secure_party, task)
        return first, second, stored


def measure_clear(program: Program, inputs: tuple[Any, Any], trials: int) -> tuple[Measured, Measured]:
    """The insecure exchange: both parties send their descriptor as it is."""
    first, second = run_processes(_clear_party, Task(program, inputs, trials, free_port(), None, Path()))
    return first, second


def _channel(index: int, task: Task) -> Channel:
    address = f"127.0.0.1:{task.port}"
    return listen(address, wait=30.0) if index == 0 else connect(address, wait=30.0)


def _timed(trials: int, once: Callable[[], tuple[Any, Stats]], ahead: Ahead | None = None) -> Measured:
    seconds = []
    value, stats = None, Stats()
    for _ in range(trials + WARM_UP):
        started = time.perf_counter()
        value, stats = once()
        seconds.append(time.perf_counter() - started)
    return Measured(seconds[WARM_UP:], value, stats, ahead)


def _secure_party(index: int, task: Task, pipe: Any) -> None:
    """Timed: quantise, mask, exchange, compute, open, check, decode; apart from it, what is done ahead."""
    pin(index)
    if task.tapes is None:
        raise ValueError("a secure party needs a tape")
    tape = Tape.open(task.tapes[index], state_dir=task.state)
    with Session(tape, _channel(index, task)) as session:
        ahead = reserved(session, task.trials + WARM_UP, task.program)

        def once() -> tuple[Any, Stats]:
            result = session.run(task.program, task.inputs[index])
            return result.value, result.stats

        pipe.send(_timed(task.trials, once, ahead))


def _clear_party(index: int, task: Task, pipe: Any) -> None:
    """Timed: quantise, send, receive, compute on plain integers."""
    pin(index)
    shapes = (np.shape(task.inputs[0]), np.shape(task.inputs[1]))
    with _channel(index, task) as channel:

        def once() -> tuple[Any, Stats]:
            inputs = declare(task.program, shapes, {index: quantise(task.program, task.inputs[index], "x")})
            stats = Stats()
            protocol = run(Clear(index), task.program, inputs)
            return run_channel(drive(protocol, None), channel, stats), stats

        pipe.send(_timed(task.trials, once))
