"""Peers that lie, stop, stay behind or run out of jobs in the middle of a matching."""

import tracemalloc
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import BATCHES, DIM, Link, all_batches, expected, mission, robots, unit

from protocols import batching
from protocols.batch import Batch
from protocols.catalog import Purpose
from protocols.position import Offer, Position, meeting
from spdz import (
    ChannelClosed,
    ChannelError,
    ChannelTimeout,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
    TapeExhausted,
)
from spdz.channels import FrameKind
from spdz.tape import Tape

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.mark.parametrize("finishing", [False, True])
def test_a_peer_that_stays_behind_without_a_tile_to_do_holds_nobody(tmp_path, finishing):
    paths, notes = mission(tmp_path / "m", 400), []

    def work(one, party):
        if party == 0:
            one.match([])
            return one.finish() if finishing else one.match(BATCHES[0][0])
        one.match([])
        while True:
            offer = {"token": "t", "descriptors": 0, "met": "", "done": 0}
            notes.append(one._session.exchange_note({"number": 0, "current": offer, "previous": None}))

    honest, _ = robots(tmp_path, paths, Link(timeout=2.0), work, wait=1.0)
    assert len(notes) <= 2
    assert (
        honest is None if finishing else (isinstance(honest, OutOfStep) and "stays at batch 0" in str(honest))
    )


def test_a_peer_without_a_further_batch_is_told_apart_from_a_lost_one(tmp_path):
    paths = mission(tmp_path / "m", 400)
    events = []

    def work(one, party):
        one._on_event = events.append
        return [one.match(batch) for batch in BATCHES[party][: 1 + party]]

    first, second = robots(tmp_path, paths, Link(), work)
    assert len(first) == 1 and first[0].complete
    assert isinstance(second, OutOfStep) and "alice has ended after 1 batches" in str(second)
    assert any("bob has a batch 1" in event for event in events)


def test_too_few_jobs_are_told_on_both_sides_with_what_was_decided(tmp_path):
    paths = mission(tmp_path / "m", 16)  # four tiles: batch 0 takes all of them

    for error in robots(tmp_path, paths, Link(), all_batches):
        assert isinstance(error, TapeExhausted) and "need 3 jobs" in str(error)
        assert error.partial.batch == 2 and error.partial.pairs == 0


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_a_cheat_in_a_later_run_leaves_what_was_checked_before(tmp_path, security):
    paths = mission(tmp_path / "m", 400, security=security)
    link = Link()
    link_call = link._call

    def call():
        end = link_call()
        post, count = end.post, [0]

        def cheat(kind, payload, expect, *rest):
            count[0] += kind == FrameKind.DATA
            if kind == FrameKind.DATA and count[0] == 5:  # the second run's opening
                payload = [bytes([payload[0][0] ^ 1]) + bytes(payload[0][1:]), *payload[1:]]
            post(kind, payload, expect, *rest)

        end.post = cheat
        return end

    link._call = call
    with patch.object(batching, "MOST_JOBS", 1):
        honest, _ = robots(tmp_path, paths, link, all_batches, wait=1.0)
    if security == "malicious":
        assert isinstance(honest, MacCheckFailed)
        assert honest.partial.pairs == 4
        assert np.array_equal(honest.partial.decisions[:2, :2], expected(0, 0)[:2, :2])


@pytest.mark.parametrize(
    "note",
    [
        {},
        {"descriptors": 3},
        {"number": -1, "current": None, "previous": None},
        {"number": True, "current": None, "previous": None},
        {"number": 0, "current": 5, "previous": None},
        {"number": 0, "current": {"token": "a", "descriptors": 3, "met": "", "done": -1}, "previous": None},
        {"number": 0, "current": {"token": 1, "descriptors": 3, "met": "", "done": 0}, "previous": None},
        {
            "number": 0,
            "current": {"token": "a" * 99, "descriptors": 3, "met": "", "done": 0},
            "previous": None,
        },
        {
            "number": 0,
            "current": {"token": "a", "descriptors": 1 << 40, "met": "", "done": 0},
            "previous": None,
        },
        {"number": 0, "current": {"token": "a", "descriptors": 3, "met": ""}, "previous": None},
    ],
)
def test_a_peer_that_lies_about_its_position_is_stopped(tmp_path, note):
    paths = mission(tmp_path / "m", 40)

    def work(one, party):
        if party == 0:
            return one.match(BATCHES[0][0])
        one.connect()
        return one._session.exchange_note(note)

    honest, _ = robots(tmp_path, paths, Link(timeout=2.0), work, wait=1.0)
    assert isinstance(honest, ProtocolViolation)
    with Tape.open(paths[0], state_dir=tmp_path / "state-0") as tape:
        assert tape.cursor == 0


def test_a_peer_that_claims_a_far_position_gains_nothing(tmp_path):
    """``done`` counts only where both sides have met the same two batches, and never beyond one's own."""
    own = Offer("mine", 3, "theirs", 2)
    assert meeting(Position(0, own, None), Position(0, Offer("theirs", 4, "mine", 99), None), "bob")[2] == 2
    for liar in (Offer("theirs", 4, "other", 99), Offer("other", 4, "mine", 99)):
        assert meeting(Position(0, own, None), Position(0, liar, None), "bob")[2] == 0


def test_a_peer_that_claims_millions_of_descriptors_makes_nobody_allocate_for_them(tmp_path):
    paths = mission(tmp_path / "m", 40)
    batch = Batch(0, unit(1, 1000), Purpose("S10", DIM, tile=(1, 1)), 0)
    tracemalloc.start()
    with pytest.raises(TapeExhausted, match="1000 x 16777216 descriptors need"):
        batch.meet("theirs", 1 << 24, 0, 1 << 20)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert batch.met == "" and batch.tiles == 0

    def work(one, party):
        if party == 0:
            return one.match(BATCHES[0][0])
        one.connect()
        offer = {"token": "a", "descriptors": 1 << 24, "met": "", "done": 0}
        return one._session.exchange_note({"number": 0, "current": offer, "previous": None})

    honest, _ = robots(tmp_path, paths, Link(timeout=2.0), work, wait=1.0)
    assert isinstance(honest, TapeExhausted)


def test_a_peer_that_stopped_for_good_is_not_waited_for(tmp_path):
    """Its abort says that a try again would not help: no second connection."""
    paths = mission(tmp_path / "m", 40)
    link = Link()

    def work(one, party):
        if party == 0:
            return one.match(BATCHES[0][0])
        one.connect()
        one._session._die(ProtocolViolation("this side saw something"))
        raise ProtocolViolation

    honest, _ = robots(tmp_path, paths, link, work, wait=30.0)
    assert isinstance(honest, PeerAborted) and not honest.passing
    assert len(link.ends) == 1


def test_a_peer_that_never_comes_ends_the_wait(tmp_path):
    paths = mission(tmp_path / "m", 40)
    link = Link()

    def work(one, party):
        return one.match(BATCHES[0][0]) if party == 0 else None

    honest, _ = robots(tmp_path, paths, link, work, wait=0.3)
    assert isinstance(honest, ChannelTimeout)
    assert honest.partial.pairs == 0


def test_errors_know_whether_another_try_may_help():
    assert ChannelTimeout("").passing and ChannelClosed("").passing
    assert not ChannelError("").passing and not PeerAborted("").passing


def test_an_empty_batch_that_was_finished_does_not_come_back_with_descriptors(tmp_path):
    batch = Batch(0, unit(1, 4), Purpose("S10", DIM, tile=(1, 1)), 0)
    batch.meet("theirs", 0, 0, 100)
    assert list(batch.run(FakeSession(), None, 1)) == []
    with pytest.raises(OutOfStep, match="had 0 descriptors, and now it has 3"):
        batch.meet("others", 3, 0, 100)


class FakeSession:
    """Enough of a session for a batch without tiles."""

    shapes = ((1, 1, DIM), (1, 1, DIM))


def test_what_was_given_up_is_not_run_when_the_end_is_told(tmp_path):
    paths, blocks = mission(tmp_path / "m", 400), []

    def work(one, party):
        one.match(BATCHES[party][2])
        if party == 0:
            one._on_block = lambda block: (blocks.append(block), 1 / 0)
            with pytest.raises(ZeroDivisionError):
                one.match(BATCHES[0][0])
            return None
        return one.match(BATCHES[1][0])

    with patch.object(batching, "MOST_JOBS", 1):
        first, second = robots(tmp_path, paths, Link(timeout=2.0), work, wait=2.0)
    assert first is None and len(blocks) == 1
    assert isinstance(second, SpdzError) and 0 < second.partial.pairs < 12
