"""TLS 1.3 between exactly two robots, with the certificates that the dealer issued for the mission.

A robot's credentials folder holds ``cert.pem`` and ``key.pem`` (its own) and ``ca.pem`` (the mission's
certificate authority). Each side demands a certificate of that authority, and the one DNS name in it has to
be the robot that the tape names: a valid certificate of a third robot of the mission is refused.
"""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable, Collection
from pathlib import Path

from spdz.channels.addresses import NotYet
from spdz.channels.dialing import call
from spdz.channels.frames import MAX_FRAME, AbortReason, pack_abort
from spdz.channels.listening import open_listener
from spdz.channels.reception import Caller, receive
from spdz.channels.socket_channel import SocketChannel
from spdz.channels.stream import complete, describe, is_about_a_certificate
from spdz.channels.tcp import DEFAULT_WAIT
from spdz.channels.telling import Teller, ignore
from spdz.channels.times import DEFAULT_TIMEOUT, check_limits
from spdz.channels.tls_stream import TlsStream
from spdz.foundations.errors import ChannelError

CA_FILE = "ca.pem"
CERTIFICATE_FILE = "cert.pem"
KEY_FILE = "key.pem"

_ANOTHER_PROTOCOL = ("VERSION", "PROTOCOL", "HTTP")
"""In OpenSSL's reasons where the other side speaks something else. Others may come of a damaged line."""

_WRONG_ROBOT = pack_abort(AbortReason.WRONG_ROBOT, 0, 0)


def listen(
    address: str,
    credentials: Path,
    peer: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_listening: Callable[[str], None] = ignore,
    on_event: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Wait for one particular robot; all other callers are refused.

    Args:
        address: Where to listen, ``host:port``; port 0 takes any free port.
        credentials: Folder of this robot's credentials.
        peer: Name of the only robot to accept, as the dealer knows it.
        timeout: Seconds that one exchange may take.
        wait: Seconds to wait for the peer, and for the address if that cannot be listened on yet.
        max_frame: Largest payload in bytes.
        on_listening: Called with the actual address as soon as the peer can connect.
        on_event: Called with a sentence when this side listens, and when the reason changes why it does not
            yet, or why a caller was refused.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        ChannelError: if the address cannot be listened on, or everybody who called was refused.
        ChannelTimeout: if nobody called.
    """
    check_limits(timeout, max_frame)
    context = make_context(credentials, ssl.PROTOCOL_TLS_SERVER)
    stream = receive(
        lambda: open_listener(address),
        wait,
        on_listening,
        Teller(on_event),
        lambda sock: TlsCaller(TlsStream(sock, context, server_side=True), [peer]),
        repr(peer),
        "a TLS handshake",
    )
    return SocketChannel(stream, timeout, max_frame)


def connect(
    address: str,
    credentials: Path,
    peer: str,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    wait: float = DEFAULT_WAIT,
    max_frame: int = MAX_FRAME,
    on_event: Callable[[str], None] = ignore,
) -> SocketChannel:
    """Connect to one particular robot.

    In TLS 1.3 the listener judges this side's certificate after this side is done with the handshake: its
    refusal comes as the error of the first exchange.

    Args:
        address: Where the peer listens, ``host:port``.
        credentials: Folder of this robot's credentials.
        peer: Name of the only robot to talk to, as the dealer knows it.
        timeout: Seconds that the TLS handshake, and then one exchange, may take.
        wait: Seconds to keep trying, also while the host name or the network is not there yet, and where
            connections end, or stall for ``timeout``, before the TLS handshake has told anything.
        max_frame: Largest payload in bytes.
        on_event: Called with a sentence when the reason changes why there is no connection yet.

    Raises:
        ValueError: if an argument is malformed or the credentials cannot be used.
        ChannelError: if whoever listens there is not the peer; both names are told.
        ChannelTimeout: if nobody answered.
    """
    check_limits(timeout, max_frame)
    context = make_context(credentials, ssl.PROTOCOL_TLS_CLIENT)
    return SocketChannel(reach(address, context, peer, wait, timeout, Teller(on_event)), timeout, max_frame)


def reach(
    address: str,
    context: ssl.SSLContext,
    peer: str,
    wait: float,
    timeout: float,
    teller: Teller,
    stop: threading.Event | None = None,
) -> TlsStream:
    """The connection of :func:`connect`, as a stream; no further attempt begins once ``stop`` is set."""

    def establish(sock: socket.socket, seconds: float) -> TlsStream:
        stream = TlsStream(sock, context, server_side=False)
        try:
            _shake_hands(stream, seconds)
            require_name(stream, [peer])
        except BaseException:
            stream.part(_WRONG_ROBOT)  # TLS lets it out only if the handshake is done
            raise
        return stream

    return call(address, wait, timeout, teller, establish, stop)


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
    require_files(credentials)
    try:
        context.load_verify_locations(credentials / CA_FILE)
        context.load_cert_chain(credentials / CERTIFICATE_FILE, credentials / KEY_FILE, password="")
    except OSError as error:
        raise ValueError(
            f"the credentials in {credentials} cannot be used ({describe(error)}): copy the folder again, as "
            "a whole"
        ) from error
    return context


def require_files(credentials: Path) -> None:
    """Accept a folder that holds all of a robot's credentials.

    Raises:
        ValueError: naming a file that is missing.
    """
    for name in (CA_FILE, CERTIFICATE_FILE, KEY_FILE):
        if not (credentials / name).is_file():
            raise ValueError(f"{credentials / name} is missing: give the folder that the dealer wrote")


def require_name(stream: TlsStream, peers: Collection[str]) -> str:
    """Accept exactly one name in the other side's (already verified) certificate, one of the peers'.

    Returns:
        The name.

    Raises:
        ChannelError: if it is another robot's.
    """
    names = stream.certificate_names
    for peer in peers:
        if names == (("DNS", peer),):
            return peer
    found = ", ".join(str(entry[1]) for entry in names)
    whom = "the robot" if len(peers) == 1 else "one of the robots"
    expected = f"{whom} {', '.join(map(repr, peers))}"
    # repr() escapes what could move a terminal's cursor: the names come from the other side
    raise ChannelError(f"expected {expected}, but the certificate there is of {found[:80]!r}")


def _shake_hands(stream: TlsStream, timeout: float) -> None:
    try:
        complete(stream, stream.handshake, timeout, "the TLS handshake")
    except ssl.SSLError as error:
        another = any(word in (error.reason or "") for word in _ANOTHER_PROTOCOL)
        if not (another or is_about_a_certificate(error)):
            raise NotYet(f"the TLS handshake broke: {describe(error)}") from error
        raise ChannelError(
            f"the TLS handshake failed: {describe(error)}. Do both robots have credentials from the same run "
            "of the dealer, and does the other side speak TLS?"
        ) from error
    except OSError as error:
        raise NotYet(f"the connection ended before the TLS handshake did: {describe(error)}") from error


class TlsCaller(Caller):
    """A caller that has yet to prove by its certificate to be a peer.

    Args:
        stream: The connection, before the handshake.
        peers: Names of the robots to accept.

    Attributes:
        name: Which of them it is, once it has proved that.
    """

    farewell = _WRONG_ROBOT

    def __init__(self, stream: TlsStream, peers: Collection[str]) -> None:
        super().__init__(stream)
        self._tls = stream
        self._peers = peers
        self.name = ""

    def proceed(self) -> int:
        """Go on with the handshake; see :class:`Caller`."""
        try:
            events = self._tls.handshake()
        except OSError as error:
            hint = ": credentials of another dealer run?" if is_about_a_certificate(error) else ""
            raise ChannelError(f"the TLS handshake failed: {describe(error)}{hint}") from error
        if not events:
            self.name = require_name(self._tls, self._peers)
        return events
