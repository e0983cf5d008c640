"""Plain TCP: how two robots find each other without TLS.

Plain TCP neither hides nor protects anything: whoever is on the line can read and change every frame. It is
for benchmarks and for lines that are protected otherwise; robots use :mod:`spdz.channels.tls`, which runs
the same loop.

The caller sends a line of greeting, and the listener answers the caller that it takes. So neither a port scan
nor a forwarder that takes the connection before the peer listens passes for the peer.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Callable

from spdz.channels.addresses import NotYet
from spdz.channels.dialing import call
from spdz.channels.frames import MAX_FRAME, AbortReason, pack_abort
from spdz.channels.listening import open_listener
from spdz.channels.reception import Caller, receive
from spdz.channels.socket_channel import SocketChannel
from spdz.channels.stream import PlainStream, Stream, complete, describe
from spdz.channels.telling import Teller, ignore
from spdz.channels.times import DEFAULT_TIMEOUT, check_limits
from spdz.foundations.errors import ChannelError

DEFAULT_WAIT = 60.0
CALLER_GREETING = b"spdz caller 1\n"
LISTENER_GREETING = b"spdz listener 1\n"
_TLS_FIRST_BYTES = b"\x15\x16"  # an alert, a handshake record (RFC 8446, 5.1)


def listen(
    address: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_listening: Callable[[str], None] = ignore,
    on_event: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Wait for the peer and take the first that greets. Insecure: see the module's text.

    Args:
        address: Where to listen, ``host:port``; port 0 takes any free port.
        timeout: Seconds that one exchange may take.
        wait: Seconds to wait for the peer, and for the address if that cannot be listened on yet.
        max_frame: Largest payload in bytes.
        on_listening: Called with the actual address as soon as the peer can connect.
        on_event: Called with a sentence when this side listens, and when the reason changes why it does not
            yet, or why a caller was refused.

    Raises:
        ValueError: if an argument is malformed.
        ChannelError: if the address cannot be listened on, or nobody who called greeted.
        ChannelTimeout: if nobody connected.
    """
    check_limits(timeout, max_frame)
    stream = receive(
        lambda: open_listener(address),
        wait,
        on_listening,
        Teller(on_event),
        _PlainCaller,
        "the other robot",
        "a greeting",
    )
    return SocketChannel(stream, timeout, max_frame)


def connect(
    address: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_event: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Connect to a listening peer. Insecure: see the module's text.

    Args:
        address: Where the peer listens, ``host:port``.
        timeout: Seconds that the greeting, and then one exchange, may take.
        wait: Seconds to keep trying, also while the host name or the network is not there yet, and where
            somebody takes the connection and does not greet within ``timeout``.
        max_frame: Largest payload in bytes.
        on_event: Called with a sentence when the reason changes why there is no connection yet.
        max_frame: Largest payload in bytes.

    Raises:
        ValueError: if an argument is malformed.
        ChannelError: if the host can never be resolved, or whoever listens there is no peer of this kind.
        ChannelTimeout: if nobody answered.
    """
    check_limits(timeout, max_frame)
    return SocketChannel(call(address, wait, timeout, Teller(on_event), _greet), timeout, max_frame)


class _Greeting:
    """Reads one line that is known beforehand, and nothing behind it."""

    def __init__(self, stream: Stream, line: bytes) -> None:
        self._stream = stream
        self._missing = line

    def read(self) -> int:
        """Go on; returns the poll event that it waits for, 0 when the line is there.

        Raises:
            ChannelError: if something else came.
            OSError: if the connection broke, or ended, before that.
        """
        space = memoryview(bytearray(len(self._missing)))
        count = self._stream.receive_into(space)
        if count is None:
            return select.POLLIN
        if count == 0:
            raise ConnectionAbortedError(None, "it hung up")
        if space[:count] != self._missing[:count]:
            tls = " (it seems to speak TLS, and this side does not)" if space[0] in _TLS_FIRST_BYTES else ""
            raise ChannelError(f"the other side did not send the greeting of plain TCP{tls}")
        self._missing = self._missing[count:]
        return select.POLLIN if self._missing else 0


class _PlainCaller(Caller):
    farewell = pack_abort(AbortReason.PROTOCOL_VIOLATION, 0, 0)

    def __init__(self, sock: socket.socket) -> None:
        super().__init__(PlainStream(sock))
        self._greeting = _Greeting(self.stream, CALLER_GREETING)

    def proceed(self) -> int:
        try:
            events = self._greeting.read()
            if not events:
                self.stream.send(memoryview(LISTENER_GREETING))  # an empty send buffer takes it whole
            return events
        except OSError as error:
            raise ChannelError(describe(error)) from error


def _greet(sock: socket.socket, timeout: float) -> PlainStream:
    stream = PlainStream(sock)
    try:
        stream.send(memoryview(CALLER_GREETING))
        complete(stream, _Greeting(stream, LISTENER_GREETING).read, timeout, "the greeting of plain TCP")
        return stream
    except OSError as error:
        stream.close()
        raise NotYet(
            f"{describe(error)} before it greeted, as a forwarder does, or a listener that speaks TLS"
        ) from error
    except BaseException:
        stream.close()
        raise
