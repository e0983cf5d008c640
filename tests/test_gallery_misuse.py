"""Galleries that run out of slots, whose peer stops, that are used by several threads, or misused."""

from threading import Event
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import Link, unit
from stream_helpers import (
    NONE,
    STREAMS,
    check_stream,
    deal,
    decided,
    fresh,
    in_thread,
    maps,
    robot,
    robots,
    stream,
)

from spdz import (
    ChannelError,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
    TapeExhausted,
    TapeInUse,
    TapeMismatch,
)
from spdz.session import filling

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def test_what_is_added_while_a_step_tells_what_it_brings_waits_for_the_next(mission):
    """Else one side would go on alone."""
    received = filling.Filling._received

    def work(one, party):
        steps = []
        one.add(STREAMS[party][0])

        def receive(own, *rest):
            if own.party == 0 and not steps:
                in_thread(lambda: one.add(STREAMS[0][2])).join()
            return received(own, *rest)

        if party == 0:
            with patch.object(filling.Filling, "_received", receive):
                steps.append(one.step())
        else:
            steps.append(one.step())
        return [*steps, one.step()]

    results = robots(mission, Link(), work)
    assert [step.own for step in results[0]] == [[0, 1], [2, 3, 4]]
    assert [step.peer for step in results[1]] == [[0, 1], [2, 3, 4]]


def test_descriptors_of_another_thread_come_each_once_however_the_steps_fall(dealt, tmp_path):
    mission = deal(tmp_path / "large", (40, 2))
    new = unit(70, 36)

    def work(one, party):
        if party:
            one.add(unit(71, 2))
        done = Event()

        def bring():
            for vector in new:
                one.add(vector[None])
            done.set()

        adding = in_thread(bring) if party == 0 else None
        steps = []
        for _ in range(8):
            steps.append(one.step())
        if adding is not None:
            adding.join()
        return [*steps, one.step(), one._session.plain(one.filled)]

    *steps, held = robots(mission, Link(), work)[0]
    assert np.array_equal(held, np.rint(new * 65536))
    assert [slot for step in steps for slot in step.own] == list(range(36))


def test_a_gallery_lives_on_when_there_are_not_slots_enough(mission):
    def work(one, party):
        one.add(STREAMS[party][0])
        steps = [one.step()]
        if party == 0:
            assert one.room == 6
            one.add(unit(60, 7))
            assert one.room == 0
            with pytest.raises(TapeExhausted, match="8 slots for alice: 6 are free and 7 are needed"):
                one.step()
            assert one.room == 6
            one.add(unit(60, 6))
        steps.append(one.step())
        assert one.room == (0 if party == 0 else 5)
        return steps

    first, second = robots(mission, Link(), work)
    assert (first[1].own, second[1].peer) == (list(range(2, 8)), list(range(2, 8)))


def test_descriptors_that_have_lost_their_slots_and_find_no_others_are_forgotten(mission):
    def work(one, party):
        one.connect()
        if party == 0:
            one._waiting += [np.zeros(4, dtype=np.int64)] * 9  # as taken back from slots half prepared
            with pytest.raises(TapeExhausted):
                one.step()
        return one.step()

    for step in robots(mission, Link(), work):
        assert not isinstance(step, Exception), step
        assert step.own == step.peer == []


def test_a_robot_whose_peer_has_finished_is_told(mission):
    def work(one, party):
        steps = []
        for new in STREAMS[party][: 5 if party == 0 else 2]:
            one.add(new)
            steps.append(one.step())
        return steps

    first, second = robots(mission, Link(timeout=2.0), work, wait=1.0)
    assert isinstance(first, (ChannelError, OutOfStep)) and len(second) == 2
    assert first.partial.blocks == []


@pytest.mark.parametrize("reopened", [False, True])
def test_a_step_with_nothing_on_both_sides_is_legal(mission, reopened):
    def work(one, party):
        if reopened:
            one.step()
            one.close()
        return one.step()

    for step in robots(mission, Link(), work):
        assert (step.own, step.peer, step.blocks) == ([], [], [])


def test_results_of_earlier_runs_are_read_after_reopening(mission):
    check_stream(robots(mission, Link(), stream))

    def look(one, party):
        stored = [look_at(one) for look_at in (contents, lambda one: one.connect(), contents)]
        assert repr(stored[0]) == repr(stored[2])
        assert not one.unfinished and one.filled == list(range(len(maps()[party])))
        assert one.holds(maps()[party]) == len(maps()[party])
        return list(one.results())

    def contents(one):
        return one.filled, one.room, one.unfinished, list(one.results())

    for party, blocks in enumerate(robots(mission, Link(), look)):
        decided(blocks, party)


def test_holds_counts_the_first_descriptors_and_refuses_others(mission):
    def work(one, party):
        one.connect()
        own = maps()[party]
        assert one.holds(own) == one.holds(NONE) == 0
        one.add(own[:2])
        assert one.holds(own) == 2  # they wait
        one.step()
        one.add(own[2:3])
        assert one.holds(own) == one.holds(own[:3]) == 3
        for other in (own[:2], own[::-1], -own, NONE):
            with pytest.raises(ValueError, match="holds 3 descriptors already"):
                one.holds(other)
        with pytest.raises(ValueError, match="shape"):
            one.holds(own[0])
        return one.step()

    for step in robots(mission, Link(), work):
        assert not isinstance(step, Exception), step


def test_two_galleries_on_one_tape_are_refused(mission):
    def work(one, party):
        one.connect()
        with pytest.raises(TapeInUse):
            robot(mission, party)
        return one.step()

    for step in robots(mission, Link(), work):
        assert not isinstance(step, Exception), step


def test_a_second_thread_is_told_and_changes_nothing(mission):
    inside, told = Event(), Event()

    def work(one, party):
        def intrude():
            assert inside.wait(10)
            for call in (one.step, one.connect, one.finish):
                with pytest.raises(TapeInUse, match="another thread"):
                    call()
            told.set()

        if party == 0:
            one._number = 0  # else there is nothing to finish
            one._on_block = lambda block: (inside.set(), told.wait(10))
            in_thread(intrude)
        results = stream(one, party)
        assert party or told.is_set()
        return results

    check_stream(robots(mission, Link(timeout=20.0), work))


def test_robots_at_steps_far_apart_are_told_both_numbers(mission):
    def work(one, party):
        one._number = 7 * party
        return one.step()

    results = robots(mission, Link(), work, wait=1.0)
    assert "at step 0 and the peer at 7" in str(results[0]) + str(results[1])
    assert all(isinstance(result, SpdzError) for result in results)
    assert any(isinstance(result, OutOfStep) for result in results)


@pytest.mark.parametrize("number", ["1", -1, 1.0, True, [0]])
def test_a_number_of_steps_that_is_none_is_refused(mission, number):
    def work(one, party):
        if party:
            one._number = number
        return one.step()

    first, _ = robots(mission, Link(), work, wait=1.0)
    assert isinstance(first, ProtocolViolation)


def test_another_threshold_is_refused_at_once_and_later(mission):
    def work(one, party):
        return one.step()

    def other(one, party):
        if party:
            one._terms = one._purpose.terms(0.5, one.header.security)
        return one.step()

    for error in robots(mission, Link(), other, wait=1.0):
        assert isinstance(error, (TapeMismatch, PeerAborted))
    check_stream(robots(mission, Link(), stream))
    for error in robots(mission, Link(), work, threshold=0.5, wait=1.0):
        assert isinstance(error, (TapeMismatch, PeerAborted))
    for step in robots(mission, Link(), work):
        assert not isinstance(step, Exception), step
