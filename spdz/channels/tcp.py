"""TCP: the loop that drives a socket in both directions at once, and how two robots find each other.

Plain TCP neither hides nor protects anything: whoever is on the line can read and change every frame. It is
for benchmarks and for lines that are protected otherwise; robots use :mod:`spdz.channels.tls`, which runs
the same loop.
"""

from __future__ import annotations

import select
import socket
import ssl
import time
from collections.abc import Callable

from spdz.channels.base import DEFAULT_TIMEOUT, Channel, remaining
from spdz.channels.frames import MAX_FRAME, FrameReader, merge_small
from spdz.errors import ChannelClosed, ChannelError, ChannelTimeout

DEFAULT_WAIT = 60.0
_SLICE = 256 << 10  # bytes offered to one send, so that both directions take turns
_DRAIN = 64 << 10
_RETRY_SECONDS = 0.1
_ATTEMPT_SECONDS = 5.0  # one attempt to connect, where packets are dropped without an answer


_SPINS = 100
"""Looks at the socket, about 1 us each, before the process sleeps: waking up costs more than a round."""


class SocketChannel(Channel):
    """A channel over a connected TCP socket, plain or TLS.

    Args:
        sock: The socket, after its TLS handshake if it is a TLS one. The channel owns it from here on.
        timeout: Seconds that one exchange may take.
        max_frame: Largest payload in bytes.
    """

    def __init__(
        self, sock: socket.socket, timeout: float = DEFAULT_TIMEOUT, max_frame: int = MAX_FRAME
    ) -> None:
        super().__init__(timeout, max_frame)
        sock.setblocking(False)
        self._socket = sock
        self._poll = select.poll()
        self._in_frame = False  # whether part of a frame may be out
        self._send_error: OSError | None = None

    def _swap(self, frame: list[memoryview], reader: FrameReader, deadline: float) -> None:
        pieces = list(merge_small(frame))[::-1]
        self._in_frame = True
        while True:
            # Read before polling: a TLS socket may hold decrypted bytes that poll does not see.
            out_blocked = self._send_some(pieces) if pieces else 0
            in_blocked = self._receive_some(reader) if not reader.complete else 0
            if (out_blocked or not pieces) and (in_blocked or reader.complete):
                if not out_blocked | in_blocked:
                    break
                seconds = remaining(deadline, reader, self._timeout)
                self._poll.register(self._socket, out_blocked | in_blocked)
                if not any(self._poll.poll(0) for _ in range(_SPINS)):
                    self._poll.poll(seconds * 1000)
            else:
                remaining(deadline, reader, self._timeout)
        if self._send_error is not None:
            raise _lost(self._send_error, reader)

    def _send_some(self, pieces: list[memoryview]) -> int:
        """Send from the last piece; returns the poll event that it has to wait for, or 0."""
        # What would block is offered again unchanged, as OpenSSL demands (SSL_write(3)): Python sets
        # SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER, so only the bytes and their number have to be the same.
        piece = pieces[-1]
        try:
            sent = self._socket.send(piece[:_SLICE])
        except (BlockingIOError, ssl.SSLWantWriteError):
            return select.POLLOUT
        except ssl.SSLWantReadError:
            return select.POLLIN
        except OSError as error:  # the peer is gone, but may have said why: go on reading
            self._send_error = error
            pieces.clear()
            return 0
        if sent < len(piece):
            pieces[-1] = piece[sent:]
        else:
            pieces.pop()
            self._in_frame = bool(pieces)
        return 0

    def _receive_some(self, reader: FrameReader) -> int:
        """Read what is there; returns the poll event that it has to wait for, or 0."""
        try:
            count = self._socket.recv_into(reader.space)
        except (BlockingIOError, ssl.SSLWantReadError):
            return select.POLLIN
        except ssl.SSLWantWriteError:
            return select.POLLOUT
        except OSError as error:
            raise _lost(error, reader) from error
        if count == 0:
            raise ChannelClosed(f"the peer closed the connection ({reader.progress()})")
        reader.advance(count)
        return 0

    def _send_last(self, frame: bytes, deadline: float) -> None:
        if self._in_frame:
            return
        self._socket.settimeout(deadline - time.monotonic())
        self._socket.sendall(frame)
        # Closing a socket with unread bytes resets the connection, and the reset can overtake the frame
        # (RFC 2525, 2.17). So read until the peer hangs up, or the time is over.
        self._socket.shutdown(socket.SHUT_WR)
        while (left := deadline - time.monotonic()) > 0:
            self._socket.settimeout(left)
            if not self._socket.recv(_DRAIN):
                return

    def _hang_up(self) -> None:
        self._socket.close()


def _lost(error: OSError, reader: FrameReader) -> ChannelError:
    """The error of a broken connection, in this package's terms."""
    if isinstance(error, TimeoutError):  # TCP itself gave up: ETIMEDOUT
        return ChannelTimeout(f"the network does not reach the peer any more ({reader.progress()})")
    if isinstance(error, ssl.SSLError) and "ALERT" in (error.reason or ""):
        return ChannelClosed(
            f"the peer refused this side's TLS connection or certificate ({error.reason}): are both robots' "
            "credentials from the same run of the dealer?"
        )
    return ChannelClosed(f"the connection broke: {describe(error)} ({reader.progress()})")


def describe(error: OSError) -> str:
    """An operating system's or OpenSSL's error in its own few words."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message
    if isinstance(error, ssl.SSLError) and error.reason:
        return error.reason.replace("_", " ").lower()
    return error.strerror or type(error).__name__


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


def _resolve(address: str) -> list[tuple[socket.AddressFamily, tuple[str, int]]]:
    host, port = parse_address(address)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise ChannelError(f"the host name {host!r} cannot be resolved: {error}") from error
    return [(family, where) for family, _, _, _, where in found]  # type: ignore[misc]


def open_listener(address: str) -> socket.socket:
    """A listening socket.

    Raises:
        ValueError: if the address is malformed.
        ChannelError: if it cannot be listened on.
    """
    family, where = _resolve(address)[0]
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(where)
        listener.listen()
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise ChannelError(f"cannot listen on {address}: {error.strerror}") from error
    return listener


def address_of(listener: socket.socket) -> str:
    """Where a listener listens, as ``host:port``, with the port that it got if 0 was asked for."""
    host, port = listener.getsockname()[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def accept_one(listener: socket.socket) -> socket.socket | None:
    """Take one connection off a listener; None if there is none (any more)."""
    try:
        sock, _ = listener.accept()
    except OSError:  # nobody there, or gone again before it was taken: accept(2)
        return None
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setblocking(False)
    return sock


def dial(address: str, wait: float) -> socket.socket:
    """Connect, trying again until ``wait`` seconds have passed, so that either side can be started first.

    Looking up a host name takes as long as the system's resolver lets it.

    Raises:
        ValueError: if the address is malformed.
        ChannelError: if the host name is unknown.
        ChannelTimeout: if nobody answered.
    """
    deadline = time.monotonic() + wait
    targets = _resolve(address)
    while True:
        for family, where in targets:
            sock = socket.socket(family, socket.SOCK_STREAM)
            try:
                sock.settimeout(max(0.01, min(_ATTEMPT_SECONDS, deadline - time.monotonic())))
                sock.connect(where)
                # Without a listener, a local port from the ephemeral range can be connected to itself.
                if sock.getsockname() == sock.getpeername():
                    raise ConnectionRefusedError(None, "Connection refused")
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return sock
            except OSError as error:
                sock.close()
                reason = describe(error)
        if time.monotonic() + _RETRY_SECONDS >= deadline:
            raise ChannelTimeout(
                f"nobody answered at {address} within {wait:g} s ({reason}): is the other robot listening?"
            )
        time.sleep(_RETRY_SECONDS)


def ignore(address: str) -> None:
    """The default ``on_listening``."""


def listen(
    address: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_listening: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Wait for the peer and take the first connection that comes. Insecure: see the module's text.

    Args:
        address: Where to listen, ``host:port``; port 0 takes any free port.
        timeout: Seconds that one exchange may take.
        wait: Seconds to wait for the peer.
        max_frame: Largest payload in bytes.
        on_listening: Called with the actual address as soon as the peer can connect.

    Raises:
        ValueError: if an argument is malformed.
        ChannelError: if the address cannot be listened on.
        ChannelTimeout: if nobody connected.
    """
    deadline = time.monotonic() + wait
    with open_listener(address) as listener:
        on_listening(address_of(listener))
        poll = select.poll()
        poll.register(listener, select.POLLIN)
        while (left := deadline - time.monotonic()) > 0:
            if poll.poll(left * 1000) and (sock := accept_one(listener)) is not None:
                return owned(sock, timeout, max_frame)
    raise ChannelTimeout(f"nobody connected to {address} within {wait:g} s")


def connect(
    address: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
) -> SocketChannel:
    """Connect to a listening peer. Insecure: see the module's text.

    Args:
        address: Where the peer listens, ``host:port``.
        timeout: Seconds that one exchange may take.
        wait: Seconds to keep trying.
        max_frame: Largest payload in bytes.

    Raises:
        ValueError: if an argument is malformed.
        ChannelError: if the host name is unknown.
        ChannelTimeout: if nobody answered.
    """
    return owned(dial(address, wait), timeout, max_frame)


def owned(sock: socket.socket, timeout: float, max_frame: int) -> SocketChannel:
    """A channel for a socket that is closed if the channel cannot be made."""
    try:
        return SocketChannel(sock, timeout, max_frame)
    except BaseException:
        sock.close()
        raise
