"""Calling the peer, again and again, at every address of its name, until it answers."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from spdz.channels.addresses import NotYet, Target, parse_address, patiently, resolve
from spdz.channels.stream import describe
from spdz.channels.telling import Teller, in_seconds
from spdz.foundations.errors import ChannelError, ChannelTimeout

_ATTEMPT_SECONDS = 5.0  # one attempt to connect, where packets are dropped without an answer

T = TypeVar("T")


def call(
    address: str,
    wait: float,
    timeout: float,
    teller: Teller,
    establish: Callable[[socket.socket, float], T],
    stop: threading.Event | None = None,
) -> T:
    """Connect and establish what is wanted over the connection, trying again for ``wait`` seconds.

    So either side can be started first, also behind a forwarder that takes the connection before the peer
    listens, and with a name or a network that is not there yet. Where somebody takes the connection and then
    stalls, the next address has its turn, and the same one again while ``wait`` lasts.

    Args:
        address: Where the peer listens, ``host:port``.
        wait: Seconds to keep trying.
        timeout: Seconds that establishing may take, which may end that much after ``wait``.
        teller: Is told why there is no connection yet.
        establish: Gets the connected socket, which it owns from then on, and the seconds that it may take.
            Raises :class:`NotYet` if it turns out that the peer is not behind it, and
            :class:`ChannelTimeout` if those seconds are over. Every other error ends the call.
        stop: No further attempt begins once it is set.

    Raises:
        ValueError: if the address is malformed.
        ChannelError: if the host can never be resolved.
        ChannelTimeout: if nobody answered.
    """
    parse_address(address)
    deadline = time.monotonic() + wait

    def give_up(last: NotYet) -> ChannelError:
        return ChannelTimeout(
            f"nobody answered at {address} within {in_seconds(wait)} ({last}): is the other robot listening?"
        )

    def attempt() -> T:
        targets = resolve(address, deadline - time.monotonic(), lambda why: teller.not_yet(why, deadline))
        return _try_each(targets, deadline, timeout, establish)

    return patiently(attempt, deadline, give_up, teller, f"nobody answers at {address}", stop)


def _try_each(
    targets: list[Target], deadline: float, timeout: float, establish: Callable[[socket.socket, float], T]
) -> T:
    """Try every address of the host once."""
    failure = NotYet("the host has no address")
    for untried, target in zip(range(len(targets), 0, -1), targets, strict=True):
        left = deadline - time.monotonic()
        share = timeout if untried == 1 else min(timeout, max(_ATTEMPT_SECONDS, left / untried))
        try:
            return establish(_connect(target, min(_ATTEMPT_SECONDS, left) / untried), share)
        except NotYet as error:
            failure = error
        except ChannelTimeout as error:
            failure = NotYet(str(error))
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
