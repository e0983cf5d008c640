"""Addresses: ``host:port`` as text, and what a host name stands for at this moment.

A name is looked up anew on every try: robots move between networks, and a name of multicast DNS is unknown
until its robot is there. The system's resolver may block for as long as it likes and lets no signal handler
run meanwhile, so names are looked up in a thread that is left behind when the time is over.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from collections.abc import Callable
from typing import TypeAlias, TypeVar

from spdz.channels.base import LONGEST_SLEEP
from spdz.errors import ChannelError

RETRY_SECONDS = 0.1

SocketAddress: TypeAlias = tuple[str, int] | tuple[str, int, int, int]
Target: TypeAlias = tuple[socket.AddressFamily, SocketAddress]
"""An address family and a socket address of it."""

T = TypeVar("T")


class NotYet(ChannelError):
    """An attempt failed in a way that waiting may cure. Never leaves this package: :func:`patiently`."""


def patiently(attempt: Callable[[], T], deadline: float, give_up: Callable[[NotYet], ChannelError]) -> T:
    """Repeat an attempt while it fails with :class:`NotYet`.

    Args:
        attempt: What to try, at least once.
        deadline: ``time.monotonic()`` after which no further attempt begins.
        give_up: Makes the error that is raised then from that of the last attempt.
    """
    while True:
        try:
            return attempt()
        except NotYet as error:
            if time.monotonic() + RETRY_SECONDS >= deadline:
                raise give_up(error) from error
        time.sleep(RETRY_SECONDS)


def parse_address(address: str) -> tuple[str, int]:
    """Split ``host:port``, ``1.2.3.4:port`` or ``[v6 address]:port``.

    Raises:
        ValueError: if it is none of these.
    """
    host, colon, port = address.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    if not colon or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"an address is host:port with a port from 0 to 65535, not {address!r}")
    if not bracketed and ":" in host:
        raise ValueError(f"write an IPv6 address in brackets, as in [::1]:9000, not {address!r}")
    host = host[1:-1] if bracketed else host
    if not host:
        raise ValueError(f"the host is missing in {address!r}; 0.0.0.0 listens on every interface")
    return host, int(port)


def resolve(address: str, seconds: float) -> list[Target]:
    """Every address of a host at this moment, each once, in the resolver's order.

    Args:
        address: ``host:port``.
        seconds: How long a look-up may take.

    Raises:
        ValueError: if the address is malformed.
        NotYet: if the name is not known now, or the resolver does not answer in time.
        ChannelError: if it can never be a host name.
    """
    host, port = parse_address(address)
    try:
        found = _look_up(host, port) if _is_numeric(host) else _within(seconds, host, port)
    except queue.Empty:
        raise NotYet(f"the host name {host!r} cannot be resolved: the resolver does not answer") from None
    except OSError as error:
        raise NotYet(f"the host name {host!r} cannot be resolved: {error.strerror or error}") from error
    except UnicodeError as error:
        raise ChannelError(f"the host name {host!r} cannot be resolved: {error}") from error
    return found


def _is_numeric(host: str) -> bool:
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            socket.inet_pton(family, host)
        except (OSError, ValueError):
            continue
        return True
    return False


def _look_up(host: str, port: int) -> list[Target]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys((family, where) for family, _, _, _, where in found))  # type: ignore[misc]


def _within(seconds: float, host: str, port: int) -> list[Target]:
    """Look a name up in a thread; :class:`queue.Empty` if that takes longer."""
    answers: queue.SimpleQueue[list[Target] | Exception] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put(_look_up(host, port))
        except Exception as error:
            answers.put(error)

    threading.Thread(target=work, name=f"look-up of {host}", daemon=True).start()
    answer = answers.get(timeout=max(0.0, min(seconds, LONGEST_SLEEP)))
    if isinstance(answer, Exception):
        raise answer
    return answer
