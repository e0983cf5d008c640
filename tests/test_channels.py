"""One conformance suite that memory, TCP and TLS channels have to pass: exchanges."""

import threading
import time
from unittest.mock import Mock

import numpy as np
import pytest
from channel_helpers import (
    CHECK,
    CONTROL,
    DATA,
    SHORT,
    assert_dead,
    both,
    header,
    send_raw,
    together,
)

from spdz.channels import DType, FrameKind, memory_pair
from spdz.channels.frames import MAX_CONTROL, MAX_FRAME
from spdz.foundations.errors import ChannelClosed, ChannelTimeout

# --- what an exchange does


@pytest.mark.parametrize("size", [0, 1, 7, 64 << 10, 32 << 20])
def test_both_sides_receive_what_the_other_sent(pair, size):
    a, b = pair()
    rng = np.random.default_rng(size)
    there, back = rng.bytes(size), rng.bytes(size)
    got = together(lambda: a.exchange(DATA, [there], size), lambda: b.exchange(DATA, [back], size))
    assert [bytes(payload) for payload in got] == [back, there]


def test_lengths_may_differ_between_directions(pair):
    a, b = pair()
    big = bytes(5_000_000)
    got = together(lambda: a.exchange(DATA, [big], 0), lambda: b.exchange(DATA, [], len(big)))
    assert [len(payload) for payload in got] == [0, len(big)]


def test_rounds_arrive_in_order(pair):
    a, b = pair()

    def play(channel, sign):
        return [
            int(np.frombuffer(channel.exchange(DATA, [np.int64(sign * i)], 8), np.int64)[0])
            for i in range(200)
        ]

    got = together(lambda: play(a, 1), lambda: play(b, -1))
    assert got == [[-i for i in range(200)], list(range(200))]


def test_buffers_of_any_kind_and_size_are_concatenated(pair):
    a, b = pair()
    rng = np.random.default_rng(5)
    matrix = rng.integers(0, 2**63, (40, 500), dtype=np.uint64)
    buffers = [
        b"x",
        bytearray(b""),
        np.zeros((3, 0)),
        matrix,
        memoryview(b"yz"),
        rng.bytes(70_000),
        *[rng.bytes(31)] * 5000,
    ]
    expected = b"".join(bytes(buffer) for buffer in buffers)
    got, _ = together(
        lambda: a.exchange(DATA, [], len(expected)), lambda: b.exchange(DATA, buffers, 0, DType.BYTES)
    )
    assert bytes(got) == expected


def test_the_payload_is_writable_aligned_and_the_callers_own(pair):
    a, b = pair()
    first, _ = both(a, b, DATA, [b"first---"], 8)
    words = np.frombuffer(first, np.uint64)
    assert not first.readonly
    assert words.flags.aligned
    second, _ = both(a, b, DATA, [b"second--"], 8)
    second[:] = b"changed-"
    assert bytes(first) == b"first---"


def test_a_control_message_may_have_any_length_up_to_the_cap(pair):
    a, b = pair()
    long = bytes(MAX_CONTROL)
    got = together(lambda: a.exchange(CONTROL, [b"{}"], None), lambda: b.exchange(CONTROL, [long], None))
    assert [bytes(message) for message in got] == [long, b"{}"]
    assert [bytes(message) for message in both(a, b, CONTROL, [], None)] == [b"", b""]


def test_counters_count_frames_with_headers_and_control_rounds_apart(pair):
    a, b = pair()
    together(lambda: a.exchange(CONTROL, [b"abc"], None), lambda: b.exchange(CONTROL, [b"defgh"], None))
    both(a, b, DATA, [bytes(100)], 100)
    both(a, b, CHECK, [bytes(32)], 32)
    assert (a.rounds, a.control_rounds) == (b.rounds, b.control_rounds) == (2, 1)
    assert a.bytes_sent == b.bytes_received == 3 * 16 + 3 + 100 + 32
    assert b.bytes_sent == a.bytes_received == 3 * 16 + 5 + 100 + 32


def test_frames_of_a_bound_session_are_exchanged(pair):
    a, b = pair()
    both(a, b, CONTROL, [b"hello"], None)
    a.bind(0xDEADBEEF)
    b.bind(0xDEADBEEF)
    assert [bytes(got) for got in both(a, b, DATA, [b"12"], 2)] == [b"12", b"12"]


# --- requests that are wrong before anything is sent


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((FrameKind.ABORT, [], 0), "only DATA, CHECK and CONTROL"),
        ((DATA, [], None), "must be known"),
        ((DATA, [], -1), "negative"),
        ((DATA, [], 1001), "above this channel's limit"),
        ((DATA, [bytes(1001)], 0), "above this channel's limit"),
        ((DATA, [np.zeros((4, 4)).T[1:]], 0), "as bytes"),
        ((DATA, [np.array([None])], 0), "Python objects"),
    ],
)
def test_a_wrong_request_is_refused_and_the_channel_lives(pair, arguments, message):
    a, b = pair(max_frame=1000)
    with pytest.raises(ValueError, match=message):
        a.exchange(*arguments)
    assert [bytes(got) for got in both(a, b, DATA, [bytes(1000)], 1000)] == [bytes(1000)] * 2


def test_a_control_message_above_its_cap_is_not_sent():
    a, _ = memory_pair()
    with pytest.raises(ValueError, match="limit of 65536"):
        a.exchange(CONTROL, [bytes(MAX_CONTROL + 1)], None)


@pytest.mark.parametrize(
    "options", [{"timeout": 0}, {"timeout": float("inf")}, {"max_frame": 0}, {"max_frame": MAX_FRAME + 1}]
)
def test_limits_out_of_range_are_refused(options):
    with pytest.raises(ValueError, match="must be"):
        memory_pair(**options)


@pytest.mark.parametrize("tag", [-1, 1 << 32])
def test_a_session_tag_has_32_bits(tag):
    with pytest.raises(ValueError, match="32 bits"):
        memory_pair()[0].bind(tag)


# --- peers that do not answer


@pytest.mark.parametrize("size", [10, 16 << 20], ids=["small", "more than the socket buffers"])
def test_a_silent_peer_is_a_timeout(pair, size):
    a, _ = pair(SHORT)
    with pytest.raises(ChannelTimeout, match=r"within 0\.25 s \(0 of 26 bytes"):
        a.exchange(DATA, [bytes(size)], 10)
    assert_dead(a)


def test_a_byte_now_and_then_does_not_extend_the_deadline(pair):
    a, b = pair(SHORT)
    done = threading.Event()

    def trickle():
        for byte in header(24) + bytes(24):
            if done.wait(0.025):
                return
            send_raw(b, bytes([byte]))

    def receive():
        try:
            return a.exchange(DATA, [], 24)
        finally:
            done.set()

    received, _ = together(receive, trickle)
    assert isinstance(received, ChannelTimeout)


@pytest.mark.parametrize("sent", [b"", header(8)[:5], header(8), header(8) + b"1234567"])
def test_a_peer_that_hangs_up_in_a_frame_is_told_as_closed(pair, sent):
    a, b = pair()
    send_raw(b, sent)
    b.close()
    with pytest.raises(ChannelClosed, match=f"{len(sent)} of 24 bytes|broke"):
        a.exchange(DATA, [bytes(8)], 8)
    assert_dead(a)


def test_a_peer_that_hangs_up_while_it_is_sent_to_is_told_as_closed(pair):
    a, b = pair()
    send_raw(b, header(8)[:4])
    results = together(lambda: a.exchange(DATA, [bytes(16 << 20)], 8), lambda: (time.sleep(0.05), b.close()))
    assert isinstance(results[0], ChannelClosed)


# --- dead channels


def test_a_closed_channel_refuses_and_closing_again_does_nothing(pair):
    a, b = pair()
    with a:
        pass
    a.close()
    assert_dead(a)
    with pytest.raises(ChannelClosed):
        b.exchange(DATA, [b"1"], 1)


def test_an_error_behind_the_send_kills_the_channel(pair, monkeypatch):
    """The frame may be out: a second one for the same round must not follow it."""
    a, _ = pair()
    with monkeypatch.context() as patch, pytest.raises(MemoryError):
        patch.setattr("spdz.channels.base.FrameReader", Mock(side_effect=MemoryError))
        a.post(DATA, [b"1"], 1)
    with pytest.raises(ChannelClosed, match="interrupted"):
        a.post(DATA, [b"1"], 1)


@pytest.mark.parametrize("size", [1, 100_000])
def test_a_frame_that_is_taken_too_late_does_not_count(pair, size):
    a, b = pair(timeout=0.2)
    for end in (a, b):
        end.post(DATA, [bytes(size)], size)
    time.sleep(0.3)
    with pytest.raises(ChannelTimeout):
        a.take()


def test_an_interrupted_exchange_kills_the_channel(pair, monkeypatch):
    a, _ = pair()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(a, "_finish", interrupted)
        a.exchange(DATA, [b"1"], 1)
    with pytest.raises(ChannelClosed, match="interrupted"):
        a.exchange(DATA, [b"1"], 1)
