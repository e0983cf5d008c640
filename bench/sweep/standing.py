"""Two processes that stay up for all cells, pinned to a core each, with a bare socket between them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Protocol

from bench.parties import free_port, pin
from bench.sweep.floor import bare_socket


class Work(Protocol):
    """What a process is given; it is pickled."""

    def __call__(self, index: int, line: socket.socket) -> Any:
        """Do the work as party ``index``; ``line`` is the bare socket to the other process."""


class StandingPair:
    """The pair. Starting a process and importing the engine costs more than most cells.

    Raises:
        RuntimeError: from :meth:`run`, if a process died.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one BLAS thread a party; read when a child loads NumPy
        port = free_port()
        pipes = [context.Pipe() for _ in range(2)]
        self._pipes = [own for own, _ in pipes]
        self._children = [
            context.Process(target=_serve, args=(index, port, pipes[index][1]), daemon=True)
            for index in range(2)
        ]
        for child in self._children:
            child.start()
        for _, other in pipes:
            other.close()

    def run(self, first: Work, second: Work) -> tuple[Any, Any]:
        """Have both processes do their work at the same time; what they return."""
        try:
            for pipe, work in zip(self._pipes, (first, second), strict=True):
                pipe.send(work)
            results: dict[int, Any] = {}
            while len(results) < 2:
                waiting = [pipe for index, pipe in enumerate(self._pipes) if index not in results]
                ready = wait(waiting)
                for index, pipe in enumerate(self._pipes):
                    if pipe in ready:
                        results[index] = pipe.recv()
        except (EOFError, OSError):
            raise RuntimeError("a measured process died; its error is printed above") from None
        return results[0], results[1]

    def close(self) -> None:
        """End both processes."""
        for pipe in self._pipes:
            pipe.close()
        for child in self._children:
            child.join(timeout=1.0)
            child.terminate()

    def __enter__(self) -> StandingPair:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:  # a process may be in the middle of something
            for child in self._children:
                child.terminate()
        self.close()


def _serve(index: int, port: int, pipe: Connection[Any, Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all: the parent decides
    pin(index)
    with bare_socket(index, port) as line:
        while True:
            try:
                work = pipe.recv()
            except EOFError:  # the sweep is over, or was killed
                return
            pipe.send(work(index, line))
