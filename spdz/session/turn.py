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
        self.leave = self._lock.release

    def take(self) -> None:
        """Begin a turn; :attr:`leave` ends it.

        Raises:
            TapeInUse: if another thread has it.
        """
        if not self._lock.acquire(False):
            raise TapeInUse(
                f"another thread is using this {self._what}: it serves one thread at a time, since both "
                "robots must make the same calls in the same order"
            )

    def __enter__(self) -> None:
        self.take()

    def __exit__(self, *error: object) -> None:
        self.leave()
