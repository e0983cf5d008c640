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

from spdz.channels.telling import Teller, ignore
from spdz.channels.times import LONGEST_SLEEP
from spdz.foundations.errors import ChannelError

RETRY_SECONDS = 0.1
_SLOW_SECONDS = 1.0  # a resolver that takes longer is told of

SocketAddress: TypeAlias = tuple[str, int] | tuple[str, int, int, int]
Target: TypeAlias = tuple[socket.AddressFamily, SocketAddress]
"""An address family and a socket address of it."""

T = TypeVar("T")


class NotYet(ChannelError):
    """An attempt failed in a way that waiting may cure. Never leaves this package: :func:`patiently`.

    Args:
        why: The reason, in a few words.
        what: What does not work, as in "robot cannot be resolved"; empty if whoever made the attempt knows.
    """

    def __init__(self, why: str, what: str = "") -> None:
        super().__init__(f"{what}: {why}" if what else why)
        self.what, self.why = what, why

    def told(self, what: str) -> str:
        """The reason as :class:`Teller` takes it; ``what`` stands in where this error has none."""
        return f"{self.what or what} yet ({self.why})"


def patiently(
    attempt: Callable[[], T],
    deadline: float,
    give_up: Callable[[NotYet], ChannelError],
    teller: Teller,
    what: str,
    stop: threading.Event | None = None,
) -> T:
    """Repeat an attempt while it fails with :class:`NotYet`.

    Args:
        attempt: What to try, at least once.
        deadline: ``time.monotonic()`` after which no further attempt begins.
        give_up: Makes the error that is raised then from that of the last attempt.
        teller: Is told why an attempt failed that is made again.
        what: What does not work if an attempt fails and does not say it.
        stop: No further attempt begins once it is set.
    """
    while True:
        try:
            return attempt()
        except NotYet as error:
            if time.monotonic() + RETRY_SECONDS >= deadline or (stop is not None and stop.is_set()):
                raise give_up(error) from error
            teller.not_yet(error.told(what), deadline)
        time.sleep(RETRY_SECONDS)


def parse_address(address: str) -> tuple[str, int]:
    """Split ``host:port``, ``1.2.3.4:port`` or ``[v6 address]:port``.

    Raises:
        ValueError: if it is none of these.
    """
    host, colon, port = address.rpartition(":")
    if not address.isprintable():
        raise ValueError(f"an address is made of printable characters, not {address!r}")
    bracketed = host.startswith("[") and host.endswith("]")
    if not colon or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"an address is host:port with a port from 0 to 65535, not {address!r}")
    if not bracketed and ":" in host:
        raise ValueError(f"write an IPv6 address in brackets, as in [::1]:9000, not {address!r}")
    host = host[1:-1] if bracketed else host
    if not host:
        raise ValueError(f"the host is missing in {address!r}; 0.0.0.0 listens on every interface")
    return host, int(port)


def resolve(address: str, seconds: float, on_slow: Callable[[str], None] = ignore) -> list[Target]:
    """Every address of a host at this moment, each once, in the resolver's order.

    Args:
        address: ``host:port``.
        seconds: How long a look-up may take.
        on_slow: Called with the reason if it takes more than a second.

    Raises:
        ValueError: if the address is malformed.
        NotYet: if the name is not known now, or the resolver does not answer in time.
        ChannelError: if it can never be a host name.
    """
    host, port = parse_address(address)
    what = f"{host} cannot be resolved"
    silence = NotYet("the resolver does not answer", what)
    try:
        if _is_numeric(host):
            return _look_up(host, port)
        return _within(seconds, host, port, lambda: on_slow(silence.told(what)))
    except queue.Empty:
        raise silence from None
    except OSError as error:
        raise NotYet(error.strerror or str(error), what) from error
    except UnicodeError as error:
        raise ChannelError(f"{what}: {error}") from error


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


def _within(seconds: float, host: str, port: int, on_slow: Callable[[], None]) -> list[Target]:
    """Look a name up in a thread; :class:`queue.Empty` if that takes longer."""
    deadline = time.monotonic() + seconds
    answers: queue.SimpleQueue[list[Target] | Exception] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put(_look_up(host, port))
        except Exception as error:
            answers.put(error)

    threading.Thread(target=work, name=f"look-up of {host}", daemon=True).start()
    try:
        answer = answers.get(timeout=max(0.0, min(seconds, _SLOW_SECONDS)))
    except queue.Empty:
        if (left := deadline - time.monotonic()) <= 0:
            raise
        on_slow()
        answer = answers.get(timeout=min(left, LONGEST_SLEEP))
    if isinstance(answer, Exception):
        raise answer
    return answer
