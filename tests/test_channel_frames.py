"""Peers that send something else than the one frame that may come next."""

import tracemalloc

import pytest
from channel_helpers import CHECK, CONTROL, DATA, assert_dead, both, header, send_raw
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.channels import DType, FrameKind
from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import MAX_CONTROL, merge_small, pack_header
from spdz.foundations.errors import ProtocolViolation, SpdzError


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"version": 2}, "frame version: expected 1, the peer sent 2"),
        ({"version": 22}, "speak TLS"),
        ({"reserved": 1}, "reserved byte: expected 0"),
        ({"kind": CHECK}, "frame kind: expected DATA, the peer sent CHECK"),
        ({"kind": CONTROL}, "expects a DATA frame, the peer sent CONTROL"),
        ({"kind": 77}, "unknown code 77"),
        ({"session": 7}, "session tag: expected 00000000, the peer sent 00000007"),
        ({"round_": 1}, "round: expected 0, the peer sent 1"),
        ({"dtype": DType.FIELD}, "payload dtype: expected BYTES, the peer sent FIELD"),
        ({"length": 7}, "payload length: expected 8 bytes, the peer sent 7"),
        ({"length": 9}, "payload length: expected 8 bytes, the peer sent 9"),
        ({"length": 2**32 - 1}, "the peer sent 4294967295"),
        ({"kind": FrameKind.ABORT, "length": 2}, "ABORT frame: expected 1"),
    ],
)
def test_any_other_header_is_a_violation(pair, wrong, message):
    a, b = pair()
    send_raw(b, header(**{"length": 8} | wrong))  # the payload never comes: the header alone decides
    with pytest.raises(ProtocolViolation, match=message):
        a.exchange(DATA, [bytes(8)], 8)
    assert_dead(a)


def test_parties_of_different_sessions_refuse_each_other(pair):
    a, b = pair()
    a.bind(1)
    b.bind(2)
    errors = both(a, b, DATA, [b"1"], 1)
    assert all(isinstance(error, ProtocolViolation) for error in errors)


@pytest.mark.parametrize("length", [MAX_CONTROL + 1, 2**32 - 1])
def test_a_claimed_length_is_refused_before_memory_is_taken(pair, length):
    a, b = pair()
    send_raw(b, header(length, kind=CONTROL))
    tracemalloc.start()
    try:
        with pytest.raises(ProtocolViolation, match="at most 65536 bytes"):
            a.exchange(CONTROL, [b"{}"], None)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_garbage_is_a_violation_and_is_not_echoed(pair):
    a, b = pair()
    send_raw(b, b"GET / HTTP/1.1\r\nHost: secret\r\n\r\n")
    with pytest.raises(ProtocolViolation) as caught:
        a.exchange(DATA, [bytes(8)], 8)
    assert "secret" not in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.binary(max_size=44).map(lambda rest: header(9, kind=2) + rest), st.data())
def test_a_reader_completes_the_expected_frame_and_no_other(stream, data):
    reader = FrameReader(pack_header(CHECK, DType.BYTES, 0, 0, 9), 9, MAX_CONTROL)
    position = 0
    try:
        while position < len(stream) and not reader.complete:
            size = data.draw(st.integers(1, min(len(reader.space), len(stream) - position)))
            reader.space[:size] = stream[position : position + size]
            position += size
            reader.advance(size)
    except SpdzError:
        assert stream[:16] != header(9, kind=2)
        return
    assert reader.complete == (stream[:16] == header(9, kind=2) and len(stream) >= 25)
    if reader.complete:
        assert bytes(reader.payload()) == stream[16:25]


@given(st.lists(st.sampled_from([0, 1, 50_000, 65_536, 65_537]), max_size=12))
def test_merging_buffers_keeps_their_bytes(sizes):
    buffers = [bytes([i]) * size for i, size in enumerate(sizes)]
    assert b"".join(merge_small(buffers)) == b"".join(buffers)
