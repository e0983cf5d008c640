"""A side that stops tells the other why, whatever either of them was doing."""

import threading

import pytest
from channel_helpers import (
    CONTROL,
    DATA,
    LONG,
    SHORT,
    assert_dead,
    header,
    meet,
    read_raw,
    send_raw,
    together,
)

from spdz.channels import AbortReason, FrameKind, tcp
from spdz.foundations.errors import ChannelTimeout, PeerAborted, ProtocolViolation


@pytest.mark.parametrize("reason", list(AbortReason))
def test_an_abort_tells_the_peer_why(pair, reason):
    a, b = pair()
    error, _ = together(lambda: a.exchange(DATA, [bytes(8)], 8), lambda: b.abort(reason))
    assert isinstance(error, PeerAborted)
    assert str(error).startswith("the peer stopped because ")
    assert_dead(a)


@pytest.mark.parametrize(("kind", "expect"), [(DATA, 0), (CONTROL, None), (DATA, 16 << 20)])
def test_an_abort_is_seen_whatever_was_expected(pair, kind, expect):
    a, b = pair()
    error, _ = together(
        lambda: a.exchange(kind, [bytes(expect or 5)], expect), lambda: b.abort(AbortReason.MAC_CHECK_FAILED)
    )
    with pytest.raises(PeerAborted, match="MAC check failed"):
        raise error


def test_an_abort_after_a_frame_leaves_the_frame_whole(pair):
    a, b = pair()

    def last_words():
        b.exchange(DATA, [b"last"], 4)
        b.abort(AbortReason.STOPPED)

    def hear():
        first = bytes(a.exchange(DATA, [b"here"], 4))
        with pytest.raises(PeerAborted):
            a.exchange(DATA, [b"more"], 4)
        a.close()
        return first

    assert together(hear, last_words) == [b"last", None]


def test_a_side_that_was_sent_garbage_can_still_say_so(pair):
    a, b = pair()
    send_raw(b, bytes(100))
    with pytest.raises(ProtocolViolation):
        a.exchange(DATA, [bytes(8)], 8)
    a_done, _ = together(
        lambda: a.abort(AbortReason.PROTOCOL_VIOLATION), lambda: assert_hears(b, header(8) + bytes(8))
    )
    assert a_done is None


def assert_hears(channel, sent_before):
    reader = channel.exchange(DATA, [], len(sent_before) - 16)
    assert bytes(reader) == sent_before[16:]
    with pytest.raises(PeerAborted, match="no honest peer"):
        channel.exchange(DATA, [], 1)


def test_an_unknown_abort_reason_is_a_violation(pair):
    a, b = pair()
    send_raw(b, header(1, kind=FrameKind.ABORT) + b"\xff")
    with pytest.raises(ProtocolViolation, match="abort reason: expected 1 to 11, the peer sent 255"):
        a.exchange(DATA, [], 100)


def test_an_abort_is_heard_in_another_round_and_session(pair):
    a, b = pair()
    send_raw(b, header(1, kind=FrameKind.ABORT, session=9, round_=99) + bytes([AbortReason.STOPPED]))
    with pytest.raises(PeerAborted):
        a.exchange(DATA, [], 1)


def test_aborting_never_raises(pair):
    a, b = pair()
    b.close()
    a.abort(AbortReason.STOPPED)
    a.abort(AbortReason.STOPPED)
    b.abort(AbortReason.STOPPED)
    assert_dead(a)
    assert_dead(b)


def test_no_abort_is_put_into_the_middle_of_a_frame():
    a, b = meet(tcp.listen, tcp.connect, timeout=SHORT)
    with a, b:
        with pytest.raises(ChannelTimeout):
            a.exchange(DATA, [bytes(16 << 20)], 1)  # b does not read: most of the frame stays here
        _, came = together(lambda: a.abort(AbortReason.TIMEOUT), lambda: read_raw(b))
    assert 16 < len(came) < 16 << 20
    assert not any(came[16:])


def test_an_abort_is_not_overtaken_by_a_reset():
    a, b = meet(tcp.listen, tcp.connect, timeout=LONG)
    aborted = threading.Event()

    def abort():
        a.abort(AbortReason.STOPPED)
        aborted.set()

    def hear():
        send_raw(b, bytes(100_000))  # unread bytes would make a reset of the end
        came = read_raw(b)
        assert not aborted.wait(SHORT)  # it reads on until b hangs up
        b.close()
        return came

    with a, b:
        _, came = together(abort, hear)
        assert aborted.is_set()
    assert came == header(1, kind=FrameKind.ABORT) + bytes([AbortReason.STOPPED])
