"""Drive one party's frames over a real channel."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from spdz.channels import Channel, FrameKind
from spdz.foundations.stats import Stats
from spdz.rounds.coroutine import Exchange


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
