"""Calling a peer's port, again and again, until it takes the call.

In TLS 1.3 the port judges this side's certificate after this side is done with the handshake. So a refusal
comes in the place of the answer, like every other reason not to take the call.
"""

from __future__ import annotations

import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path

from spdz.channels.addresses import NotYet, patiently
from spdz.channels.frames import MAX_FRAME
from spdz.channels.socket_channel import SocketChannel
from spdz.channels.tcp import DEFAULT_WAIT
from spdz.channels.telling import Teller, ignore, in_seconds
from spdz.channels.times import DEFAULT_TIMEOUT, check_limits
from spdz.channels.tls import make_context, reach
from spdz.channels.topic import be_taken, topic_bytes
from spdz.foundations.errors import ChannelClosed, ChannelError, ChannelTimeout

_LEAST_SECONDS = 1.0
"""What a call is given to be taken in, however little is left of its wait."""


def dial(
    address: str,
    credentials: Path,
    peer: str,
    topic: str,
    *,
    wait: float = DEFAULT_WAIT,
    timeout: float = DEFAULT_TIMEOUT,
    max_frame: int = MAX_FRAME,
    on_event: Callable[[str], None] = ignore,
    stop: threading.Event | None = None,
) -> SocketChannel:
    """Call a peer's port about a topic, and wait until the call is taken.

    Args:
        address: Where the peer's port listens, ``host:port``.
        credentials: Folder of this robot's credentials.
        peer: Name of the only robot to talk to.
        topic: What to talk about.
        wait: Seconds to keep calling: while the host name, the network or the port is not there, and while
            the peer does not take the call.
        timeout: Seconds that the TLS handshake, one call that is not taken, and then one exchange, may take.
        max_frame: Largest payload in bytes.
        on_event: Called with a sentence when the reason changes why there is no connection yet.
        stop: Ends the wait when it is set: within a fraction of a second where the peer is there, else after
            the attempt to connect that is under way.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        PeerAborted: if the port does not accept this robot, does not know the topic, or has a newer call of
            this robot about it.
        ChannelError: if whoever listens there is not the peer; both names are told.
        ChannelTimeout: if nobody answered, or the peer did not take the call.
        ProtocolViolation: if the peer sent anything but the topic.
    """
    check_limits(timeout, max_frame)
    topic_bytes(topic)
    context = make_context(credentials, ssl.PROTOCOL_TLS_CLIENT)
    teller, deadline = Teller(on_event), time.monotonic() + wait
    what = f"{peer!r} does not take this robot's call about {topic!r}"

    def attempt() -> SocketChannel:
        left = max(0.0, deadline - time.monotonic())
        stream = reach(address, context, peer, left, timeout, teller, stop)
        try:
            patience = min(timeout, max(_LEAST_SECONDS, deadline - time.monotonic()))
            be_taken(stream, topic, patience, stop)
            stream.keep_alive(timeout)
        except BaseException as error:
            stream.part(b"")
            if isinstance(error, ChannelTimeout):
                raise NotYet("it is there; is it busy, or started without this gallery?", what) from error
            if isinstance(error, ChannelClosed) and error.passing:
                raise NotYet(str(error), what) from error
            raise
        return SocketChannel(stream, timeout, max_frame)

    def give_up(last: NotYet) -> ChannelError:
        ended = stop is not None and stop.is_set()
        return ChannelTimeout(
            f"{last} ({'stopped' if ended else f'called for {in_seconds(wait)}'}, at {address})"
        )

    return patiently(attempt, deadline, give_up, teller, what, stop)
