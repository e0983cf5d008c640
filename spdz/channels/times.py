"""Times and limits of a channel."""

from __future__ import annotations

import math
import os
import time

from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import MAX_FRAME
from spdz.channels.telling import in_seconds
from spdz.foundations.errors import ChannelTimeout

DEFAULT_TIMEOUT = 30.0
LONGEST_SLEEP = 60.0
"""Seconds that one wait takes at most; every wait is in a loop. The system's calls refuse very long ones."""


def check_limits(timeout: float, max_frame: int) -> None:
    """Refuse limits out of range, before anything is opened.

    Raises:
        ValueError: if one is.
    """
    if not (timeout > 0 and math.isfinite(timeout)):
        raise ValueError(f"timeout must be a positive number of seconds, not {timeout!r}")
    if not 1 <= max_frame <= MAX_FRAME:
        raise ValueError(f"max_frame must be 1 to {MAX_FRAME} bytes, not {max_frame!r}")


def check_wait(seconds: float, wake: int | None) -> None:
    """Refuse what :meth:`Channel.await_frame` cannot wait for.

    Raises:
        ValueError: unless ``seconds`` is a number from 0 on and ``wake``, if given, an open descriptor.
    """
    if not (seconds >= 0 and math.isfinite(seconds)):
        raise ValueError(f"a wait takes a number of seconds from 0 on, not {seconds!r}")
    if wake is not None:
        try:
            os.fstat(wake)
        except (OSError, TypeError, OverflowError):
            raise ValueError(f"wake must be an open file descriptor, not {wake!r}") from None


def remaining(deadline: float, reader: FrameReader, seconds: float) -> float:
    """Seconds left until ``deadline``, or LONGEST_SLEEP if that is less.

    Raises:
        ChannelTimeout: if there are none.
    """
    left = deadline - time.monotonic()
    if left <= 0:
        raise ChannelTimeout(
            f"the peer did not finish this round within {in_seconds(seconds)} ({reader.progress()})"
        )
    return min(left, LONGEST_SLEEP)
