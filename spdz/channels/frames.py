"""Frames: what travels between the two parties, as bytes. No I/O here.

A frame is a 16-byte header and a payload. All integers are little-endian::

    offset  size  field
    0       1     version   VERSION
    1       1     kind      FrameKind
    2       1     dtype     DType of the payload
    3       1     reserved  0
    4       4     session   tag agreed in the handshake; 0 before that
    8       4     round     number of the exchange, from 0, modulo 2^32
    12      4     length    payload bytes

A party always knows which frame comes next: kind, dtype, session, round and, except for CONTROL, length.
Whatever differs is refused on the header alone. So a peer cannot make this side allocate more than the
program itself asks for (or MAX_CONTROL bytes), whatever length it claims. The one frame that may come at any
time is ABORT, whose payload is one byte, an :class:`AbortReason`.

Security limits: MAX_FRAME (payload bytes; lowered a channel with ``max_frame``) and MAX_CONTROL.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Any, TypeAlias

import numpy.typing as npt

from spdz.foundations.errors import (
    ChannelTimeout,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    TapeError,
    TapeExhausted,
    TapeMismatch,
)
from spdz.foundations.types import Buffer

Payload: TypeAlias = Sequence[Buffer | npt.NDArray[Any]]
"""C-contiguous buffers whose concatenated bytes are a frame's payload."""

VERSION = 1
MAX_FRAME = 256 << 20
MAX_CONTROL = 64 << 10

_HEADER = struct.Struct("<4B3I")
HEADER_BYTES = _HEADER.size  # 16: a payload of 8-byte words behind it stays aligned
_MERGE_BELOW = 64 << 10  # buffers below this are copied together: a copy is cheaper than a system call
_TLS_HANDSHAKE = 0x16  # first byte of a TLS ClientHello (RFC 8446, 5.1)


class FrameKind(IntEnum):
    """What a frame is for."""

    DATA = 1
    """One round of a protocol."""
    CHECK = 2
    """A MAC check, which travels alone."""
    CONTROL = 3
    """The handshake and agreements: JSON bytes, of a length that the sender chooses. A call's topic."""
    ABORT = 4
    """The sender stops; the payload is one :class:`AbortReason` byte."""


class DType(IntEnum):
    """What a payload consists of; both sides must mean the same."""

    BYTES = 0
    FIELD = 1
    """Field elements of 16 bytes."""
    RING64 = 2
    """Elements of Z_2^64, 8 bytes each."""
    MIXED = 3
    """The merged frames of several protocols."""


class AbortReason(IntEnum):
    """Why a party stops. It travels as one byte: a peer's own text is never shown."""

    MAC_CHECK_FAILED = 1
    PROTOCOL_VIOLATION = 2
    TAPE_MISMATCH = 3
    TAPE_EXHAUSTED = 4
    TAPE_UNUSABLE = 5
    TIMEOUT = 6
    WRONG_ROBOT = 7
    STOPPED = 8
    LOCAL_ERROR = 9
    UNKNOWN_TOPIC = 10
    REPLACED = 11


_REASONS: tuple[tuple[type[BaseException], AbortReason], ...] = (
    (MacCheckFailed, AbortReason.MAC_CHECK_FAILED),
    (ProtocolViolation, AbortReason.PROTOCOL_VIOLATION),
    (TapeMismatch, AbortReason.TAPE_MISMATCH),
    (TapeExhausted, AbortReason.TAPE_EXHAUSTED),
    (TapeError, AbortReason.TAPE_UNUSABLE),
    (ChannelTimeout, AbortReason.TIMEOUT),
    (KeyboardInterrupt, AbortReason.STOPPED),
)


def abort_reason(error: BaseException) -> AbortReason:
    """What the peer is told of this side's error: the first kind that fits."""
    return next((reason for kind, reason in _REASONS if isinstance(error, kind)), AbortReason.LOCAL_ERROR)


_SENTENCES = {
    AbortReason.MAC_CHECK_FAILED: "its MAC check failed; it output nothing and destroyed its tape",
    AbortReason.PROTOCOL_VIOLATION: "it received something that no honest peer sends",
    AbortReason.TAPE_MISMATCH: "the two tapes, or tape and program, do not belong together",
    AbortReason.TAPE_EXHAUSTED: "every job on its tape has been used",
    AbortReason.TAPE_UNUSABLE: "its tape is damaged, destroyed or in use",
    AbortReason.TIMEOUT: "it waited for this side longer than its time limit",
    AbortReason.WRONG_ROBOT: "it expects another robot than the one that this side's certificate names",
    AbortReason.STOPPED: "its user or its program stopped it",
    AbortReason.LOCAL_ERROR: "of an error of its own; see its own message",
    AbortReason.UNKNOWN_TOPIC: "its plan lacks the topic of this call: another mission, another plan?",
    AbortReason.REPLACED: "a newer call of the same robot about the same topic took the place of this one",
}

_PASSING = frozenset(
    {AbortReason.TIMEOUT, AbortReason.STOPPED, AbortReason.LOCAL_ERROR, AbortReason.REPLACED}
)
"""Reasons after which the peer may be back."""


def pack_header(kind: int, dtype: int, session: int, round_: int, length: int) -> bytes:
    """The 16 bytes in front of a payload of ``length`` bytes."""
    return _HEADER.pack(VERSION, kind, dtype, 0, session, round_, length)


def pack_abort(reason: AbortReason, session: int, round_: int) -> bytes:
    """A whole ABORT frame."""
    return pack_header(FrameKind.ABORT, DType.BYTES, session, round_, 1) + bytes([reason])


def byte_views(payload: Payload) -> list[memoryview]:
    """The buffers of a payload as flat bytes, without copying; empty ones are left out.

    Raises:
        ValueError: if a buffer is not C-contiguous or has no plain element type.
    """
    views = []
    for buffer in payload:
        view = memoryview(buffer)  # type: ignore[arg-type]  # ndarray
        if view.nbytes == 0:
            continue
        if view.format != "B" or view.ndim != 1 or not view.c_contiguous:
            if view.format == "O":  # the bytes would be this process's pointers
                raise ValueError("a payload buffer holds Python objects, which are not sent")
            try:
                view = view.cast("B")
            except (TypeError, ValueError) as error:
                raise ValueError(f"a payload buffer cannot be sent as bytes: {error}") from error
        views.append(view)
    return views


def merge_small(views: Sequence[Buffer]) -> Iterator[memoryview]:
    """The same bytes in few pieces: runs of small views are copied together, large ones are not copied."""
    if sum(map(len, views)) <= _MERGE_BELOW:  # most frames
        yield memoryview(b"".join(views))
        return
    run: list[Buffer] = []
    run_bytes = 0
    for view in views:
        if run and run_bytes + len(view) > _MERGE_BELOW:
            yield memoryview(b"".join(run))
            run, run_bytes = [], 0
        if len(view) > _MERGE_BELOW:
            yield memoryview(view)
        else:
            run.append(view)
            run_bytes += len(view)
    if run:
        yield memoryview(b"".join(run))


class FrameReader:
    """Assembles the one frame that may come next from pieces of any size.

    The owner writes received bytes into ``space`` and reports their number to :meth:`advance`, until
    ``complete``.

    Args:
        kind: The kind expected.
        dtype: The payload's dtype expected.
        session: The session tag expected.
        round_: The round expected.
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
        "_expected",
        "_is_abort",
        "_limit",
        "complete",
        "received",
        "space",
    )

    def __init__(
        self, kind: FrameKind, dtype: DType, session: int, round_: int, expect: int | None, limit: int
    ) -> None:
        self._expected = (kind, dtype, session, round_)
        self._expect = expect
        self._limit = limit
        self._end = HEADER_BYTES + (expect or 0)
        self._buffer = bytearray(self._end)
        self._checked = self._is_abort = self.complete = False
        self.received = 0
        self.space = memoryview(self._buffer)

    def advance(self, count: int) -> None:
        """Note that ``count`` more bytes have been written into ``space``.

        Raises:
            ProtocolViolation: if the header is not the expected one.
            PeerAborted: if the frame is a whole ABORT frame.
        """
        self.received += count
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
        kind, dtype, session, round_ = self._expected
        version, got_kind, got_dtype, reserved, got_session, got_round, length = _HEADER.unpack_from(
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
                f"the peer is at another step: this side expects a {kind.name} frame, the peer sent "
                f"{_name(FrameKind, got_kind)}; both robots must make the same calls, with the same program "
                "and threshold, in the same order"
            )
        if got_kind != kind:
            raise _violation("frame kind", kind.name, _name(FrameKind, got_kind))
        if got_session != session:
            raise _violation("session tag", f"{session:08x}", f"{got_session:08x}")
        if got_round != round_:
            raise _violation("round", round_, got_round)
        if got_dtype != dtype:
            raise _violation("payload dtype", dtype.name, _name(DType, got_dtype))
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
            return PeerAborted(f"the peer stopped because {_SENTENCES[why]}", passing=why in _PASSING)
        except ValueError:
            return _violation("abort reason", f"1 to {max(AbortReason)}", reason)


def _violation(what: str, expected: object, got: object) -> ProtocolViolation:
    return ProtocolViolation(f"{what}: expected {expected}, the peer sent {got}")


def _name(enum: type[IntEnum], code: int) -> str:
    return enum(code).name if code in enum.__members__.values() else f"unknown code {code}"
