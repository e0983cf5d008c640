"""A channel between two threads of one process, for tests and examples."""

from __future__ import annotations

import select
import time
from queue import Empty, SimpleQueue

from spdz.channels.base import Channel
from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import MAX_FRAME
from spdz.channels.times import DEFAULT_TIMEOUT, LONGEST_SLEEP, remaining
from spdz.foundations.errors import ChannelClosed
from spdz.foundations.types import Buffer

Pipe = SimpleQueue[bytes | None]
"""Pieces of a byte stream, of any size; None is its end."""
_LOOK_SECONDS = 0.01
"""A queue cannot be polled together with a descriptor: it is looked at so often."""


class MemoryChannel(Channel):
    """One end of a pair of byte streams in memory; made by :func:`memory_pair`."""

    def __init__(
        self, incoming: Pipe, outgoing: Pipe, timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME
    ) -> None:
        super().__init__(timeout, max_frame)
        self._incoming = incoming
        self._outgoing = outgoing
        self._leftover = memoryview(b"")

    def _begin(self, frame: list[Buffer]) -> None:
        self._outgoing.put(b"".join(frame))

    def _finish(self, reader: FrameReader, deadline: float) -> None:
        while not reader.complete:
            if not self._leftover:
                try:
                    piece = self._incoming.get(timeout=remaining(deadline, reader, self._timeout))
                except Empty:
                    continue
                if piece is None:
                    raise ChannelClosed(f"the peer closed the connection ({reader.progress()})")
                self._leftover = memoryview(piece)
            count = min(len(reader.space), len(self._leftover))
            reader.space[:count] = self._leftover[:count]
            self._leftover = self._leftover[count:]
            reader.advance(count)

    def _await(self, deadline: float, wake: int | None) -> bool:
        poll = select.poll()
        if wake is not None:
            poll.register(wake, select.POLLIN)
        longest = LONGEST_SLEEP if wake is None else _LOOK_SECONDS
        while not self._leftover:
            left = max(0.0, deadline - time.monotonic())
            try:
                piece = self._incoming.get(timeout=min(left, longest))
            except Empty:
                if not left or poll.poll(0):
                    return False
                continue
            if piece is None:
                raise ChannelClosed("the peer closed the connection (between two frames)")
            self._leftover = memoryview(piece)
        return True

    def _send_last(self, frame: bytes, deadline: float) -> None:
        self._outgoing.put(frame)

    def _hang_up(self) -> None:
        self._outgoing.put(None)

    def _release(self) -> None:
        pass  # the garbage collector does


def memory_pair(
    timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME
) -> tuple[MemoryChannel, MemoryChannel]:
    """Two connected channels, one for each of two threads.

    Args:
        timeout: Seconds that one exchange may take.
        max_frame: Largest payload in bytes.
    """
    there: Pipe = SimpleQueue()
    back: Pipe = SimpleQueue()
    return MemoryChannel(back, there, timeout, max_frame), MemoryChannel(there, back, timeout, max_frame)
