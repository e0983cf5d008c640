"""How much a peer may learn in a minute."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

WINDOW = 60.0
"""Seconds."""


class Rate:
    """At most so many in any minute, by the monotonic clock: a wall clock that jumps changes nothing.

    Args:
        most: How many.
        clock: Seconds that only grow.
    """

    def __init__(self, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most, self._clock = most, clock
        self._spent: deque[tuple[float, int]] = deque()
        self._sum = 0

    @property
    def left(self) -> int:
        """How many are left now."""
        self._forget()
        return max(0, self._most - self._sum)

    @property
    def second(self) -> int:
        """How many of them are a second's share."""
        return int(self._most / WINDOW)

    @property
    def untouched(self) -> bool:
        """Whether nothing was spent in the last minute."""
        self._forget()
        return not self._spent

    @property
    def pause(self) -> float:
        """Seconds until more is left than now; 0 if nothing was spent."""
        self._forget()
        return self._spent[0][0] + WINDOW - self._clock() if self._spent else 0.0

    def spend(self, count: int) -> None:
        """Count some; what was not foreseen may exceed what is left."""
        if count:
            self._spent.append((self._clock(), count))
            self._sum += count

    def _forget(self) -> None:
        old = self._clock() - WINDOW
        while self._spent and self._spent[0][0] <= old:
            self._sum -= self._spent.popleft()[1]
