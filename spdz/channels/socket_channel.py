"""The channel over a socket: a loop that drives a byte stream, plain or TLS, in both directions at once."""

from __future__ import annotations

import select
import time

from spdz.channels.base import Channel
from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import MAX_FRAME, merge_small
from spdz.channels.stream import Stream, describe, is_about_a_certificate
from spdz.channels.times import DEFAULT_TIMEOUT, LONGEST_SLEEP, remaining
from spdz.foundations.errors import ChannelClosed, ChannelError, ChannelTimeout
from spdz.foundations.types import Buffer

_SLICE = 256 << 10  # bytes offered to one send, so that both directions take turns
_SPINS = 100
"""Looks at the socket, about 1 us each, before the process sleeps: waking up costs more than a round."""
_BETWEEN = "between two frames"


class SocketChannel(Channel):
    """A channel over a connected byte stream.

    Args:
        stream: The stream, after its handshake if it is a TLS one. The channel owns it from here on.
        timeout: Seconds that one exchange may take.
        max_frame: Largest payload in bytes.
    """

    def __init__(self, stream: Stream, timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME) -> None:
        super().__init__(timeout, max_frame)
        self._stream = stream
        self._poll, self._incoming = select.poll(), select.poll()
        self._incoming.register(stream, select.POLLIN)
        self._in_frame = False  # whether part of a frame may be out
        self._pieces: list[Buffer] = []  # of the frame that is being sent, the next one last
        self._send_error: OSError | None = None
        self._ahead = b""  # the byte that was waited for

    def _begin(self, frame: list[Buffer]) -> None:
        self._pieces = pieces = merge_small(frame)
        if len(pieces) > 1:
            pieces.reverse()
        self._in_frame = True
        self._send_some(pieces)

    def _finish(self, reader: FrameReader, deadline: float) -> None:
        pieces, stream = self._pieces, self._stream
        ready = stream.reads_ahead
        if not (pieces or ready or self._ahead or self._send_error):
            if time.monotonic() < deadline and _seen(self._incoming):
                self._receive_some(reader)
                if reader.complete:  # as most frames
                    return
        remaining(deadline, reader, self._timeout)
        if self._ahead:
            reader.space[:1], self._ahead = self._ahead, b""
            reader.advance(1)
        sends, receives = self._send_error is None and (bool(pieces) or stream.backlog), True
        while True:
            more = sends and self._send_some(pieces)
            more |= receives and ready and self._receive_some(reader)
            sends = self._send_error is None and (bool(pieces) or stream.backlog)
            receives = not reader.complete
            if not (sends or receives):
                break
            seconds = remaining(deadline, reader, self._timeout)
            if not more:
                self._wait(sends, receives, seconds)
                ready = True
        if self._send_error is not None:
            raise lost(self._send_error, reader.progress())

    def _wait(self, sends: bool, receives: bool, seconds: float) -> None:
        """Wait until the socket takes bytes or has some."""
        poll = self._incoming
        if sends:
            poll = self._poll
            poll.register(self._stream, select.POLLOUT | receives * select.POLLIN)
        if not _seen(poll):
            poll.poll(seconds * 1000)

    def _await(self, deadline: float, wake: int | None) -> bool:
        stream, first, poll = self._stream, memoryview(bytearray(1)), select.poll()
        if wake is not None:
            poll.register(wake, select.POLLIN)
        woken = False
        while not self._ahead:
            try:
                count = stream.receive_into(first)
                unsent = count is None and stream.backlog and not stream.flush()
            except OSError as error:
                raise lost(error, _BETWEEN) from error
            if count == 0:
                raise ChannelClosed(f"the peer closed the connection ({_BETWEEN})")
            if count:
                self._ahead = bytes(first)
                break
            left = deadline - time.monotonic()
            if woken or left <= 0:
                return False
            poll.register(stream, select.POLLIN | unsent * select.POLLOUT)
            ready = poll.poll(min(left, LONGEST_SLEEP) * 1000)
            woken = any(descriptor == wake for descriptor, _ in ready)
        return True

    def _send_some(self, pieces: list[Buffer]) -> bool:
        """Send from the last piece; returns whether there is more, and the stream may take it now."""
        try:
            if not pieces:
                self._stream.flush()
                return False
            piece = pieces[-1]
            sent = self._stream.send(piece if len(piece) <= _SLICE else piece[:_SLICE])
        except OSError as error:  # the peer is gone, but may have said why: go on reading
            self._send_error = error
            pieces.clear()
            return False
        if sent < len(piece):
            pieces[-1] = memoryview(piece)[sent:]
        else:
            pieces.pop()
            self._in_frame = bool(pieces)
        return bool(pieces) and sent > 0 and not self._stream.backlog

    def _receive_some(self, reader: FrameReader) -> bool:
        """Read what is there; returns whether there is more to come, and may be now."""
        try:
            count = self._stream.receive_into(reader.space)
        except OSError as error:
            raise lost(error, reader.progress()) from error
        if count is None:
            return False
        if count == 0:
            if isinstance(self._send_error, TimeoutError):  # told once, to whoever asks first
                raise lost(self._send_error, reader.progress())
            raise ChannelClosed(f"the peer closed the connection ({reader.progress()})")
        reader.advance(count)
        return not reader.complete

    def _send_last(self, frame: bytes, deadline: float) -> None:
        if self._in_frame:
            return
        stream, rest = self._stream, memoryview(frame)
        while rest or stream.backlog:
            if rest:
                rest = rest[stream.send(rest) :]
            else:
                stream.flush()
            if (rest or stream.backlog) and not self._ready(select.POLLOUT, deadline):
                return
        stream.end()
        while self._ready(select.POLLIN, deadline) and stream.discard():
            pass  # see Stream.discard

    def _ready(self, event: int, deadline: float) -> bool:
        """Wait for an event; False if the time is over."""
        left = deadline - time.monotonic()
        self._poll.register(self._stream, event)
        return left > 0 and bool(self._poll.poll(left * 1000))

    def _hang_up(self) -> None:
        self._stream.end()

    def _release(self) -> None:
        self._stream.close()


def _seen(poll: select.poll) -> bool:
    """Look without sleeping."""
    look = poll.poll
    for _ in range(_SPINS):
        if look(0):
            return True
    return False


def lost(error: OSError, progress: str) -> ChannelError:
    """The error of a broken connection, in this package's terms."""
    if isinstance(error, TimeoutError):  # TCP itself gave up: ETIMEDOUT
        return ChannelTimeout(f"the network does not reach the peer any more ({progress})")
    if is_about_a_certificate(error):
        return ChannelClosed(
            f"the peer refused this side's TLS connection or certificate ({error.reason}): are both robots' "
            "credentials from the same run of the dealer?",
            passing=False,
        )
    return ChannelClosed(f"the connection broke: {describe(error)} ({progress})")
