"""Batch after batch with one peer: lost connections, restarts, and peers that say strange things."""

import os
import tracemalloc
from contextlib import ExitStack
from threading import Event, Thread
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import DIM, Link, mission, robots, unit

from protocols import Matcher, batching, matcher
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
    TapeInUse,
)
from spdz.channels import FrameKind
from spdz.tape import Tape

CUTS = int(os.environ.get("SPDZ_DROPS", "40"))
"""Drops tried a direction; a session has some 3,000 bytes a direction, and so many of them try every byte."""

BATCHES = (
    [unit(k, n) for k, n in enumerate((3, 0, 2, 1))],
    [unit(10 + k, n) for k, n in enumerate((4, 2, 5, 2))],
)


def expected(k, party):
    rows = [np.rint(side[k] * 65536).astype(object) for side in BATCHES]
    table = (rows[0] @ rows[1].T >= 0.2 * 2**32).astype(bool)
    return table.T if party else table


def all_batches(one, party):
    return [one.match(batch) for batch in BATCHES[party]]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """One mission for all drops: what a drop costs is burnt, the rest is left for the next one."""
    folder = tmp_path_factory.mktemp("world")
    return folder, mission(folder / "m", 120 * max(CUTS, 60))


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch):
    monkeypatch.setattr("spdz.tape.durable.os.fsync", lambda descriptor: None)


def check_all(results):
    for party, result in enumerate(results):
        assert not isinstance(result, Exception), result
        for k, matches in enumerate(result):
            assert matches.batch == k and matches.complete
            assert np.array_equal(matches.decisions, expected(k, party)), (party, k)


def test_batches_of_any_size_meet_their_own_number(world):
    folder, paths = world
    link = Link()
    check_all(robots(folder, paths, link, all_batches))
    assert len(link.ends) == 1


def whole_session(world):
    folder, paths = world
    link = Link()
    robots(folder, paths, link, all_batches)
    return link.sent[0]


@pytest.mark.parametrize("sender", [0, 1])
def test_a_drop_at_any_byte_of_a_session_loses_and_mixes_nothing(world, sender):
    folder, paths = world
    total = whole_session(world)[sender]
    for limit in sorted({1 + k * total // CUTS for k in range(CUTS)}):
        link = Link([(sender, limit)])
        check_all(robots(folder, paths, link, all_batches))
        assert len(link.ends) >= 2 or limit > total - 300, limit  # else the farewell alone was lost


def test_drop_after_drop_is_survived(world):
    folder, paths = world
    link = Link([(k % 2, 900 + 137 * k) for k in range(9)])
    check_all(robots(folder, paths, link, all_batches))
    assert len(link.ends) >= 10


def last_frame(world, party):
    """Bytes that a party has sent when only the last frame of its first batch is missing."""
    folder, paths = world
    marks = []

    def work(one, who):
        one.match(BATCHES[who][0])
        if who == party:
            marks.append(one._session._channel.bytes_sent)
        return [one.match(batch) for batch in BATCHES[who][1:]]

    robots(folder, paths, Link(), work)
    return marks[0]


@pytest.mark.parametrize("sender", [0, 1])
def test_a_side_that_missed_the_last_frame_gets_it_from_a_peer_that_went_on(world, sender):
    folder, paths = world
    end = last_frame(world, sender)
    for limit in (end - 40, end - 32, end - 17, end - 1):
        blocks = ([], [])

        def work(one, party):
            one._on_block = blocks[party].append  # noqa: B023
            return all_batches(one, party)

        check_all(robots(folder, paths, Link([(sender, limit)]), work))
        for party in (0, 1):  # each pair once, whatever was run again
            seen = [(b.batch, i, j) for b in blocks[party] for i in b.rows for j in b.columns]
            assert len(seen) == len(set(seen)) == 12 + 0 + 10 + 2


def test_what_was_decided_is_kept_when_the_peer_is_gone_for_good(tmp_path):
    paths = mission(tmp_path / "m", 400)
    link = Link([(1, 2100)], timeout=1.0)
    reach, put = [], link.calls.put
    link.calls.put = lambda end: None if reach else reach.append(put(end))  # later calls reach nobody

    with patch.object(batching, "MOST_JOBS", 1):
        errors = robots(tmp_path, paths, link, all_batches, wait=0.5)
    for party, error in enumerate(errors):
        assert isinstance(error, ChannelError)
        partial = error.partial
        assert partial.decisions.shape == expected(0, party).shape
        assert 0 < partial.pairs < 12 and not partial.complete
        assert np.array_equal(partial.decisions[partial.decided], expected(0, party)[partial.decided])


def test_a_broken_off_batch_can_be_resumed(tmp_path):
    paths = mission(tmp_path / "m", 400)

    def work(one, party):
        try:
            matches = one.match(BATCHES[party][0])
        except ChannelError:
            before = one.partial.pairs
            link.cuts.clear()
            matches = one.resume()
            assert before < matches.pairs == 12
        with pytest.raises(ValueError, match="no batch was broken off"):
            one.resume()
        return [matches, *(one.match(batch) for batch in BATCHES[party][1:])]

    link = Link([(0, 1800 + k) for k in range(200)], timeout=2.0)
    with patch.object(batching, "MOST_JOBS", 1):
        check_all(robots(tmp_path, paths, link, work, wait=1.0))


def test_a_robot_that_was_restarted_in_a_batch_compares_it_anew(tmp_path):
    paths = mission(tmp_path / "m", 400)

    def work(one, party):
        if party == 0:
            return all_batches(one, party)
        one.match(BATCHES[1][0])
        one.close()  # killed, and started again with other descriptors for the same batch
        again = Matcher(paths[1], 0.2, connect="127.0.0.1:1", state_dir=tmp_path / "state-1", first=1)
        results = [again.match(batch) for batch in BATCHES[1][1:]]
        again.finish()
        again.close()
        one._previous = None
        return results

    first, second = robots(tmp_path, paths, Link(), work)
    for k, (mine, theirs) in enumerate(zip(first[1:], second, strict=True), start=1):
        assert np.array_equal(mine.decisions, expected(k, 0)) and np.array_equal(
            theirs.decisions, expected(k, 1)
        )


def restarted_in_the_middle(folder, own):
    """Bob is killed in the middle of batch 0 and started again with these descriptors; what both get."""
    paths, blocks = mission(folder / "m", 400), []

    def work(one, party):
        if party == 0:
            one._on_block = blocks.append
            return one.match(BATCHES[0][0])
        one._wait = 1e-3
        with pytest.raises(ChannelError):
            one.match(BATCHES[1][0])
        assert 0 < one.partial.pairs < 12
        with Matcher(paths[1], 0.2, connect="127.0.0.1:1", state_dir=folder / "state-1") as again:
            return again.match(own)

    with patch.object(batching, "MOST_JOBS", 1):
        return robots(folder, paths, Link([(1, 2100)]), work, wait=2.0), blocks


def test_a_robot_that_was_restarted_in_the_middle_of_a_batch_gets_all_of_it(tmp_path):
    """And the other one keeps what it had: each pair is handed over once."""
    (first, second), blocks = restarted_in_the_middle(tmp_path, BATCHES[1][0])
    assert first.complete and np.array_equal(first.decisions, expected(0, 0))
    assert second.complete and np.array_equal(second.decisions, expected(0, 1))
    seen = [(i, j) for block in blocks for i in block.rows for j in block.columns]
    assert len(seen) == len(set(seen)) == 12


def test_a_peer_cannot_take_back_what_was_decided(tmp_path):
    """Not by another number of descriptors, and not by other ones."""
    (first, _), _ = restarted_in_the_middle(tmp_path / "fewer", BATCHES[1][0][:0])
    assert isinstance(first, OutOfStep) and "had 4 descriptors, and now it has 0" in str(first)
    assert 0 < first.partial.pairs < 12
    assert np.array_equal(
        first.partial.decisions[first.partial.decided], expected(0, 0)[first.partial.decided]
    )
    (first, _), _ = restarted_in_the_middle(tmp_path / "others", -BATCHES[1][0])
    assert np.array_equal(first.decisions[:2, :2], expected(0, 0)[:2, :2])  # the tile that had been decided


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


def test_a_robot_that_was_restarted_may_go_on_where_its_peer_is(tmp_path):
    paths = mission(tmp_path / "m", 400)

    def work(one, party):
        if party == 0:
            return all_batches(one, party)
        results = [one.match(batch) for batch in BATCHES[1][:2]]
        one.close()
        with Matcher(
            paths[1], 0.2, connect="127.0.0.1:1", state_dir=tmp_path / "state-1", first=None
        ) as again:
            assert again.number is None
            results += [again.match(batch) for batch in BATCHES[1][2:]]
            one._previous = None
        return results

    check_all(robots(tmp_path, paths, Link(), work))


def test_robots_that_both_go_on_where_the_other_is_begin_at_0(tmp_path):
    check_all(robots(tmp_path, mission(tmp_path / "m", 400), Link(), all_batches, first=None))


def test_a_second_thread_is_told_and_changes_nothing(tmp_path):
    paths, inside, told = mission(tmp_path / "m", 400), Event(), Event()

    def work(one, party):
        def intrude():
            assert inside.wait(10)
            calls = (lambda: one.match(BATCHES[0][2]), one.resume, one.connect, one.finish)
            for call in calls:
                with pytest.raises(TapeInUse, match="another thread"):
                    call()
            told.set()

        if party == 0:
            one._on_block = lambda block: (inside.set(), told.wait(10))
            other = Thread(target=intrude)
            other.start()
        results = all_batches(one, party)
        assert party or told.is_set()
        return results

    check_all(robots(tmp_path, paths, Link(timeout=20.0), work))


def test_a_fork_that_lives_on_does_not_keep_the_tape_from_a_new_connection(tmp_path):
    paths, children = mission(tmp_path / "m", 400), []

    def work(one, party):
        results = [one.match(BATCHES[party][0])]
        if party == 0:
            reader, writer = os.pipe()
            if (child := os.fork()) == 0:
                os.read(reader, 1)
                os._exit(0)
            children.append((child, writer))
            one._session._channel.close()  # the line breaks while the child lives
        return [*results, *(one.match(batch) for batch in BATCHES[party][1:])]

    results = robots(tmp_path, paths, Link(timeout=5.0), work)
    for child, writer in children:
        os.write(writer, b"x")
        os.waitpid(child, 0)
    check_all(results)


class Clock:
    """Time that passes while somebody sleeps, and only then."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def test_the_wait_begins_again_whenever_something_went_on(tmp_path):
    """The pauses after all drops are longer than the time to wait, each of them shorter."""
    paths = mission(tmp_path / "m", 200, tile=(1, 1))
    link = Link([(k % 2, 1900) for k in range(12)])
    clock = Clock()
    patches = [(batching, "MOST_JOBS", 1), (matcher, "time", clock), (matcher, "_LONGEST_PAUSE", 20.0)]
    with ExitStack() as stack:
        for where, what, value in patches:
            stack.enter_context(patch.object(where, what, value))
        check_all(robots(tmp_path, paths, link, all_batches, wait=60.0, first_pause=20.0))
    assert clock.now > 120 and len(link.ends) > 3


def test_robots_at_batches_far_apart_are_told_both_numbers(tmp_path):
    paths = mission(tmp_path / "m", 400)

    def work(one, party):
        one._number = 7 * party
        return one.match(BATCHES[party][0])

    results = robots(tmp_path, paths, Link(), work, wait=1.0)
    assert isinstance(results[0], OutOfStep) and (results[0].here, results[0].there) == (0, 7)
    assert "this robot is at batch 0 and bob at batch 7" in str(results[0])
    assert isinstance(results[1], SpdzError)  # it has waited for the other one to come back at its number


def test_a_robot_waits_for_a_peer_that_was_restarted_at_another_batch(tmp_path):
    paths = mission(tmp_path / "m", 400)

    def work(one, party):
        if party == 0:
            return all_batches(one, party)
        results = [one.match(batch) for batch in BATCHES[1][:2]]
        one.close()
        where = {"connect": "127.0.0.1:1", "state_dir": tmp_path / "state-1"}
        with pytest.raises(OutOfStep) as told, Matcher(paths[1], 0.2, **where) as again:
            again.match(BATCHES[1][0])
        with Matcher(paths[1], 0.2, **where, first=told.value.there) as again:
            results += [again.match(batch) for batch in BATCHES[1][2:]]
        one._previous = None
        return results

    check_all(robots(tmp_path, paths, Link(), work, wait=10.0))


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
        exchange, count = end.exchange, [0]

        def cheat(kind, payload, expect, *rest):
            count[0] += kind == FrameKind.DATA
            if kind == FrameKind.DATA and count[0] == 5:  # the second run's opening
                payload = [bytes([payload[0][0] ^ 1]) + bytes(payload[0][1:]), *payload[1:]]
            return exchange(kind, payload, expect, *rest)

        end.exchange = cheat
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


def test_a_bad_batch_changes_nothing_and_the_next_call_may_mend_it(world):
    folder, paths = world

    def work(one, party):
        for bad in ([[np.nan] * DIM], [[9.0] * DIM], [[0.1] * (DIM + 1)], [0.1] * DIM):
            with pytest.raises(ValueError):
                one.match(bad)
        return all_batches(one, party)

    check_all(robots(folder, paths, Link(), work))


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


@pytest.mark.parametrize(
    "wrong",
    [{"wait": 0}, {"timeout": float("nan")}, {"first": -1}, {"connect": "127.0.0.1:1"}, {"listen": "x"}],
)
def test_bad_arguments_are_refused_at_once(world, wrong):
    folder, paths = world
    with pytest.raises(ValueError):
        Matcher(paths[0], 0.2, **{"listen": "127.0.0.1:1", "state_dir": folder / "state-0", **wrong})


def test_errors_know_whether_another_try_may_help():
    assert ChannelTimeout("").passing and ChannelClosed("").passing
    assert not ChannelError("").passing and not PeerAborted("").passing
