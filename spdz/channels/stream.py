"""A connected, non-blocking byte stream, and the plain TCP one."""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeGuard

from spdz.channels.telling import in_seconds
from spdz.channels.times import LONGEST_SLEEP
from spdz.foundations.errors import ChannelTimeout
from spdz.foundations.types import Buffer

_DRAIN = 64 << 10
_PROBES = 4
_LONGEST_KEPT = 32767  # what Linux takes for TCP_KEEPIDLE


class Stream(ABC):
    """A byte stream over a socket that it owns. Nothing blocks; what went wrong is an :class:`OSError`.

    Args:
        sock: A connected socket.
    """

    reads_ahead: bool
    """Whether it may hold bytes that came, and that poll does not see any more."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._socket = sock

    def fileno(self) -> int:
        """The socket's descriptor, to poll."""
        return self._socket.fileno()

    def keep_alive(self, seconds: float) -> None:
        """Have the system break the connection once the peer is out of reach for about so many seconds.

        Without it a connection over which nothing is sent outlives a peer that lost its power or its network
        (RFC 9293, 3.8.4). Where the system cannot be told how long, its own times count.
        """
        whole = max(1, min(int(seconds), _LONGEST_KEPT))
        options = {
            "TCP_KEEPIDLE": max(1, whole // 2),
            "TCP_KEEPALIVE": max(1, whole // 2),  # as macOS calls it
            "TCP_KEEPINTVL": max(1, whole // (2 * _PROBES)),
            "TCP_KEEPCNT": _PROBES,
            "TCP_USER_TIMEOUT": 1000 * whole,  # where bytes are under way: RFC 5482
        }
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, value in options.items():
                if hasattr(socket, name):
                    self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    @property
    @abstractmethod
    def backlog(self) -> bool:
        """Whether bytes wait for :meth:`flush`."""

    @abstractmethod
    def send(self, data: Buffer) -> int:
        """Take bytes to send; returns how many, 0 if none can be taken now."""

    @abstractmethod
    def flush(self) -> bool:
        """Hand what waits to the socket; returns whether nothing waits any more."""

    @abstractmethod
    def receive_into(self, space: memoryview) -> int | None:
        """Write what came into ``space``; returns how many bytes, 0 at the end, None if there is nothing now.

        Raises:
            OSError: if the connection broke.
            ProtocolViolation: if the peer sent something that no honest peer sends.
        """

    def end(self) -> None:
        """Tell the peer that nothing more comes, as far as that can be done at once."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def discard(self) -> bool:
        """Drop what came; returns whether more may come.

        Closing a socket with unread bytes resets the connection, and the reset can overtake what was sent
        last (RFC 2525, 2.17).
        """
        try:
            return bool(self._socket.recv(_DRAIN))
        except BlockingIOError:
            return True
        except OSError:
            return False

    def part(self, last_words: bytes) -> None:
        """Send a few last bytes as far as that can be done at once, and close."""
        with contextlib.suppress(OSError):
            if last_words:
                self.send(memoryview(last_words))
            self.flush()
        self.end()
        self.discard()
        self.close()

    def close(self) -> None:
        """Close the descriptor and do nothing else: another process may go on using the connection."""
        self._socket.close()


class PlainStream(Stream):
    """TCP as it is."""

    backlog = False
    reads_ahead = False

    def send(self, data: Buffer) -> int:
        """Take bytes to send; see :class:`Stream`."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def flush(self) -> bool:
        """Nothing ever waits here."""
        return True

    def receive_into(self, space: memoryview) -> int | None:
        """Write what came into ``space``; see :class:`Stream`."""
        try:
            return self._socket.recv_into(space)
        except BlockingIOError:
            return None


def complete(stream: Stream, step: Callable[[], int], timeout: float, what: str) -> None:
    """Repeat a step that returns the poll events it waits for, until it returns 0.

    Args:
        stream: What to poll.
        step: The step; it does not block.
        timeout: Seconds that all steps may take.
        what: What is being completed, for the error message.

    Raises:
        ChannelTimeout: if it was not completed in time.
    """
    deadline = time.monotonic() + timeout
    poll = select.poll()
    while events := step():
        left = deadline - time.monotonic()
        if left <= 0:
            raise ChannelTimeout(f"{what} was not finished within {in_seconds(timeout)}")
        poll.register(stream, events)
        poll.poll(min(left, LONGEST_SLEEP) * 1000)


def describe(error: OSError) -> str:
    """An operating system's or OpenSSL's error in its own few words; never the peer's."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message
    if isinstance(error, ssl.SSLError) and error.reason:
        return error.reason.replace("_", " ").lower()
    return error.strerror or str(error) or type(error).__name__


def is_about_a_certificate(error: OSError) -> TypeGuard[ssl.SSLError]:
    """Whether a certificate was not accepted: the other side's here, or this side's there (RFC 8446, 6.2)."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return True
    reason = (error.reason or "") if isinstance(error, ssl.SSLError) else ""
    return "ALERT" in reason and ("CERTIFICATE" in reason or "UNKNOWN_CA" in reason)
