"""One thread at a time, where two robots must make the same calls in the same order."""

from __future__ import annotations

from threading import Lock

from spdz.foundations.errors import TapeInUse


class Turn:
    """A context in which one thread is at a time; a second one is told, and changes nothing.

    Args:
        what: What is used, for the message.
    """

    def __init__(self, what: str) -> None:
        self._what, self._lock = what, Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise TapeInUse(
                f"another thread is using this {self._what}: it serves one thread at a time, since both "
                "robots must make the same calls in the same order"
            )

    def __exit__(self, *error: object) -> None:
        self._lock.release()
