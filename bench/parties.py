"""Processes that measure: each pinned to a core, one BLAS thread, and what they report."""

from __future__ import annotations

import multiprocessing
import os
import resource
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from spdz.console.command import tune_process

_MB = 1 << 20


@dataclass(frozen=True, slots=True)
class Note:
    """What a process tells before its result."""

    what: Any


Work = Callable[[int, Any, Any], None]
"""``work(index, task, pipe)`` sends notes, if it likes, and then its result."""


def free_port() -> int:
    """A loopback port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def pin(index: int) -> None:
    """Tune this process and keep it on a core of its own, where the system allows it."""
    tune_process()
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[index % len(cores)]})


def most_memory() -> float:
    """The most resident memory that this process has had, in MB."""
    unit = 1 if sys.platform == "darwin" else 1 << 10
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / _MB, 1)


def memory() -> float:
    """The resident memory of this process, in MB; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0.0
    return round(pages * resource.getpagesize() / _MB, 1)


def run_processes(
    work: Work, task: Any, count: int = 2, on_note: Callable[[int, Any], None] = lambda index, what: None
) -> list[Any]:
    """Run ``work(index, task, pipe)`` in so many fresh processes and return their results, by index.

    Args:
        work: A module's function.
        task: What all of them are given.
        count: How many processes.
        on_note: Called with every note and the index of its process, as it comes.

    Raises:
        RuntimeError: if one dies.
    """
    context = multiprocessing.get_context("spawn")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one BLAS thread a party; read when a child loads NumPy
    pipes = [context.Pipe(duplex=False) for _ in range(count)]
    children = [
        context.Process(target=work, args=(index, task, pipes[index][1]), daemon=True)
        for index in range(count)
    ]
    for child in children:
        child.start()
    try:
        for _, writer in pipes:
            writer.close()
        results = _results([reader for reader, _ in pipes], on_note)
        for child in children:
            child.join(timeout=30)
        return results
    except EOFError:
        raise RuntimeError("a measured process died; its error is printed above") from None
    finally:
        for child in children:
            child.terminate()


def _results(readers: list[Connection[Any, Any]], on_note: Callable[[int, Any], None]) -> list[Any]:
    results: dict[int, Any] = {}
    while len(results) < len(readers):
        for ready in wait([reader for index, reader in enumerate(readers) if index not in results]):
            index = next(index for index, reader in enumerate(readers) if reader is ready)
            said = readers[index].recv()
            if isinstance(said, Note):
                on_note(index, said.what)
            else:
                results[index] = said
    return [results[index] for index in range(len(readers))]
