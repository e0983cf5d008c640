"""The disk's work in a thread of its own, while this one computes.

What a strip uses must be durable before anything that depends on it is sent, but not before it is computed.
Reading the tape and multiplying take about as long as the disk, and waiting for the disk takes no core.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread
from types import TracebackType


class Meanwhile:
    """A context in which ``work`` runs; at its end it is done, or its error is raised.

    Args:
        work: What to do. Nothing that it changes may be looked at before :meth:`wait`.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, name="spdz-meanwhile")

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:
            self._error = error

    def wait(self) -> None:
        """Return when the work is done; raises what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error

    def __enter__(self) -> Meanwhile:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.wait()
        else:
            self._thread.join()
