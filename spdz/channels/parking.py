"""Calls that came and wait to be taken: at most one for each peer and topic, and none for long."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from spdz.channels.stream import Stream
from spdz.channels.topic import LOOK_SECONDS, answer, is_waiting, replace
from spdz.foundations.errors import ChannelClosed


@dataclass(frozen=True, slots=True)
class _Parked:
    stream: Stream
    deadline: float


class Parking:
    """What one thread puts down and others take.

    Args:
        seconds: How long a call may wait.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._calls: dict[tuple[str, str], _Parked] = {}
        self._changed = threading.Condition()
        self._end = ""

    def park(self, peer: str, topic: str, stream: Stream) -> None:
        """Put a call down, in the place of an older one that nobody took."""
        with self._changed:
            older = self._calls.pop((peer, topic), None)
            ended = self._end
            if not ended:
                self._calls[peer, topic] = _Parked(stream, time.monotonic() + self._seconds)
                self._changed.notify_all()
        if older is not None:
            replace(older.stream)
        if ended:
            stream.close()

    def has(self, peer: str, topic: str) -> bool:
        """Whether a call waits, as far as is known."""
        with self._changed:
            return (peer, topic) in self._calls

    def take(self, peer: str, topic: str, deadline: float, stop: threading.Event | None) -> Stream | None:
        """Wait for a call whose caller is still there, and tell it that it is taken; None if none came.

        Raises:
            ChannelClosed: if there will be no more calls.
        """
        while (call := self._next(peer, topic, deadline, stop)) is not None:
            if is_waiting(call.stream) and answer(call.stream, topic):
                return call.stream
            call.stream.close()
        return None

    def drop_late(self) -> float:
        """Hang up on callers that waited for too long; returns when the next one will have."""
        now = time.monotonic()
        with self._changed:
            late = [key for key, call in self._calls.items() if call.deadline <= now]
            streams = [self._calls.pop(key).stream for key in late]
            following = min((call.deadline for call in self._calls.values()), default=now + self._seconds)
        for stream in streams:
            stream.part(b"")
        return following

    def end(self, why: str) -> None:
        """Hang up on everybody and let nobody wait any more; later reasons do not count."""
        with self._changed:
            self._end = self._end or why
            calls, self._calls = self._calls, {}
            self._changed.notify_all()
        for call in calls.values():
            call.stream.part(b"")

    def forsake(self) -> None:
        """In a fork: close descriptors. Nobody gives the lock back; the connections are the parent's."""
        for call in self._calls.values():
            call.stream.close()

    def _next(self, peer: str, topic: str, deadline: float, stop: threading.Event | None) -> _Parked | None:
        with self._changed:
            while not self._end:
                if (call := self._calls.pop((peer, topic), None)) is not None:
                    return call
                left = deadline - time.monotonic()
                if left <= 0 or (stop is not None and stop.is_set()):
                    return None
                self._changed.wait(min(left, LOOK_SECONDS if stop is not None else threading.TIMEOUT_MAX))
            raise ChannelClosed(self._end, passing=False)
