"""Two channels that meet, peers that send bytes of their own choice, and what the tests of channels share."""

import select
import socket
import ssl
import struct
import threading
from contextlib import ExitStack
from queue import SimpleQueue

import pytest

from dealer.pki import MissionAuthority, write_credentials
from spdz.channels import FrameKind, MemoryChannel, SocketChannel, memory_pair, tcp, tls
from spdz.channels.addresses import parse_address
from spdz.channels.stream import PlainStream, complete
from spdz.channels.tls_stream import TlsStream
from spdz.foundations.errors import ChannelClosed

DATA, CHECK, CONTROL = FrameKind.DATA, FrameKind.CHECK, FrameKind.CONTROL
SHORT = 0.25
LONG = 20.0


def header(length, *, version=1, kind=1, dtype=0, reserved=0, session=0, round_=0):
    return struct.pack("<BBBBIII", version, kind, dtype, reserved, session, round_, length)


def together(*calls):
    """Run each call in a thread of its own; returns results, or the exceptions raised."""
    results = [None] * len(calls)

    def run(index):
        try:
            results[index] = calls[index]()
        except Exception as error:
            results[index] = error

    threads = [threading.Thread(target=run, args=(i,), daemon=True) for i in range(len(calls))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG + 10)
    assert not any(thread.is_alive() for thread in threads)
    return results


def meet(listen, connect, **options):
    """Run ``listen(address, ...)`` in a thread and ``connect(actual address, ...)`` in another."""
    found = SimpleQueue()
    return together(
        lambda: listen("127.0.0.1:0", on_listening=found.put, **options),
        lambda: connect(found.get(timeout=LONG), **options),
    )


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Credentials of three robots of one mission, and of an ``alice`` and a ``bob`` of another."""
    root = tmp_path_factory.mktemp("credentials")
    mission, other = MissionAuthority(), MissionAuthority()
    for authority, name, folder in (
        (mission, "alice", "alice"),
        (mission, "bob", "bob"),
        (mission, "carol", "carol"),
        (other, "alice", "other-alice"),
        (other, "bob", "other-bob"),
    ):
        write_credentials(root / folder, authority.credentials(name))
    return root


def ways(kind, folders):
    """How alice listens, and how bob connects to her: over ``tcp`` or ``tls``."""
    if kind == "tcp":
        return tcp.listen, tcp.connect
    return (
        lambda address, **rest: tls.listen(address, folders / "alice", "bob", **rest),
        lambda address, **rest: tls.connect(address, folders / "bob", "alice", **rest),
    )


def pair_without_threads(kind, folders):
    """Connected channels, made step by step: a fork may copy a lock that a thread holds while it ends."""
    ends = socket.socketpair()
    if kind == "tcp":
        return [SocketChannel(PlainStream(end), LONG) for end in ends]
    alice, bob = (
        TlsStream(end, tls.make_context(folders / name, protocol), server_side=name == "alice")
        for end, name, protocol in zip(
            ends, ("alice", "bob"), (ssl.PROTOCOL_TLS_SERVER, ssl.PROTOCOL_TLS_CLIENT), strict=True
        )
    )
    while alice.handshake() | bob.handshake():
        pass
    return [SocketChannel(alice, LONG), SocketChannel(bob, LONG)]


@pytest.fixture(params=["memory", "tcp", "tls"])
def pair(request, folders):
    """A factory of connected channels; closes them all. ``timeout`` is for exchanges, not for meeting."""
    with ExitStack() as stack:

        def make(timeout=LONG, **options):
            options |= {"timeout": LONG}
            if request.param == "memory":
                channels = memory_pair(**options)
            else:
                channels = meet(*ways(request.param, folders), **options)
            for channel in channels:
                stack.enter_context(channel)._timeout = timeout
            return channels

        yield make


def send_raw(channel, data):
    """Send bytes of one's own choice through a channel."""
    if isinstance(channel, MemoryChannel):
        channel._outgoing.put(bytes(data))
        return
    stream, rest = channel._stream, memoryview(bytes(data))
    while rest or stream.backlog:
        rest = rest[stream.send(rest) :] if rest else rest
        if rest or not stream.flush():
            assert select.select([], [stream], [], LONG)[1]


def send_on_the_wire(channel, data):
    """Send bytes of one's own choice through a channel's socket, under TLS."""
    channel._stream._socket.settimeout(LONG)
    channel._stream._socket.sendall(data)


def read_raw(channel):
    """Everything that comes through a TCP channel until it is closed."""
    channel._stream._socket.settimeout(LONG)
    return b"".join(iter(lambda: channel._stream._socket.recv(1 << 20), b""))


def both(first, second, *args):
    return together(lambda: first.exchange(*args), lambda: second.exchange(*args))


def assert_alive(first, second):
    assert [bytes(got) for got in both(first, second, DATA, [b"ok"], 2)] == [b"ok", b"ok"]


def assert_dead(channel):
    with pytest.raises(ChannelClosed):
        channel.exchange(DATA, [b"1"], 1)


def greet(channel):
    with channel:
        channel.exchange(CONTROL, [b"{}"], None)


def dial(address):
    """A connected socket and nothing more."""
    return socket.create_connection(parse_address(address), LONG)


def free_address():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"127.0.0.1:{listener.getsockname()[1]}"


def careless_context(folders, folder=None, newest=ssl.TLSVersion.TLSv1_3):
    """What an intruder might use: it believes alice's authority and shows any certificate, or none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.maximum_version = newest
    context.load_verify_locations(folders / "alice" / "ca.pem")
    if folder is not None:
        context.load_cert_chain(folders / folder / "cert.pem", folders / folder / "key.pem")
    return context


def careless(context, address):
    """A channel to whoever listens there, made with a context of one's own."""
    stream = TlsStream(dial(address), context, server_side=False)
    try:
        complete(stream, stream.handshake, LONG, "the handshake")
    except OSError:
        stream.close()
        raise
    return SocketChannel(stream, LONG)
