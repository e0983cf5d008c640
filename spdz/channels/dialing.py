"""Calling the peer, again and again, at every address of its name, until it answers."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import TypeVar

from spdz.channels.addresses import NotYet, Target, parse_address, patiently, resolve
from spdz.channels.stream import describe
from spdz.errors import ChannelError, ChannelTimeout

_ATTEMPT_SECONDS = 5.0  # one attempt to connect, where packets are dropped without an answer

T = TypeVar("T")


def call(address: str, wait: float, establish: Callable[[socket.socket], T]) -> T:
    """Connect and establish what is wanted over the connection, trying again for ``wait`` seconds.

    So either side can be started first, also behind a forwarder that takes the connection before the peer
    listens, and with a name or a network that is not there yet.

    Args:
        address: Where the peer listens, ``host:port``.
        wait: Seconds to keep trying.
        establish: Gets the connected socket, owns it from then on, and raises :class:`NotYet` if it turns out
            that the peer is not behind it. Every other error ends the call.

    Raises:
        ValueError: if the address is malformed.
        ChannelError: if the host can never be resolved.
        ChannelTimeout: if nobody answered.
    """
    parse_address(address)
    deadline = time.monotonic() + wait

    def give_up(last: NotYet) -> ChannelError:
        return ChannelTimeout(
            f"nobody answered at {address} within {wait:g} s ({last}): is the other robot listening?"
        )

    return patiently(lambda: _attempt(address, deadline, establish), deadline, give_up)


def _attempt(address: str, deadline: float, establish: Callable[[socket.socket], T]) -> T:
    """Try every address of the host once."""
    targets = resolve(address, deadline - time.monotonic())
    failure = NotYet("the host has no address")
    for untried, target in zip(range(len(targets), 0, -1), targets, strict=True):
        seconds = min(_ATTEMPT_SECONDS, deadline - time.monotonic()) / untried
        try:
            return establish(_connect(target, seconds))
        except NotYet as error:
            failure = error
    raise failure


def _connect(target: Target, seconds: float) -> socket.socket:
    family, where = target
    try:
        sock = socket.socket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise NotYet(describe(error)) from error
    try:
        sock.settimeout(max(0.01, seconds))
        sock.connect(where)
        # Without a listener, a local port from the ephemeral range can be connected to itself.
        if sock.getsockname() == sock.getpeername():
            raise ConnectionRefusedError(None, "Connection refused")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return sock
    except OSError as error:
        sock.close()
        raise NotYet(describe(error)) from error
    except BaseException:
        sock.close()
        raise
