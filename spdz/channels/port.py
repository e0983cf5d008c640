"""One listening port of a robot for all its peers; :func:`dial` calls such a port.

A thread of the port's own accepts, and serves all callers at once: each proves by its certificate to be one
of the peers, and names a topic (:mod:`spdz.channels.topic`). Then its call waits until the program takes it.

Nobody waits for ever. A call that is not taken within ``timeout`` is dropped on both sides, and :func:`dial`
calls again while its ``wait`` lasts. So what is taken is recent, also where a radio link went without a sign.
A channel over which nothing is sent breaks on either side when the other is out of reach for about that long.

Security limits: callers under way are MAX_HANDSHAKES (:mod:`spdz.channels.reception`) and one for each peer
and topic, so that all peers may come at once, each for ``timeout`` seconds at most; waiting calls are one for
each peer and topic; a topic has MAX_TOPIC bytes.
"""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import threading
import time
from collections.abc import Callable, Collection
from pathlib import Path
from types import TracebackType

from spdz.channels.addresses import NotYet, parse_address
from spdz.channels.base import Channel
from spdz.channels.calling import dial
from spdz.channels.frames import MAX_FRAME
from spdz.channels.listening import Listener, addresses_of, open_listener
from spdz.channels.parking import Parking
from spdz.channels.reception import MAX_HANDSHAKES, Reception
from spdz.channels.socket_channel import SocketChannel
from spdz.channels.telling import Teller, harmless, ignore, in_seconds
from spdz.channels.times import DEFAULT_TIMEOUT, check_limits
from spdz.channels.tls import make_context
from spdz.channels.tls_stream import TlsStream
from spdz.channels.topic import TopicCaller, topic_bytes
from spdz.foundations.errors import ChannelError, ChannelTimeout

__all__ = ["Port", "dial"]

_AGAIN = 60.0
"""Seconds before a reason that takes turns with others is told again: a port is open for hours."""
_REST = 0.5
"""Seconds between two tries to listen."""
_END_SECONDS = 1.0
_GRACE = 1.0
"""Seconds that a call waits longer here than its caller does who has the same ``timeout``."""


class Port:
    """Listens for all peers of a robot. Any thread may take calls.

    The address is tried once before this returns; if it cannot be listened on yet, the thread goes on trying.
    In a fork the port cannot be used, and closing it closes descriptors only.

    Args:
        address: Where to listen, ``host:port``; port 0 takes any free port.
        credentials: Folder of this robot's credentials.
        peers: Names of the robots to accept.
        topics: What they may call about.
        timeout: Seconds that a caller may take until it has named a topic, that its call then waits to be
            taken, and that one exchange may take after that.
        max_frame: Largest payload in bytes.
        on_event: Called with a sentence when this side listens, and when the reason changes why it does not
            yet, or why a caller was refused; by the port's thread, which waits for it meanwhile.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        ChannelError: if the address can never be listened on.
    """

    def __init__(
        self,
        address: str,
        credentials: Path,
        peers: Collection[str],
        topics: Collection[str],
        *,
        timeout: float = DEFAULT_TIMEOUT,
        max_frame: int = MAX_FRAME,
        on_event: Callable[[str], None] = ignore,
    ) -> None:
        check_limits(timeout, max_frame)
        parse_address(address)
        self._peers, self._topics = _names(peers, "peer"), _names(topics, "topic")
        self._address, self._timeout, self._max_frame = address, timeout, max_frame
        self._context = make_context(credentials, ssl.PROTOCOL_TLS_SERVER)
        self._teller = Teller(harmless(on_event), _AGAIN)
        self._parking = Parking(timeout + _GRACE)
        self._process = os.getpid()
        self._closing = threading.Event()
        self._absent, self._where = "", list[str]()
        self._reception: Reception[TopicCaller] | None = None
        self._thread = threading.Thread(target=self._run, name=f"port {address}", daemon=True)
        with contextlib.ExitStack() as opened:
            self._wake, self._awake = map(opened.enter_context, socket.socketpair())
            self._listener = self._listen()
            if self._listener is not None:
                self._where = addresses_of(opened.enter_context(self._listener))
            self._thread.start()
            opened.pop_all()

    def __repr__(self) -> str:
        return f"<port at {' and '.join(self.addresses) or f'{self._address}, not listening'}>"

    def __enter__(self) -> Port:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def addresses(self) -> list[str]:
        """Where it listens, as ``host:port``; empty while the address cannot be listened on."""
        return list(self._where)

    def take(self, peer: str, topic: str, wait: float, stop: threading.Event | None = None) -> Channel:
        """Wait for a peer's call and take it. The newest counts; one whose caller hung up does not.

        Args:
            peer: Who is to call.
            topic: About what.
            wait: Seconds to wait; 0 takes a call that is there already.
            stop: Ends the wait when it is set, within a fraction of a second.

        Raises:
            ValueError: if the port was not opened for this peer and topic.
            ChannelTimeout: if nobody called, or the wait was stopped.
            ChannelClosed: if the port is closed.
            ChannelError: in a fork of the process that opened the port.
        """
        self._require(peer, topic)
        if not wait >= 0:
            raise ValueError(f"wait must be a number of seconds, 0 or more, not {wait!r}")
        stream = self._parking.take(peer, topic, time.monotonic() + wait, stop)
        if stream is not None:
            stream.keep_alive(self._timeout)
            return SocketChannel(stream, self._timeout, self._max_frame)
        if stop is not None and stop.is_set():
            raise ChannelTimeout(f"the wait for a call of {peer!r} about {topic!r} was stopped")
        why = self._absent or "is it started, and does it know where to call?"
        raise ChannelTimeout(f"{peer!r} did not call about {topic!r} within {in_seconds(wait)}: {why}")

    def is_called(self, peer: str, topic: str) -> bool:
        """Whether a call waits to be taken. A peer that calls again has lost the channel that it had.

        Raises:
            ValueError: if the port was not opened for this peer and topic.
            ChannelError: in a fork of the process that opened the port.
        """
        self._require(peer, topic)
        return self._parking.has(peer, topic)

    def close(self) -> None:
        """Stop listening and hang up on every call that nobody took; safe to call twice, from any thread.

        The thread ends within a second. Where it is looking up the name of its address it ends when the
        resolver has answered (LOOK_UP_SECONDS at most), and listens no more.
        """
        if self._is_a_copy:
            for descriptor in (self._listener, self._wake, self._awake, self._reception):
                if descriptor is not None:
                    descriptor.close()
            self._parking.forsake()
            return
        self._closing.set()
        self._parking.end("this port is closed")
        with contextlib.suppress(OSError):
            self._wake.send(b"\0")
        if threading.current_thread() is not self._thread:
            self._thread.join(_END_SECONDS)

    @property
    def _is_a_copy(self) -> bool:
        return os.getpid() != self._process

    def _require(self, peer: str, topic: str) -> None:
        if peer not in self._peers or topic not in self._topics:
            raise ValueError(f"this port takes no calls of {peer!r} about {topic!r}")
        if self._is_a_copy:
            raise ChannelError("this port belongs to the process that opened it: open one after the fork")

    def _run(self) -> None:
        with self._wake, self._awake:
            while not self._closing.is_set():
                try:
                    self._serve()
                except Exception as error:  # no memory, say; and the robots still need a port
                    self._teller.tell(f"the port at {self._address} begins again after an error: {error!r}")
                    self._closing.wait(_REST)
                finally:
                    self._listener, self._where = None, []

    def _serve(self) -> None:
        """Listen, and put down the calls that come, until the port is closed."""
        while self._listener is None:
            if self._closing.wait(_REST):
                return
            try:
                self._listener = self._listen()
            except ChannelError as error:  # what is not allowed now may be allowed later
                self._teller.tell(str(error), "; trying again")
        with self._listener as listener:
            most = MAX_HANDSHAKES + len(self._peers) * len(self._topics)
            self._reception = Reception(listener, self._admit, self._teller, self._timeout, self._awake, most)
            with contextlib.closing(self._reception) as reception:
                self._where, self._absent = addresses_of(listener), ""
                whom = ", ".join(map(repr, self._peers))
                self._teller.tell(f"listening on {' and '.join(self._where)} for {whom}")
                while not self._closing.is_set():
                    caller = reception.next_peer(self._parking.drop_late())
                    if caller is not None:
                        self._parking.park(caller.name, caller.topic, caller.stream)

    def _listen(self) -> Listener | None:
        try:
            return open_listener(self._address)
        except ChannelError as error:
            self._absent = str(error)
            if not isinstance(error, NotYet):
                raise
            self._teller.tell(error.told("cannot listen"), "; trying again")
            return None

    def _admit(self, sock: socket.socket) -> TopicCaller:
        return TopicCaller(TlsStream(sock, self._context, server_side=True), self._peers, self._topics)


def _names(names: Collection[str], what: str) -> tuple[str, ...]:
    """A port's peers or topics, each once.

    Raises:
        ValueError: if there are none, or one is malformed.
    """
    if isinstance(names, str) or not names:
        raise ValueError(f"a port needs a collection of at least one {what}, not {names!r}")
    for name in names:
        topic_bytes(name)  # robots' names are shorter still
    return tuple(dict.fromkeys(names))
