"""A channel between two threads of one process, for tests and examples."""

from __future__ import annotations

from queue import Empty, SimpleQueue

from spdz.channels.base import DEFAULT_TIMEOUT, Channel, remaining
from spdz.channels.frames import MAX_FRAME, FrameReader
from spdz.foundations.errors import ChannelClosed

Pipe = SimpleQueue[bytes | None]
"""Pieces of a byte stream, of any size; None is its end."""


class MemoryChannel(Channel):
    """One end of a pair of byte streams in memory; made by :func:`memory_pair`."""

    def __init__(
        self, incoming: Pipe, outgoing: Pipe, timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME
    ) -> None:
        super().__init__(timeout, max_frame)
        self._incoming = incoming
        self._outgoing = outgoing
        self._leftover = memoryview(b"")

    def _swap(self, frame: list[memoryview], reader: FrameReader, deadline: float) -> None:
        self._outgoing.put(b"".join(frame))
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
