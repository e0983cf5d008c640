"""The channel between two parties: one exchange of frames at a time, in both directions at once.

An exchange sends one frame and receives the peer's frame of the same kind and round. It is full duplex, so
both sides may send any amount at the same time, and it has one deadline for everything: a peer that sends a
byte a second does not extend it. After any error the channel is dead. A channel serves one thread.
"""

from __future__ import annotations

import contextlib
import os
import time
from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import (
    HEADER_BYTES,
    MAX_CONTROL,
    MAX_FRAME,
    AbortReason,
    DType,
    FrameKind,
    Payload,
    byte_views,
    pack_abort,
    pack_header,
)
from spdz.channels.times import DEFAULT_TIMEOUT, check_limits, check_wait
from spdz.foundations.errors import ChannelClosed, ChannelError, PeerAborted, SpdzError
from spdz.foundations.types import Buffer

ABORT_SECONDS = 1.0
_DATA, _CHECK = FrameKind.DATA, FrameKind.CHECK
_EXCHANGED = (_DATA, _CHECK, FrameKind.CONTROL)

Self = TypeVar("Self", bound="Channel")


class Channel(ABC):
    """A connection to the peer.

    Args:
        timeout: Seconds that one exchange may take in all.
        max_frame: Largest payload in bytes, 1 to MAX_FRAME; a security limit.

    Attributes:
        rounds: DATA and CHECK exchanges completed.
        control_rounds: CONTROL exchanges completed.
        bytes_sent: Bytes of the frames sent in completed exchanges, of every kind, headers included. What TCP
            and TLS add (records, acknowledgements, the TLS handshake) is not counted.
        bytes_received: The same for the peer's frames.

    Raises:
        ValueError: if an argument is out of range.
    """

    def __init__(self, timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME) -> None:
        check_limits(timeout, max_frame)
        self.rounds = self.control_rounds = 0
        self.bytes_sent = self.bytes_received = 0
        self._timeout = timeout
        self._max_frame, self._max_control = max_frame, min(MAX_CONTROL, max_frame)
        self._session = 0
        self._posted: tuple[bool, int, FrameReader, float] | None = None
        self._death: str | None = None
        self._closed = False
        self._process = os.getpid()

    @property
    def timeout(self) -> float:
        """Seconds that one exchange may take in all."""
        return self._timeout

    def bind(self, session_tag: int) -> None:
        """Mark all further frames with the tag of the session that the handshake agreed on.

        Raises:
            ValueError: if the tag is not a 32-bit unsigned integer.
        """
        if not 0 <= session_tag < 1 << 32:
            raise ValueError("a session tag has 32 bits")
        self._session = session_tag

    def exchange(
        self, kind: FrameKind, payload: Payload, expect: int | None, dtype: DType = DType.BYTES
    ) -> memoryview:
        """Send one frame and receive the peer's frame of the same kind and round.

        Args:
            kind: DATA, CHECK or CONTROL.
            payload: C-contiguous buffers or arrays; their bytes, one after the other, are sent.
            expect: Payload bytes that the peer must send; None, for CONTROL only, takes up to MAX_CONTROL.
            dtype: What both payloads consist of.

        Returns:
            The peer's payload: writable, aligned to 8 bytes, the caller's to keep.

        Raises:
            ValueError: if the request itself is wrong; nothing was sent and the channel lives.
            ProtocolViolation: if the peer sent any other frame.
            PeerAborted: if the peer stopped and said why.
            ChannelTimeout: if not everything was sent and received in time.
            ChannelClosed: if the peer hung up, or the channel is dead or closed.
            ChannelError: in another process than the one that made the channel.
        """
        self.post(kind, payload, expect, dtype)
        return self.take()

    def post(self, kind: FrameKind, payload: Payload, expect: int | None, dtype: DType = DType.BYTES) -> None:
        """The first half of an exchange: send as much of the frame as can be sent at once.

        So this side can work while the frame travels. Arguments and errors are those of :meth:`exchange`; its
        time begins here. The buffers must not change before :meth:`take`, which must come next.
        """
        if self._death is not None or os.getpid() != self._process:
            self._require_usable()
        if self._posted is not None:
            raise ValueError("the frame that was posted last has not been answered yet")
        views: list[Buffer]
        if len(payload) == 1 and type(payload[0]) is bytes:  # as most
            views, size = [payload[0]], len(payload[0])
        else:
            views = byte_views(payload)
            size = sum(map(len, views))
        is_round = kind is _DATA or kind is _CHECK
        if expect is None or not (is_round and size <= self._max_frame >= expect >= 0):
            self._check_request(kind, size, expect)
        session, round_ = self._session, (self.rounds + self.control_rounds) & 0xFFFFFFFF
        header = awaited = pack_header(kind, dtype, session, round_, size)
        deadline = time.monotonic() + self._timeout
        try:
            self._begin([header, *views])
            if expect != size:  # the rest is done while the frame travels
                awaited = pack_header(kind, dtype, session, round_, expect or 0)
            reader = FrameReader(awaited, expect, self._max_control)
        except BaseException as error:
            self._die_of(error)
            raise
        self._posted = (is_round, HEADER_BYTES + size, reader, deadline)

    def take(self) -> memoryview:
        """The second half of an exchange: send the rest, and return the peer's payload."""
        if self._death is not None or os.getpid() != self._process:
            self._require_usable()
        if self._posted is None:
            raise ValueError("no frame was posted that could be answered")
        is_round, sent, reader, deadline = self._posted
        try:
            self._finish(reader, deadline)
        except BaseException as error:
            self._die_of(error)
            raise
        self._posted = None
        if is_round:
            self.rounds += 1
        else:
            self.control_rounds += 1
        self.bytes_sent += sent
        self.bytes_received += reader.received
        return reader.payload()

    def await_frame(self, seconds: float, wake: int | None = None) -> bool:
        """Wait between two exchanges until the peer has begun the next; nothing is consumed.

        Args:
            seconds: How long at most; 0 only looks.
            wake: A file descriptor; the wait ends as soon as it can be read from.

        Returns:
            Whether bytes of the peer's are there. What TLS sends on its own behalf does not count.

        Raises:
            ValueError: as :func:`check_wait`; the channel lives.
            ProtocolViolation: if the peer keeps TLS busy and says nothing.
            ChannelClosed: if the peer hung up, or the channel is dead or closed.
            ChannelError: if the network failed, or as :meth:`exchange`.
        """
        check_wait(seconds, wake)
        self._require_usable()
        try:
            return self._await(time.monotonic() + seconds, wake)
        except BaseException as error:
            self._die_of(error)
            raise

    def abort(self, reason: AbortReason) -> None:
        """Tell the peer why this side stops, if that can be done within a second, and close.

        Never raises. The peer is told nothing if this side stops in the middle of sending a frame, nor in
        another process than the one that made the channel.
        """
        if not self._closed and not self._is_a_copy:
            round_ = (self.rounds + self.control_rounds) & 0xFFFFFFFF
            with contextlib.suppress(Exception):
                self._send_last(pack_abort(reason, self._session, round_), time.monotonic() + ABORT_SECONDS)
        self.close()

    def close(self) -> None:
        """Hang up. May be called again, and after an error."""
        if not self._closed:
            self._closed = True
            self._die("this channel is closed")
            try:
                if not self._is_a_copy:
                    self._hang_up()
            finally:
                self._release()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _is_a_copy(self) -> bool:
        return os.getpid() != self._process

    def _require_usable(self) -> None:
        if self._is_a_copy:
            raise ChannelError(
                "this channel belongs to the process that made it, and this process is a fork of it: "
                "connect after the fork"
            )
        if self._death is not None:
            raise ChannelClosed(self._death)

    def _die_of(self, error: BaseException) -> None:
        if not isinstance(error, SpdzError):  # e.g. KeyboardInterrupt: half a frame may be out
            self._die("an exchange on this channel was interrupted")
            return
        self._die(f"this channel failed before: {error}")
        if isinstance(error, PeerAborted):  # nothing is left to say, and the peer waits for the end
            self.close()

    def _die(self, why: str) -> None:
        self._death = self._death or why

    def _check_request(self, kind: FrameKind, size: int, expect: int | None) -> None:
        if kind not in _EXCHANGED:
            raise ValueError("only DATA, CHECK and CONTROL frames are exchanged")
        limit = self._max_control if kind == FrameKind.CONTROL else self._max_frame
        if expect is None and kind != FrameKind.CONTROL:
            raise ValueError(f"the length of a {kind.name} frame must be known")
        if max(size, expect or 0) > limit:
            raise ValueError(
                f"a frame of {max(size, expect or 0)} bytes is above this channel's limit of {limit}: "
                "use smaller batches"
            )
        if expect is not None and expect < 0:
            raise ValueError("a frame cannot have a negative length")

    @abstractmethod
    def _begin(self, frame: list[Buffer]) -> None:
        """Send what can be sent of a frame at once.

        Args:
            frame: The header and the payload, as bytes and byte views.

        Raises:
            SpdzError: nothing else but :class:`KeyboardInterrupt` and the like.
        """

    @abstractmethod
    def _finish(self, reader: FrameReader, deadline: float) -> None:
        """Send the rest of it and fill ``reader``, full duplex.

        Args:
            reader: Where to put what comes.
            deadline: ``time.monotonic()`` by when both must be done.

        Raises:
            SpdzError: nothing else but :class:`KeyboardInterrupt` and the like.
        """

    @abstractmethod
    def _await(self, deadline: float, wake: int | None) -> bool:
        """Wait as :meth:`await_frame` until ``deadline``; what is read ahead is kept for :meth:`_finish`."""

    @abstractmethod
    def _send_last(self, frame: bytes, deadline: float) -> None:
        """Try to deliver a last frame. May raise anything."""

    @abstractmethod
    def _hang_up(self) -> None:
        """Tell the peer that nothing more comes, without waiting. Called once at most."""

    @abstractmethod
    def _release(self) -> None:
        """Give the transport back without a sign to the peer. Called once."""
