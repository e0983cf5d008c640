"""Robots that are restarted, forked, or used by two threads in the middle of a matching."""

import os
from threading import Event, Thread
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import BATCHES, Link, all_batches, check_all, expected, mission, robots

from protocols import Matcher, batching
from spdz import (
    ChannelError,
    OutOfStep,
    PeerAborted,
    SpdzError,
    TapeInUse,
)

pytestmark = pytest.mark.usefixtures("quick_disk")


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
        return robots(folder, paths, Link([(1, 1500)]), work, wait=2.0), blocks


def test_a_robot_that_was_restarted_in_the_middle_of_a_batch_gets_all_of_it(tmp_path):
    """And the other one keeps what it had: each pair is handed over once."""
    (first, second), blocks = restarted_in_the_middle(tmp_path, BATCHES[1][0])
    assert first.complete and np.array_equal(first.decisions, expected(0, 0))
    assert second.complete and np.array_equal(second.decisions, expected(0, 1))
    seen = [(i, j) for block in blocks for i in block.rows for j in block.columns]
    assert len(seen) == len(set(seen)) == 12


def test_a_peer_cannot_take_back_what_was_decided(tmp_path):
    """Not by another number of descriptors, and not by other ones."""
    (first, second), _ = restarted_in_the_middle(tmp_path / "fewer", BATCHES[1][0][:2])
    assert isinstance(second, PeerAborted)  # told at once
    assert isinstance(first, OutOfStep) and "had 4 descriptors, and now it has 2" in str(first)
    assert 0 < first.partial.pairs < 12
    assert np.array_equal(
        first.partial.decisions[first.partial.decided], expected(0, 0)[first.partial.decided]
    )
    (first, _), _ = restarted_in_the_middle(tmp_path / "others", -BATCHES[1][0])
    assert np.array_equal(first.decisions[:2, :2], expected(0, 0)[:2, :2])  # the tile that had been decided


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
