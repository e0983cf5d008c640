"""A call and its topic: what a robot that calls another one's port wants to talk about.

Once TLS has shown who calls, the caller sends one CONTROL frame, the topic's name. The port sends the same
frame back at the moment at which it takes the call. Both are of round 0 and are not counted; the channel's
own rounds begin behind them. Until then a caller sends nothing more.
"""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Collection

from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import AbortReason, DType, FrameKind, pack_abort, pack_header
from spdz.channels.socket_channel import lost
from spdz.channels.stream import Stream, describe
from spdz.channels.times import LONGEST_SLEEP
from spdz.channels.tls import TlsCaller
from spdz.channels.tls_stream import TlsStream
from spdz.foundations.errors import (
    ChannelClosed,
    ChannelError,
    ChannelTimeout,
    ProtocolViolation,
    SpdzError,
)

MAX_TOPIC = 64
"""Security limit: bytes of a topic's name."""

LOOK_SECONDS = 0.2
"""How often a wait looks whether it is to stop."""

_NO_TOPIC = pack_abort(AbortReason.PROTOCOL_VIOLATION, 0, 0)
_UNKNOWN_TOPIC = pack_abort(AbortReason.UNKNOWN_TOPIC, 0, 0)
_REPLACED = pack_abort(AbortReason.REPLACED, 0, 0)


def topic_bytes(topic: str) -> bytes:
    """A topic's name as it travels.

    Raises:
        ValueError: if it is empty, too long, or not printable.
    """
    name = topic.encode() if topic.isprintable() else b""
    if not 1 <= len(name) <= MAX_TOPIC:
        raise ValueError(f"a topic is 1 to {MAX_TOPIC} bytes of printable text, not {topic[:80]!r}")
    return name


class TopicCaller(TlsCaller):
    """A caller that has yet to prove to be a peer, and to name a topic.

    Args:
        stream: The connection, before the handshake.
        peers: Names of the robots to accept.
        topics: What they may call about.

    Attributes:
        topic: What it calls about, once it has said so.
    """

    def __init__(self, stream: TlsStream, peers: Collection[str], topics: Collection[str]) -> None:
        super().__init__(stream, peers)
        self._topics = {topic_bytes(topic): topic for topic in topics}
        self._reader = FrameReader(_header(), None, MAX_TOPIC)
        self.topic = ""

    def proceed(self) -> int:
        """Go on with the handshake, then with the frame; see :class:`Caller`."""
        if not self.name and (events := super().proceed()):
            return events
        self.farewell = _NO_TOPIC
        try:
            while not self._reader.complete:
                count = self.stream.receive_into(self._reader.space)
                if count is None:
                    return select.POLLIN
                if count == 0:
                    raise ConnectionAbortedError(None, "it hung up")
                self._reader.advance(count)
        except OSError as error:
            raise ChannelError(f"{self.name!r} named no topic: {describe(error)}") from error
        except SpdzError as error:  # the same words for all that it may have sent: see Teller
            raise ChannelError(f"{self.name!r} did not send the frame that names a topic") from error
        self._choose(bytes(self._reader.payload()))
        return 0

    def _choose(self, name: bytes) -> None:
        try:
            self.topic = self._topics[name]
        except KeyError:
            self.farewell = _UNKNOWN_TOPIC
            raise ChannelError(
                f"{self.name!r} calls about a topic that this robot's plan lacks "
                f"(it has {', '.join(map(repr, self._topics.values()))}): another mission, another plan?"
            ) from None


def be_taken(stream: Stream, topic: str, seconds: float, stop: threading.Event | None) -> None:
    """Name the topic of a call and wait for the answer, as the caller.

    Args:
        stream: The connection, to a robot that has shown to be the peer.
        topic: What to call about.
        seconds: How long to wait.
        stop: Ends the wait when it is set.

    Raises:
        ChannelTimeout: if the call was not taken.
        ChannelClosed: if the peer hung up.
        PeerAborted: if the peer refused, and why.
        ProtocolViolation: if it answered anything else.
    """
    deadline = time.monotonic() + seconds
    name = topic_bytes(topic)
    reader = FrameReader(_header(name), len(name), MAX_TOPIC)
    poll = select.poll()
    poll.register(stream, select.POLLIN)
    try:
        stream.send(_frame(topic))
        while not reader.complete:
            count = stream.receive_into(reader.space)
            if count == 0:
                raise ChannelClosed("the peer hung up")
            if count is not None:
                reader.advance(count)
                continue
            left = deadline - time.monotonic()
            if left <= 0 or (stop is not None and stop.is_set()):
                raise ChannelTimeout("the call was not taken")
            poll.poll(min(left, LONGEST_SLEEP if stop is None else LOOK_SECONDS) * 1000)
    except OSError as error:
        raise lost(error, reader.progress()) from error
    if reader.payload() != name:
        raise ProtocolViolation("the peer answered a call about another topic")


def is_waiting(stream: Stream) -> bool:
    """Whether a caller that has named its topic is still there, as far as can be told, and sent no more."""
    try:
        return stream.receive_into(memoryview(bytearray(1))) is None
    except (OSError, SpdzError):
        return False


def answer(stream: Stream, topic: str) -> bool:
    """Tell a caller that its call is taken; returns whether it may hear that."""
    try:
        stream.send(_frame(topic))
        return True
    except OSError:
        return False


def replace(stream: Stream) -> None:
    """Tell a caller that a newer call took the place of its own, and hang up."""
    stream.part(_REPLACED)


def _frame(topic: str) -> memoryview:
    """The frame that names a topic; it is the first on its connection, whose buffers take it whole."""
    name = topic_bytes(topic)
    return memoryview(_header(name) + name)


def _header(name: bytes = b"") -> bytes:
    return pack_header(FrameKind.CONTROL, DType.BYTES, 0, 0, len(name))
