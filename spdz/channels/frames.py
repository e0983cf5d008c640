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

HEADER = struct.Struct("<4B3I")
HEADER_BYTES = HEADER.size  # 16: a payload of 8-byte words behind it stays aligned
_MERGE_BELOW = 64 << 10  # buffers below this are copied together: a copy is cheaper than a system call


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


SENTENCES = {
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

PASSING = frozenset({AbortReason.TIMEOUT, AbortReason.STOPPED, AbortReason.LOCAL_ERROR, AbortReason.REPLACED})
"""Reasons after which the peer may be back."""


def pack_header(kind: int, dtype: int, session: int, round_: int, length: int) -> bytes:
    """The 16 bytes in front of a payload of ``length`` bytes."""
    return HEADER.pack(VERSION, kind, dtype, 0, session, round_, length)


def pack_abort(reason: AbortReason, session: int, round_: int) -> bytes:
    """A whole ABORT frame."""
    return pack_header(FrameKind.ABORT, DType.BYTES, session, round_, 1) + bytes([reason])


def byte_views(payload: Payload) -> list[Buffer]:
    """The buffers of a payload as flat bytes, without copying; empty ones are left out.

    Raises:
        ValueError: if a buffer is not C-contiguous or has no plain element type.
    """
    views: list[Buffer] = []
    for buffer in payload:
        if type(buffer) is bytes:
            if buffer:
                views.append(buffer)
            continue
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


def merge_small(views: Sequence[Buffer]) -> list[Buffer]:
    """The same bytes in few pieces: runs of small views are copied together, large ones are not copied."""
    if len(views) == 2 and len(views[0]) + len(views[1]) <= _MERGE_BELOW:  # most frames
        return [b"".join(views)]
    return list(_merged(views))


def _merged(views: Sequence[Buffer]) -> Iterator[Buffer]:
    run: list[Buffer] = []
    run_bytes = 0
    for view in views:
        if run and run_bytes + len(view) > _MERGE_BELOW:
            yield b"".join(run)
            run, run_bytes = [], 0
        if len(view) > _MERGE_BELOW:
            yield memoryview(view)
        else:
            run.append(view)
            run_bytes += len(view)
    if run:
        yield b"".join(run)
