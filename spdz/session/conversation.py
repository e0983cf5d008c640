"""What two robots say to each other beside the protocol: notes, byte strings, and when they are silent.

Nothing here is hidden from the peer, and nothing is checked by a MAC. All of it becomes part of the session
id (:mod:`spdz.session.agreement`), so that two robots that were told different things pass no later check.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from spdz.channels import Channel, FrameKind
from spdz.channels.times import check_wait
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import Json
from spdz.session.agreement import Agreement
from spdz.session.lifecycle import Lifecycle

MOST_STRINGS = 4096
"""Security limit: byte strings of one swap; their sizes fit one control message."""
PIECE_BYTES = 1 << 20
"""Bytes of one exchange of a swap: one every timeout of 30 s needs 0.6 Mbit/s for both directions."""


class Conversing(Lifecycle):
    """A session that both sides also talk over.

    Attributes:
        _agreement: The conversation.
    """

    _agreement: Agreement

    def exchange_note(self, note: dict[str, Json]) -> dict[str, Any]:
        """Swap one small public JSON object with the peer, such as how many descriptors there are."""
        with self._guard:
            return self._agreement.note(note)

    def swap(self, frames: Sequence[bytes], most: int) -> list[bytes]:
        """Swap byte strings with the peer, any number either way; both sides call it in step.

        Args:
            frames: What the peer gets: at most 4,096 strings, also none or empty ones.
            most: Bytes that are taken from the peer in all. What is received is kept in memory.

        Returns:
            The peer's, in its order.

        Raises:
            ValueError: for other arguments; nothing was sent and the session lives.
            ProtocolViolation: if the peer has more than ``most``, or sends other bytes than it has announced.
            SpdzError: as any session.
        """
        self._require_alive()
        try:
            own = [memoryview(frame).cast("B") for frame in frames]
        except TypeError:
            raise ValueError("what is swapped are byte strings") from None
        if len(own) > MOST_STRINGS:
            raise ValueError(f"at most {MOST_STRINGS} byte strings are swapped at a time, not {len(own)}")
        if type(most) is not int or most < 0:
            raise ValueError(f"most is a number of bytes from 0 on, not {most!r}")
        with self._guard:
            return _swap(self._channel, self._agreement, own, most)

    def await_peer(self, seconds: float, wake: int | None = None) -> bool:
        """Wait until the peer has begun to say something, which the next call then hears; nothing is sent.

        Args:
            seconds: How long at most; 0 only looks.
            wake: A file descriptor; the wait ends as soon as it can be read from.

        Returns:
            True as soon as the peer has sent something; False once the time is over or ``wake`` can be read.

        Raises:
            ValueError: for other arguments; the session lives.
            ChannelError: if the peer hung up, or the connection broke. (A network that is merely silent is
                noticed by the next exchange alone.)
            SpdzError: as any session.
        """
        self._require_alive()
        check_wait(seconds, wake)
        with self._guard:
            return self._channel.await_frame(seconds, wake)


def _swap(channel: Channel, agreement: Agreement, own: Sequence[memoryview], most: int) -> list[bytes]:
    digest = hashlib.sha256()
    for one in own:
        digest.update(one)
    offer: dict[str, Json] = {"sizes": [len(one) for one in own], "sha256": digest.hexdigest()}
    answer = agreement.control(offer, *offer)
    sizes = _sizes(answer["sizes"], most)
    received, total = bytearray(), sum(sizes)
    outgoing = _pieces(own)
    while (piece := next(outgoing, [])) or len(received) < total:
        received += channel.exchange(FrameKind.DATA, piece, min(PIECE_BYTES, total - len(received)))
    if hashlib.sha256(received).hexdigest() != answer["sha256"]:
        raise ProtocolViolation("the peer sent other bytes than it has announced")
    ends = [0]
    for size in sizes:
        ends.append(ends[-1] + size)
    whole = memoryview(received)
    return [bytes(whole[start:stop]) for start, stop in pairwise(ends)]


def _sizes(told: Any, most: int) -> list[int]:
    """The sizes that the peer has told, which may be anything."""
    if (
        not isinstance(told, list)
        or len(told) > MOST_STRINGS
        or any(type(size) is not int or size < 0 for size in told)
    ):
        raise ProtocolViolation("the peer's account of what it sends is malformed")
    if sum(told) > most:
        raise ProtocolViolation(f"the peer wants to send more than the {most} bytes that are taken: refused")
    return told


def _pieces(strings: Sequence[memoryview]) -> Iterator[list[memoryview]]:
    """The strings end to end, cut into pieces of PIECE_BYTES, the last one shorter."""
    piece: list[memoryview] = []
    room = PIECE_BYTES
    for rest in strings:
        while rest:
            piece.append(rest[:room])
            rest = rest[room:]
            room -= len(piece[-1])
            if not room:
                yield piece
                piece, room = [], PIECE_BYTES
    if piece:
        yield piece
