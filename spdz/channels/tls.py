"""TLS 1.3 between exactly two robots, with the certificates that the dealer issued for the mission.

A robot's credentials folder holds ``cert.pem`` and ``key.pem`` (its own) and ``ca.pem`` (the mission's
certificate authority). Each side demands a certificate of that authority, and the one DNS name in it has to
be the robot that the tape names: a valid certificate of a third robot of the mission is refused.

The listener runs the handshakes of several callers at the same time and takes the first caller that proves
to be the peer. So whoever connects and sends garbage, or nothing, neither ends the wait nor delays the peer.
"""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
import time
from collections.abc import Callable
from pathlib import Path

from spdz.channels.base import DEFAULT_TIMEOUT
from spdz.channels.frames import MAX_FRAME, AbortReason, pack_abort
from spdz.channels.tcp import (
    DEFAULT_WAIT,
    SocketChannel,
    accept_one,
    address_of,
    describe,
    dial,
    ignore,
    open_listener,
    owned,
)
from spdz.errors import ChannelError, ChannelTimeout

CA_FILE = "ca.pem"
CERTIFICATE_FILE = "cert.pem"
KEY_FILE = "key.pem"

MAX_HANDSHAKES = 32
"""Security limit: handshakes that a listener has under way; one more, and the oldest is dropped."""


def listen(
    address: str,
    credentials: Path,
    peer: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_listening: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Wait for one particular robot; all other callers are refused.

    Args:
        address: Where to listen, ``host:port``; port 0 takes any free port.
        credentials: Folder of this robot's credentials.
        peer: Name of the only robot to accept, as the dealer knows it.
        timeout: Seconds that one exchange may take.
        wait: Seconds to wait for the peer.
        max_frame: Largest payload in bytes.
        on_listening: Called with the actual address as soon as the peer can connect.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        ChannelError: if the address cannot be listened on, or everybody who called was refused.
        ChannelTimeout: if nobody called.
    """
    context = make_context(credentials, ssl.PROTOCOL_TLS_SERVER)
    with (
        open_listener(address) as listener,
        contextlib.closing(_Reception(listener, context, peer)) as reception,
    ):
        on_listening(address_of(listener))
        return owned(reception.wait_for_peer(wait), timeout, max_frame)


def connect(
    address: str,
    credentials: Path,
    peer: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
) -> SocketChannel:
    """Connect to one particular robot.

    In TLS 1.3 the listener judges this side's certificate after this side is done with the handshake: its
    refusal comes as the error of the first exchange.

    Args:
        address: Where the peer listens, ``host:port``.
        credentials: Folder of this robot's credentials.
        peer: Name of the only robot to talk to, as the dealer knows it.
        timeout: Seconds that the TLS handshake, and then one exchange, may take.
        wait: Seconds to keep trying to reach the address.
        max_frame: Largest payload in bytes.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        ChannelError: if whoever listens there is not the peer; both names are told.
        ChannelTimeout: if nobody answered.
    """
    context = make_context(credentials, ssl.PROTOCOL_TLS_CLIENT)
    sock = _wrap(dial(address, wait), context, server_side=False)
    try:
        _finish_handshake(sock, timeout)
        require_name(sock, peer)
    except BaseException:
        sock.close()
        raise
    return owned(sock, timeout, max_frame)


def make_context(credentials: Path, protocol: int) -> ssl.SSLContext:
    """A TLS 1.3 context that demands a certificate of the mission's authority from the peer.

    Args:
        credentials: Folder with ``ca.pem``, ``cert.pem`` and ``key.pem``.
        protocol: ``ssl.PROTOCOL_TLS_SERVER`` or ``ssl.PROTOCOL_TLS_CLIENT``.

    Raises:
        ValueError: if a file is missing or cannot be used.
    """
    context = ssl.SSLContext(protocol)
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False  # names robots, not hosts: require_name
    context.verify_mode = ssl.CERT_REQUIRED
    context.verify_flags |= ssl.VERIFY_X509_STRICT
    if protocol == ssl.PROTOCOL_TLS_SERVER:
        context.num_tickets = 0  # sessions are not resumed
    for name in (CA_FILE, CERTIFICATE_FILE, KEY_FILE):
        if not (credentials / name).is_file():
            raise ValueError(f"{credentials / name} is missing: give the folder that the dealer wrote")
    try:
        context.load_verify_locations(credentials / CA_FILE)
        context.load_cert_chain(credentials / CERTIFICATE_FILE, credentials / KEY_FILE, password="")
    except OSError as error:
        raise ValueError(f"the credentials in {credentials} cannot be used: {describe(error)}") from error
    return context


def require_name(sock: ssl.SSLSocket, peer: str) -> None:
    """Accept exactly one name in the peer's (already verified) certificate.

    Raises:
        ChannelError: if it is another robot's.
    """
    names = (sock.getpeercert() or {}).get("subjectAltName", ())
    if names != (("DNS", peer),):
        found = ", ".join(str(entry[1]) for entry in names)
        raise ChannelError(f"expected the robot {peer!r}, but the certificate there is of {found[:80]!r}")


def _wrap(sock: socket.socket, context: ssl.SSLContext, server_side: bool) -> ssl.SSLSocket:
    """A TLS socket, non-blocking, before its handshake."""
    try:
        sock.setblocking(False)
        return context.wrap_socket(sock, server_side=server_side, do_handshake_on_connect=False)
    except OSError as error:
        raise ChannelError(f"the connection broke: {describe(error)}") from error
    finally:
        sock.close()  # wrapping has moved the descriptor


def _handshake_step(sock: ssl.SSLSocket) -> int:
    """Go on with a handshake; returns the poll event that it waits for, or 0 when it is done."""
    try:
        sock.do_handshake()
    except ssl.SSLWantReadError:
        return select.POLLIN
    except ssl.SSLWantWriteError:
        return select.POLLOUT
    return 0


def _finish_handshake(sock: ssl.SSLSocket, timeout: float) -> None:
    deadline = time.monotonic() + timeout
    poll = select.poll()
    try:
        while event := _handshake_step(sock):
            left = deadline - time.monotonic()
            if left <= 0:
                raise ChannelTimeout(f"the TLS handshake was not finished within {timeout:g} s")
            poll.register(sock, event)
            poll.poll(left * 1000)
    except OSError as error:
        raise ChannelError(
            f"the TLS handshake failed: {describe(error)}. Do both robots have credentials from the same run "
            "of the dealer, and does the other side speak TLS?"
        ) from error


class _Reception:
    """The callers of a listener, until one of them proves to be the peer."""

    def __init__(self, listener: socket.socket, context: ssl.SSLContext, peer: str) -> None:
        self._listener = listener
        self._context = context
        self._peer = peer
        self._callers: dict[int, ssl.SSLSocket] = {}  # by descriptor, the oldest first
        self._poll = select.poll()
        self._refused = 0
        self._last_refusal = ""

    def wait_for_peer(self, wait: float) -> ssl.SSLSocket:
        """The peer's socket, after its handshake."""
        deadline = time.monotonic() + wait
        self._poll.register(self._listener, select.POLLIN)
        while (left := deadline - time.monotonic()) > 0:
            for descriptor, _ in self._poll.poll(left * 1000):
                if descriptor == self._listener.fileno():
                    self._admit()
                elif (caller := self._callers.get(descriptor)) is not None and self._proves(caller):
                    self._poll.unregister(caller)
                    return self._callers.pop(descriptor)
        if self._refused:
            raise ChannelError(
                f"{self._peer!r} did not connect within {wait:g} s; callers refused: {self._refused}, the "
                f"last one because: {self._last_refusal}"
            )
        stalled = f" ({len(self._callers)} connected without a TLS handshake)" if self._callers else ""
        raise ChannelTimeout(f"{self._peer!r} did not connect within {wait:g} s{stalled}")

    def close(self) -> None:
        """Hang up on every caller that is left."""
        while self._callers:
            self._dismiss(next(iter(self._callers.values())))

    def _admit(self) -> None:
        sock = accept_one(self._listener)
        if sock is None:
            return
        with contextlib.suppress(ChannelError):  # gone already
            caller = _wrap(sock, self._context, server_side=True)
            if len(self._callers) >= MAX_HANDSHAKES:
                self._dismiss(next(iter(self._callers.values())))
            self._callers[caller.fileno()] = caller
            self._poll.register(caller, select.POLLIN)

    def _proves(self, caller: ssl.SSLSocket) -> bool:
        """Go on with a caller's handshake; True once it is known to be the peer."""
        try:
            event = _handshake_step(caller)
            if event:
                self._poll.modify(caller, event)
                return False
            require_name(caller, self._peer)
            return True
        except ChannelError as error:
            with contextlib.suppress(OSError):
                caller.send(pack_abort(AbortReason.WRONG_ROBOT, 0, 0))
            self._refuse(caller, str(error))
        except OSError as error:
            self._refuse(caller, f"the TLS handshake failed: {describe(error)}")
        return False

    def _refuse(self, caller: ssl.SSLSocket, why: str) -> None:
        self._refused += 1
        self._last_refusal = why
        self._dismiss(caller)

    def _dismiss(self, caller: ssl.SSLSocket) -> None:
        self._poll.unregister(caller)
        del self._callers[caller.fileno()]
        caller.close()
