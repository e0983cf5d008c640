"""Drive one party's frames over a real channel: those of any protocol, or the rounds of compiled code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from typing import Any

from spdz.channels import Channel, FrameKind
from spdz.foundations.stats import Stats, copied
from spdz.foundations.types import Buffer
from spdz.rounds.coroutine import Exchange
from spdz.rounds.mac_check import DIGEST_BYTES, MacCheck

_DATA = FrameKind.DATA


def _kind(request: Exchange) -> FrameKind:
    return FrameKind.CHECK if request.is_check else FrameKind.DATA


def poster(channel: Channel) -> Callable[[Exchange], None]:
    """What sends an exchange's payload over a channel, for :func:`spdz.rounds.mac_check.drive`."""
    return lambda request: channel.post(_kind(request), request.payload, request.expect)


def run_channel(frames: Generator[Exchange, memoryview, Any], channel: Channel, stats: Stats) -> Any:
    """Carry every frame over the channel until the protocol returns; returns its result.

    Args:
        frames: A protocol under :func:`spdz.rounds.mac_check.drive`.
        channel: A connected channel.
        stats: Counts rounds, bytes and elements.

    Raises:
        SpdzError: whatever the protocol or the channel raises.
    """
    sent = channel.bytes_sent
    try:
        request = next(frames)
        while True:
            stats.rounds += 1
            stats.field_elements_sent += request.elements
            if request.is_posted:
                reply = channel.take()
            else:
                reply = channel.exchange(_kind(request), request.payload, request.expect)
            request = frames.send(reply)
    except StopIteration as done:
        return done.value
    finally:
        stats.bytes_sent += channel.bytes_sent - sent
        frames.close()


class ChannelRounds:
    """The rounds of a single job's compiled code.

    They do by calls what :func:`run_channel` does with :func:`spdz.rounds.mac_check.drive`.

    Args:
        channel: A connected channel.
        mac_check: The session's check, or None in semi-honest mode.
    """

    __slots__ = ("_channel", "_elements", "_payload", "_rounds", "_sent", "mac_check")

    def __init__(self, channel: Channel, mac_check: MacCheck | None) -> None:
        self._channel, self.mac_check = channel, mac_check
        self._payload: Sequence[Buffer] = ()
        self._elements, self._rounds, self._sent = 0, channel.rounds, channel.bytes_sent

    def exchange(self, payload: Sequence[Buffer], expect: int, elements: int) -> memoryview:
        """One round: send ``payload``, and return the peer's ``expect`` bytes."""
        reply = self._channel.exchange(_DATA, payload, expect)
        self._elements += elements
        if self.mac_check is not None:
            self.mac_check.absorb(payload, reply)
        return reply

    def post(self, payload: Sequence[Buffer], expect: int, elements: int) -> None:
        """Its first half."""
        self._channel.post(_DATA, payload, expect)
        self._payload = payload
        self._elements += elements

    def take(self) -> memoryview:
        """Its second half."""
        reply = self._channel.take()
        if self.mac_check is not None:
            self.mac_check.absorb(self._payload, reply)
        return reply

    def check(self) -> None:
        """One MAC check; nothing in semi-honest mode."""
        check = self.mac_check
        if check is None:
            return
        self._channel.post(FrameKind.CHECK, [check.message()], DIGEST_BYTES)
        expected = check.expected()
        check.verify(self._channel.take(), expected)

    def stats(self, correlations: Counter[str]) -> Stats:
        """What the rounds so far cost, and what they have used."""
        rounds, sent = self._channel.rounds - self._rounds, self._channel.bytes_sent - self._sent
        return Stats(rounds, sent, self._elements, copied(correlations))
