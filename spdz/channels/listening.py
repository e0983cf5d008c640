"""Listening at every address of a host, of both families, on one port."""

from __future__ import annotations

import errno
import socket
from types import TracebackType

from spdz.channels.addresses import NotYet, Target, parse_address, resolve
from spdz.channels.stream import describe
from spdz.foundations.errors import ChannelError

LOOK_UP_SECONDS = 5.0
_PORT_TRIES = 16  # a port that is free at one address may be taken at another
_ABSENT = {errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL}  # no IPv6 here; an interface that is not up
_HOPELESS = {errno.EACCES, errno.EPERM, errno.EAFNOSUPPORT}
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}


class Listener:
    """One or more listening sockets on the same port.

    Args:
        sockets: The sockets, listening; the listener owns them from here on.
    """

    def __init__(self, sockets: list[socket.socket]) -> None:
        self.sockets = sockets

    def __enter__(self) -> Listener:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def fileno(self) -> int:
        """The highest of the descriptors."""
        return max(sock.fileno() for sock in self.sockets)

    def close(self) -> None:
        """Stop listening."""
        for sock in self.sockets:
            sock.close()


def open_listener(address: str) -> Listener:
    """Listen at every address that a host has now.

    Addresses that this machine does not have (IPv6 switched off, an interface that is down) are left out as
    long as there are others. The look-up of a name takes at most LOOK_UP_SECONDS.

    Args:
        address: ``host:port``; port 0 takes a port that is free at all of them.

    Raises:
        ValueError: if the address is malformed.
        NotYet: if it cannot be listened on now, but perhaps later.
        ChannelError: if it cannot be listened on.
    """
    _, port = parse_address(address)
    targets = resolve(address, LOOK_UP_SECONDS)
    tries = _PORT_TRIES if port == 0 else 1
    while True:
        tries -= 1
        try:
            return Listener(_bind_all(targets, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and tries:
                continue
            if error.errno in _HOPELESS:
                raise ChannelError(f"cannot listen on {address}: {describe(error)}") from error
            raise NotYet(describe(error), f"cannot listen on {address}") from error


def _bind_all(targets: list[Target], port: int) -> list[socket.socket]:
    sockets: list[socket.socket] = []
    absent: list[OSError] = []
    try:
        for target in targets:
            try:
                sockets.append(_bind(target, port, alone=len(targets) == 1))
            except OSError as error:
                if error.errno not in _ABSENT:
                    raise
                absent.append(error)
            else:
                port = sockets[0].getsockname()[1]
        if not sockets:  # one that may come up is worth waiting for
            raise max(absent, key=lambda error: error.errno not in _HOPELESS)
    except BaseException:
        for sock in sockets:
            sock.close()
        raise
    return sockets


def _bind(target: Target, port: int, alone: bool) -> socket.socket:
    family, where = target
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:  # [::] alone takes IPv4 callers too, on every system
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, not alone)
        listener.bind((where[0], port, *where[2:]))
        listener.listen()
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    return listener


def address_of(listener: Listener) -> str:
    """Where a listener listens first, as ``host:port``, with the port that it got if 0 was asked for."""
    return addresses_of(listener)[0]


def addresses_of(listener: Listener) -> list[str]:
    """Everywhere that a listener listens, as :func:`address_of`."""
    names = [sock.getsockname()[:2] for sock in listener.sockets]
    return [f"[{host}]:{port}" if ":" in host else f"{host}:{port}" for host, port in names]


def accept_one(sock: socket.socket) -> socket.socket | None:
    """Take one connection off a listening socket; None if there is none (any more).

    Raises:
        OSError: if this process or machine has no room for another connection.
    """
    try:
        caller, _ = sock.accept()
    except OSError as error:
        if error.errno in _EXHAUSTED:
            raise
        return None  # nobody there, or gone again before it was taken: accept(2)
    try:
        caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except OSError:  # macOS: gone already
        caller.close()
        return None
    return caller
