"""TLS as a byte stream: OpenSSL works on memory, and this file moves the bytes.

OpenSSL answers everything that is not application data by itself, in a loop inside one call. On a socket, a
peer that sends TLS 1.3 key updates without pause (RFC 8446, 4.6.3) holds that call for as long as it likes,
past every deadline and with no signal handler run. In memory a call ends where the bytes end: one call works
on at most READ_BYTES, a few hundredths of a second at worst, and the caller looks at the time in between.

Security limits: READ_BYTES a call; MAX_SILENT, received in a row without application data; MAX_ANSWERS,
answers to key updates that the peer does not take.
"""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
from typing import Any, cast

from spdz.channels.stream import Stream
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import Buffer

READ_BYTES = 64 << 10
MAX_SILENT = 32 << 10
"""An honest peer stays below: one record, of at most 5 + 2^14 + 256 bytes (RFC 8446, 5.2), is under way."""
MAX_ANSWERS = 16 << 10


class TlsStream(Stream):
    """TLS over a connected TCP socket, from the handshake on.

    Args:
        sock: A connected socket.
        context: What to demand of the peer.
        server_side: Whether this side was called.
    """

    def __init__(self, sock: socket.socket, context: ssl.SSLContext, server_side: bool) -> None:
        super().__init__(sock)
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side)
        self._unsent = memoryview(b"")
        self._buffer = memoryview(bytearray(READ_BYTES))
        self._silent = 0  # bytes received since the last application data

    @property
    def certificate_names(self) -> tuple[Any, ...]:
        """The subjectAltName entries of the peer's certificate, after a handshake that verified it."""
        return cast(tuple[Any, ...], (self._tls.getpeercert() or {}).get("subjectAltName", ()))

    def handshake(self) -> int:
        """Go on with the handshake; returns the poll events that it waits for, 0 when it is done.

        Raises:
            ssl.SSLError: if the handshake failed; :meth:`end` sends the alert that tells the peer why.
            OSError: if the connection broke, or ended, before that.
        """
        ended = self._feed() == 0
        try:
            self._tls.do_handshake()
            waits_for = self._silent = 0
        except ssl.SSLWantReadError:
            if ended:
                raise ConnectionAbortedError(None, "it hung up") from None
            waits_for = select.POLLIN
        return waits_for if self.flush() else waits_for | select.POLLOUT

    reads_ahead = True

    @property
    def backlog(self) -> bool:
        """Whether encrypted bytes wait for :meth:`flush`."""
        return bool(self._unsent) or self._outgoing.pending > 0

    def send(self, data: Buffer) -> int:
        """Encrypt bytes once the socket has taken what was encrypted before; see :class:`Stream`."""
        if self._unsent and not self.flush():
            return 0
        taken = self._tls.write(data)
        self.flush()
        return taken

    def flush(self) -> bool:
        """Hand encrypted bytes to the socket; returns whether none are left."""
        while True:
            if not self._unsent:
                if not self._outgoing.pending:
                    return True
                self._unsent = memoryview(self._outgoing.read())
            try:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
            except BlockingIOError:
                return False

    def receive_into(self, space: memoryview) -> int | None:
        """Decrypt into ``space``; see :class:`Stream`."""
        if not self._incoming.pending and not self._tls.pending():
            fed = self._feed()
            if not fed:
                return fed
        if self._outgoing.pending > MAX_ANSWERS:  # send() leaves nothing of its own there
            raise ProtocolViolation("the peer demands TLS key updates and does not take them")
        try:
            count: int = self._tls.read(len(space), space)  # type: ignore[assignment]
        except ssl.SSLWantReadError:
            if self._silent > MAX_SILENT:
                raise ProtocolViolation(
                    "the peer sends TLS records without data, such as key updates, and nothing else"
                ) from None
            return None
        self._silent = 0
        return count

    def end(self) -> None:
        """Send the alert of an error, or close_notify (RFC 8446, 6), as far as that can be done at once."""
        with contextlib.suppress(OSError):
            with contextlib.suppress(ssl.SSLError):  # the peer's close_notify is not waited for
                self._tls.unwrap()
            self.flush()
        super().end()

    def _feed(self) -> int | None:
        """Read from the socket once; returns how many bytes, 0 at the end, None if there is nothing now."""
        try:
            count = self._socket.recv_into(self._buffer)
        except BlockingIOError:
            return None
        self._incoming.write(self._buffer[:count])
        self._silent += count
        return count
