"""Reading the one frame that may come next."""

from __future__ import annotations

from enum import IntEnum

from spdz.channels.frames import (
    HEADER,
    HEADER_BYTES,
    PASSING,
    SENTENCES,
    VERSION,
    AbortReason,
    DType,
    FrameKind,
)
from spdz.foundations.errors import OutOfStep, PeerAborted, ProtocolViolation

_TLS_HANDSHAKE = 0x16  # first byte of a TLS ClientHello (RFC 8446, 5.1)


class FrameReader:
    """Assembles the one frame that may come next from pieces of any size.

    The owner writes received bytes into ``space`` and reports their number to :meth:`advance`, until
    ``complete``.

    Args:
        header: Of the frame expected, as :func:`pack_header` makes it; its length counts for nothing if
            ``expect`` is None.
        expect: The payload length expected, or None for any length up to ``limit``.
        limit: The cap for ``expect is None``.

    Attributes:
        space: Where the next bytes belong.
        complete: Whether the frame is there.
        received: Bytes so far, header included.
    """

    __slots__ = (
        "_buffer",
        "_checked",
        "_end",
        "_expect",
        "_header",
        "_is_abort",
        "_limit",
        "complete",
        "received",
        "space",
    )

    def __init__(self, header: bytes, expect: int | None, limit: int) -> None:
        self._header, self._expect, self._limit = header, expect, limit
        self._end = end = HEADER_BYTES + (expect or 0)
        self._buffer = buffer = bytearray(end)
        self._checked = self._is_abort = self.complete = False
        self.received = 0
        self.space = memoryview(buffer)

    def advance(self, count: int) -> None:
        """Note that ``count`` more bytes have been written into ``space``.

        Raises:
            ProtocolViolation: if the header is not the expected one.
            PeerAborted: if the frame is a whole ABORT frame.
        """
        self.received += count
        if count == self._end and self._expect is not None and self._buffer.startswith(self._header):
            self.complete = True  # as most frames: in one piece, and as expected
            return
        if not self._checked and self.received >= HEADER_BYTES:
            self._check_header()
            self._checked = True
        if self.received < self._end or not self._checked:
            self.space = memoryview(self._buffer)[self.received : self._end]
            return
        if self._is_abort:
            raise self._abort_error(self._buffer[HEADER_BYTES])
        self.complete = True

    def payload(self) -> memoryview:
        """The payload, writable and nobody else's."""
        return memoryview(self._buffer)[HEADER_BYTES:]

    def progress(self) -> str:
        """How much of the frame came, for an error message."""
        known = self._checked or self._expect is not None
        return f"{self.received} of {self._end if known else f'at least {HEADER_BYTES}'} bytes received"

    def _check_header(self) -> None:
        _, kind, dtype, _, session, round_, _ = HEADER.unpack(self._header)
        version, got_kind, got_dtype, reserved, got_session, got_round, length = HEADER.unpack_from(
            self._buffer
        )
        if version != VERSION:
            hint = " (the peer seems to speak TLS, this side does not)" if version == _TLS_HANDSHAKE else ""
            raise _violation("frame version", VERSION, f"{version}{hint}")
        if reserved != 0:
            raise _violation("reserved byte", 0, reserved)
        if got_kind == FrameKind.ABORT:
            if length != 1:
                raise _violation("length of an ABORT frame", 1, length)
            self._is_abort = True
            self._resize(1)
            return
        if {got_kind, kind} == {FrameKind.DATA, FrameKind.CONTROL}:
            raise OutOfStep(
                f"the peer is at another step: this side expects a {_name(FrameKind, kind)} frame, the peer "
                f"sent {_name(FrameKind, got_kind)}; both robots must make the same calls, with the same "
                "program and threshold, in the same order"
            )
        if got_kind != kind:
            raise _violation("frame kind", _name(FrameKind, kind), _name(FrameKind, got_kind))
        if got_session != session:
            raise _violation("session tag", f"{session:08x}", f"{got_session:08x}")
        if got_round != round_:
            raise _violation("round", round_, got_round)
        if got_dtype != dtype:
            raise _violation("payload dtype", _name(DType, dtype), _name(DType, got_dtype))
        if self._expect is None:
            if length > self._limit:
                raise _violation("payload length", f"at most {self._limit} bytes", f"{length} bytes")
            self._resize(length)
        elif length != self._expect:
            raise _violation("payload length", f"{self._expect} bytes", f"{length} bytes")

    def _resize(self, length: int) -> None:
        """Expect ``length`` payload bytes from here on, keeping what came."""
        self._end = HEADER_BYTES + length
        if len(self._buffer) < self._end:
            buffer = bytearray(self._end)
            buffer[: self.received] = self._buffer[: self.received]
            self._buffer = buffer

    @staticmethod
    def _abort_error(reason: int) -> Exception:
        try:
            why = AbortReason(reason)
            return PeerAborted(f"the peer stopped because {SENTENCES[why]}", passing=why in PASSING)
        except ValueError:
            return _violation("abort reason", f"1 to {max(AbortReason)}", reason)


def _violation(what: str, expected: object, got: object) -> ProtocolViolation:
    return ProtocolViolation(f"{what}: expected {expected}, the peer sent {got}")


def _name(enum: type[IntEnum], code: int) -> str:
    return enum(code).name if code in enum.__members__.values() else f"unknown code {code}"
