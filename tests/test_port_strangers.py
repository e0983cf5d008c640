"""Whoever calls a port and is no peer, or no honest one: refused, in time, and nobody else notices."""

import errno
import os
import socket
import ssl
import time
from contextlib import ExitStack, suppress

import pytest
from channel_helpers import (
    CONTROL,
    DATA,
    LONG,
    SHORT,
    assert_alive,
    careless,
    careless_context,
    dial,
    greet,
    header,
    read_raw,
    send_raw,
    together,
)
from port_helpers import LIDAR, PAIRS, Background, by_hand, calling, connected, parked, until

from spdz.channels import FrameKind, reception
from spdz.channels.addresses import parse_address
from spdz.channels.reception import MAX_HANDSHAKES
from spdz.channels.topic import MAX_TOPIC
from spdz.foundations.errors import ChannelClosed, ChannelError, ChannelTimeout, PeerAborted

HALF_A_HELLO = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(100)


def client_hello():
    """The first bytes of a client that means it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    with suppress(ssl.SSLWantReadError):
        context.wrap_bio(incoming, outgoing).do_handshake()
    return outgoing.read()


def assert_still_open(folders, port):
    """Both robots of the mission get through."""
    for robot in ("bob", "carol"):
        here, there = connected(folders, port, robot)
        with here, there:
            assert_alive(here, there)


def heard(sock):
    """What comes until the other side ends the connection; b"" if it is reset."""
    sock.settimeout(LONG)
    with suppress(ConnectionResetError):
        return b"".join(iter(lambda: sock.recv(1 << 16), b""))
    return b""


# --- who is refused


@pytest.mark.parametrize("rubbish", [b"GET / HTTP/1.1\r\n\r\n", b"spdz caller 1\n", bytes(1000)])
def test_a_plain_caller_is_refused(folders, open_port, rubbish):
    told = []
    port = open_port(on_event=told.append)
    with dial(port.addresses[0]) as sock:
        sock.sendall(rubbish)
        heard(sock)
    assert_still_open(folders, port)
    assert len(told) == 2 and told[1].startswith("refused a caller: the TLS handshake failed: ")


def test_a_robot_of_another_mission_and_this_one_refuse_each_other(folders, open_port):
    told = []
    port = open_port(on_event=told.append)
    with pytest.raises(ChannelError, match=r"certificate.*same run of the dealer"):
        calling(folders, port, "other-bob")()
    with pytest.raises(ChannelClosed, match="same run of the dealer") as caught:
        greet(careless(careless_context(folders, "other-bob"), port.addresses[0]))
    assert not caught.value.passing
    assert_still_open(folders, port)
    assert [text.endswith("credentials of another dealer run?") for text in told] == [False, True, True]


def test_a_robot_that_is_no_peer_is_refused_and_told_so(folders, open_port):
    told = []
    port = open_port(peers=["bob"], on_event=told.append)
    with pytest.raises(PeerAborted, match="expects another robot") as caught:
        calling(folders, port, "carol")()
    assert not caught.value.passing
    until(lambda: len(told) == 2)
    assert told[1] == "refused a caller: expected the robot 'bob', but the certificate there is of 'carol'"


def test_a_port_names_all_the_robots_that_it_expects(folders, open_port):
    told = []
    port = open_port(peers=["carol", "dave"], on_event=told.append)
    with pytest.raises(PeerAborted):
        calling(folders, port)()
    until(lambda: len(told) == 2)
    assert told[0].endswith(" for 'carol', 'dave'")
    assert "one of the robots 'carol', 'dave', but the certificate there is of 'bob'" in told[1]


def test_a_caller_without_a_certificate_is_refused(folders, open_port):
    port = open_port()
    with pytest.raises(ChannelClosed):
        greet(careless(careless_context(folders), port.addresses[0]))
    assert_still_open(folders, port)


@pytest.mark.parametrize(
    "frames",
    [
        header(5, kind=DATA) + b"lidar",
        header(5, kind=CONTROL, round_=1) + b"lidar",
        header(5, kind=CONTROL, session=1) + b"lidar",
        header(MAX_TOPIC + 1, kind=CONTROL),
        header((1 << 32) - 1, kind=CONTROL),
        header(1, kind=FrameKind.ABORT) + b"\x08",
        header(1, kind=FrameKind.ABORT) + b"\xff",
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
def test_a_peer_that_names_no_topic_is_refused_in_the_same_words(folders, open_port, frames):
    told = []
    port = open_port(on_event=told.append)
    with by_hand(folders, port, frames) as peer:
        with pytest.raises(PeerAborted, match="no honest peer sends"):
            peer.exchange(CONTROL, [b""], None)
    assert_still_open(folders, port)
    assert told[1:] == ["refused a caller: 'bob' did not send the frame that names a topic"]


def test_a_peer_that_hangs_up_before_it_names_a_topic_is_told_of(folders, open_port):
    told = []
    port = open_port(on_event=told.append)
    by_hand(folders, port, LIDAR[:10]).close()
    until(lambda: len(told) == 2)
    assert told[1] == "refused a caller: 'bob' named no topic: it hung up"


def test_a_topic_in_pieces_is_read(folders, open_port):
    port = open_port()
    with by_hand(folders, port, b"") as peer:
        for byte in LIDAR:
            send_raw(peer, bytes([byte]))
        until(lambda: parked(port))


# --- who stalls


@pytest.mark.parametrize("start", [b"", HALF_A_HELLO, client_hello()], ids=["silence", "half", "hello"])
def test_a_caller_that_stalls_is_dropped_in_time(folders, open_port, start):
    told = []
    port = open_port(timeout=SHORT, on_event=told.append)
    with dial(port.addresses[0]) as sock:
        sock.sendall(start)
        heard(sock)
    until(lambda: len(told) == 2)
    assert told[1:] == ["refused a caller: it was not through within 0.25 s"]


def test_a_caller_that_sends_a_byte_now_and_then_is_dropped_as_soon(open_port):
    told = []
    port = open_port(timeout=SHORT, on_event=told.append)
    with dial(port.addresses[0]) as sock, suppress(OSError):
        for byte in HALF_A_HELLO:
            sock.sendall(bytes([byte]))
            time.sleep(SHORT / 20)
    until(lambda: len(told) == 2)
    assert told[1:] == ["refused a caller: it was not through within 0.25 s"]


def test_a_peer_that_stalls_before_its_topic_is_dropped_in_time(folders, open_port):
    told = []
    port = open_port(timeout=SHORT, on_event=told.append)
    with by_hand(folders, port, LIDAR[:-1]) as peer:
        assert read_raw(peer)  # told, and hung up
    until(lambda: len(told) == 2)
    assert told[1:] == ["refused a caller: it was not through within 0.25 s"]


def test_stalling_callers_keep_nobody_waiting(folders, open_port):
    port = open_port()
    with ExitStack() as stack:
        for start in (b"", HALF_A_HELLO, client_hello(), b"GET"):
            stack.enter_context(dial(port.addresses[0])).sendall(start)
        stack.enter_context(by_hand(folders, port, LIDAR[:-1]))
        assert_still_open(folders, port)


# --- who comes in numbers


def test_five_hundred_callers_keep_nobody_out_and_cost_no_more_than_a_few(folders, open_port):
    port = open_port()
    before = len(os.listdir("/dev/fd"))
    most = []
    with ExitStack() as stack:

        def flood():
            for _ in range(500):
                stack.enter_context(dial(port.addresses[0]))
                most.append(len(port._reception._visits))

        crowd = Background(flood)
        for _ in range(3):
            assert_still_open(folders, port)
        assert crowd.wait() is None
        assert MAX_HANDSHAKES < max(most) <= MAX_HANDSHAKES + len(PAIRS)
        under_way = MAX_HANDSHAKES + len(PAIRS) + 1  # one is taken before another is dropped
        assert len(os.listdir("/dev/fd")) <= before + 500 + under_way
        assert_still_open(folders, port)


def test_a_crowd_from_one_address_does_not_push_out_a_caller_from_another(folders, open_port):
    port = open_port("0.0.0.0:0")
    where = ("127.0.0.1", parse_address(port.addresses[0])[1])
    with ExitStack() as stack:
        slow = stack.enter_context(socket.socket())
        try:
            slow.bind(("127.0.0.2", 0))
        except OSError:
            pytest.skip("this machine has one loopback address only")
        slow.connect(where)
        until(lambda: len(port._reception._visits) == 1)
        crowd = [stack.enter_context(socket.create_connection(where)) for _ in range(2 * MAX_HANDSHAKES)]
        assert heard(crowd[0]) == b""
        slow.sendall(client_hello())
        slow.settimeout(LONG)
        assert slow.recv(5)[:1] == b"\x16"  # it is answered still


def test_a_peer_that_calls_without_end_has_one_call_waiting(folders, open_port):
    port = open_port()
    with ExitStack() as stack:
        calls = [stack.enter_context(by_hand(folders, port, LIDAR)) for _ in range(20)]
        until(lambda: parked(port))
        for call in calls[:-1]:
            with pytest.raises(PeerAborted, match="a newer call"):
                call.exchange(CONTROL, [b""], None)
        assert len(parked(port)) == 1
    with pytest.raises(ChannelTimeout):
        port.take("bob", "lidar", 0)
    assert_still_open(folders, port)


def test_strangers_cannot_fill_the_log(open_port):
    told = []
    port = open_port(on_event=told.append)
    for k in range(40):
        with dial(port.addresses[0]) as sock:
            sock.sendall((b"GET / HTTP/1.1\r\n\r\n", bytes(100))[k % 2])
            heard(sock)
    assert len(told) <= 4


# --- no room


def test_a_port_without_free_descriptors_rests_and_goes_on(folders, open_port, monkeypatch):
    tries, told, full = [], [], [True]
    real = reception.accept_one

    def accept_one(door):
        tries.append(door)
        if full:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return real(door)

    monkeypatch.setattr(reception, "accept_one", accept_one)
    port = open_port(on_event=told.append)
    start = time.monotonic()
    ends = Background(lambda: connected(folders, port))
    until(lambda: len(tries) >= 3)
    assert len(tries) <= (time.monotonic() - start) / reception.RETRY_SECONDS + 2
    full.clear()
    here, there = ends.wait()
    with here, there:
        assert_alive(here, there)
    assert told[1:] == [
        "a connection could not be taken (Too many open files); close files or raise `ulimit -n`"
    ]


def test_callers_are_told_apart(folders, open_port):
    """No name but the certificate's counts, whatever the topic says."""
    port = open_port(topics=["lidar", "carol"])
    here, there = connected(folders, port, topic="carol")
    with here, there:
        assert together(lambda: port.take("carol", "carol", 0))[0].passing
