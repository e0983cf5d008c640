"""Waiting in silence: over memory, TCP and TLS, between two exchanges, and nothing of the next is lost."""

import os
import socket
import struct
import threading

import pytest
from channel_helpers import (
    CONTROL,
    DATA,
    LONG,
    SHORT,
    assert_alive,
    assert_dead,
    both,
    header,
    meet,
    send_on_the_wire,
    send_raw,
    together,
    ways,
)
from gallery_session_helpers import Product, cables
from test_key_updates import APPLICATION_DATA, DEMAND, UPDATE, against  # noqa: F401  # a fixture

from spdz.channels import memory_pair
from spdz.channels.frames import AbortReason
from spdz.channels.tls_stream import MAX_SILENT, READ_BYTES
from spdz.foundations.errors import ChannelClosed, ChannelError, PeerAborted, ProtocolViolation
from spdz.readings.gallery import Terms


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


# --- what ends the wait


def test_a_frame_of_the_peers_ends_the_wait_and_is_all_there_for_the_next_exchange(pair):
    a, b = pair()

    def listen():
        assert a.await_frame(LONG)
        return bytes(a.exchange(DATA, [b"hear"], 5))

    for _ in range(3):
        assert together(listen, lambda: bytes(b.exchange(DATA, [b"speak"], 4))) == [b"speak", b"hear"]


def test_looking_twice_takes_nothing(pair):
    a, b = pair()
    thread = threading.Thread(target=b.exchange, args=(CONTROL, [b"note"], None), daemon=True)
    thread.start()
    assert [a.await_frame(LONG), a.await_frame(0), a.await_frame(LONG)] == [True] * 3
    assert bytes(a.exchange(CONTROL, [b""], None)) == b"note"
    thread.join(LONG)


def test_a_frame_that_came_with_the_one_before_is_noticed(pair):
    a, b = pair()
    send_raw(b, header(2) + b"ok" + header(4, round_=1) + b"more")
    assert bytes(a.exchange(DATA, [], 2)) == b"ok"
    assert a.await_frame(0 if a.__class__.__name__ == "MemoryChannel" else LONG)
    assert bytes(a.exchange(DATA, [], 4)) == b"more"


@pytest.mark.parametrize("seconds", [0, SHORT])
def test_silence_ends_the_wait_when_the_time_is_over_and_the_channel_lives(pair, seconds):
    a, b = pair()
    assert not a.await_frame(seconds)
    assert not b.await_frame(seconds)
    assert_alive(a, b)


def test_a_descriptor_that_can_be_read_ends_the_wait(pair, pipe):
    a, b = pair()
    timer = threading.Timer(SHORT, os.write, (pipe[1], b"!"))
    timer.start()
    assert not a.await_frame(10 * LONG, pipe[0])
    assert not a.await_frame(10 * LONG, pipe[0])  # as long as nobody reads it
    timer.join()
    assert_alive(a, b)


def test_a_silent_descriptor_ends_nothing(pair, pipe):
    a, b = pair()
    assert not a.await_frame(SHORT, pipe[0])
    heard, _ = together(lambda: a.await_frame(LONG, pipe[0]), lambda: send_raw(b, header(0)))
    assert heard


def test_the_peer_is_heard_before_the_descriptor(pair, pipe):
    a, b = pair()
    os.write(pipe[1], b"!")
    send_raw(b, header(2) + b"ok")
    assert a.await_frame(LONG)
    assert a.await_frame(LONG, pipe[0])
    assert bytes(a.exchange(DATA, [], 2)) == b"ok"


# --- a peer that leaves


def test_a_peer_that_hangs_up_ends_the_wait_with_an_error(pair):
    a, b = pair()
    refusal, _ = together(lambda: a.await_frame(LONG), b.close)
    with pytest.raises(ChannelClosed, match="closed the connection"):
        raise refusal
    assert_dead(a)


def test_a_peer_that_hung_up_before_is_noticed_by_looking(pair):
    a, b = pair()
    b.close()
    with pytest.raises(ChannelClosed):
        while not a.await_frame(0):
            pass


def test_why_a_peer_stops_is_heard_and_told_by_the_next_exchange(pair):
    a, b = pair()
    heard, _ = together(lambda: a.await_frame(LONG), lambda: b.abort(AbortReason.STOPPED))
    assert heard
    with pytest.raises(PeerAborted):
        a.exchange(DATA, [], 0)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_connection_that_is_reset_is_an_error(folders, kind):
    a, b = meet(*ways(kind, folders), timeout=LONG)
    b._stream._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    refusal, _ = together(lambda: a.await_frame(LONG), b._stream._socket.close)
    with pytest.raises(ChannelError, match="between two frames"):
        raise refusal
    assert_dead(a)
    a.close()
    b._closed = True


def test_a_closed_channel_waits_for_nobody(pair):
    a, _ = pair()
    a.close()
    with pytest.raises(ChannelClosed, match="closed"):
        a.await_frame(LONG)


def test_a_fork_does_not_wait(pair):
    a, b = pair()
    a._process -= 1
    with pytest.raises(ChannelError, match="after the fork"):
        a.await_frame(0)
    a._process += 1
    assert_alive(a, b)


def test_a_wait_that_was_interrupted_ends_the_channel(pair, monkeypatch):
    a, _ = pair()

    def interrupt(deadline, wake):
        raise KeyboardInterrupt

    monkeypatch.setattr(a, "_await", interrupt)
    with pytest.raises(KeyboardInterrupt):
        a.await_frame(LONG)
    with pytest.raises(ChannelClosed, match="interrupted"):
        a.exchange(DATA, [], 0)


@pytest.mark.parametrize(
    "arguments", [(-1,), (float("nan"),), (float("inf"),), (1, -1), (1, 1 << 20), (1, "0"), (1, 1 << 70)]
)
def test_nonsense_is_refused_and_the_channel_lives(pair, arguments):
    a, b = pair()
    with pytest.raises(ValueError, match=r"seconds|descriptor"):
        a.await_frame(*arguments)
    assert_alive(a, b)


# --- TLS: what is no data of the peer's


@pytest.mark.parametrize("message", [UPDATE, DEMAND], ids=["update", "demand"])
def test_key_updates_are_not_the_peer(against, message):  # noqa: F811
    alice, bob, writer = against
    send_on_the_wire(bob, writer.key_updates(20, message))
    assert not alice.await_frame(SHORT)
    assert not alice._stream.backlog  # what they demand is answered meanwhile
    send_on_the_wire(bob, writer.key_updates(20, message))
    send_on_the_wire(bob, writer.record(APPLICATION_DATA, header(2) + b"ok"))
    assert alice.await_frame(LONG)
    assert bytes(alice.exchange(DATA, [b"ok"], 2)) == b"ok"


@pytest.mark.parametrize("message", [UPDATE, DEMAND], ids=["update", "demand"])
def test_key_updates_without_end_are_a_violation(against, message):  # noqa: F811
    alice, bob, writer = against
    flood = writer.key_updates(2 * (MAX_SILENT + READ_BYTES) // 27, message)
    refusal, _ = together(lambda: alice.await_frame(LONG), lambda: send_on_the_wire(bob, flood))
    with pytest.raises(ProtocolViolation, match="without data, such as key updates"):
        raise refusal
    assert_dead(alice)


def test_half_a_record_is_not_the_peer_yet(against):  # noqa: F811
    alice, bob, writer = against
    record = writer.record(APPLICATION_DATA, header(2) + b"ok")
    send_on_the_wire(bob, record[:-1])
    assert not alice.await_frame(SHORT)
    send_on_the_wire(bob, record[-1:])
    assert alice.await_frame(LONG)
    assert bytes(alice.exchange(DATA, [b"ok"], 2)) == b"ok"


def test_an_empty_record_is_not_the_peer(against):  # noqa: F811
    alice, bob, writer = against
    send_on_the_wire(bob, writer.record(APPLICATION_DATA, b""))
    assert not alice.await_frame(SHORT)
    send_on_the_wire(bob, writer.record(APPLICATION_DATA, header(2) + b"ok"))
    assert bytes(alice.exchange(DATA, [b"ok"], 2)) == b"ok"


# --- sessions


@pytest.mark.usefixtures("no_sync")
def test_a_session_hears_that_its_peer_begins(galleries):
    mission, looked = galleries(Terms(Product(), 4), (3, 4)), threading.Event()

    def idle(session):
        assert not session.await_peer(0)
        looked.set()
        with pytest.raises(ValueError):
            session.await_peer(-1)
        with pytest.raises(ValueError):
            session.await_peer(1, wake=1 << 20)
        assert session.exchange_note({}) == {}
        assert session.await_peer(LONG)
        return session.exchange_note({"heard": True})

    def speak(session):
        assert looked.wait(LONG)
        session.exchange_note({})
        return session.exchange_note({"said": True})

    assert mission.meet(idle, speak) == [{"said": True}, {"heard": True}]


@pytest.mark.usefixtures("no_sync")
def test_a_session_whose_peer_leaves_while_it_waits_has_ended(galleries):
    mission = galleries(Terms(Product(), 4), (3, 4))

    def idle(session):
        with pytest.raises(ChannelClosed):
            session.await_peer(LONG)
        with pytest.raises(ChannelClosed, match="has ended"):
            session.await_peer(0)

    assert mission.meet(idle, lambda session: None, channels=cables()) == [None, None]


def test_a_byte_that_was_waited_for_belongs_to_the_frame_that_it_begins():
    a, b = memory_pair(timeout=LONG)
    send_raw(b, header(4)[:1])
    assert a.await_frame(0)
    send_raw(b, header(4)[1:] + b"rest")
    assert bytes(a.exchange(DATA, [], 4)) == b"rest"
    assert both(a, b, DATA, [], 0)
