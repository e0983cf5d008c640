"""Batch after batch with one peer, over connections that break at any byte."""

import os
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import BATCHES, DIM, Link, all_batches, check_all, expected, mission, robots

from protocols import Matcher, Matches, batching, reconnecting
from spdz import (
    ChannelError,
)
from spdz.foundations.stats import Stats

pytestmark = pytest.mark.usefixtures("quick_disk")


CUTS = int(os.environ.get("SPDZ_DROPS", "40"))
"""Drops tried a direction; a session has some 2,000 bytes a direction, and so many of them try every byte."""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """One mission for all drops: what a drop costs is burnt, the rest is left for the next one."""
    folder = tmp_path_factory.mktemp("world")
    return folder, mission(folder / "m", 120 * max(CUTS, 60))


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
    link = Link([(k % 2, 800 + 60 * k) for k in range(9)])
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
    link = Link([(1, 1500)], timeout=1.0)
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
    paths, broken = mission(tmp_path / "m", 400), []

    def work(one, party):
        try:
            matches = one.match(BATCHES[party][0])
        except ChannelError:
            before = one.partial.pairs
            broken.append(before)
            link.cuts.clear()
            matches = one.resume()
            assert before < matches.pairs == 12
        with pytest.raises(ValueError, match="no batch was broken off"):
            one.resume()
        return [matches, *(one.match(batch) for batch in BATCHES[party][1:])]

    link = Link([(0, 1500), *[(0, 600)] * 200], timeout=2.0)
    with patch.object(batching, "MOST_JOBS", 1):
        check_all(robots(tmp_path, paths, link, work, wait=1.0))
    assert broken and min(broken) > 0


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
    link = Link([(k % 2, 1700) for k in range(12)])
    clock = Clock()
    patches = [
        (batching, "MOST_JOBS", 1),
        (reconnecting, "time", clock),
        (reconnecting, "_LONGEST_PAUSE", 20.0),
    ]
    with ExitStack() as stack:
        for where, what, value in patches:
            stack.enter_context(patch.object(where, what, value))
        check_all(robots(tmp_path, paths, link, all_batches, wait=60.0, first_pause=20.0))
    assert clock.now > 120 and len(link.ends) > 3


def test_a_bad_batch_changes_nothing_and_the_next_call_may_mend_it(world):
    folder, paths = world

    def work(one, party):
        for bad in ([[np.nan] * DIM], [[9.0] * DIM], [[0.1] * (DIM + 1)], [0.1] * DIM):
            with pytest.raises(ValueError):
                one.match(bad)
        return all_batches(one, party)

    check_all(robots(folder, paths, Link(), work))


@pytest.mark.parametrize(
    "wrong",
    [{"wait": 0}, {"timeout": float("nan")}, {"first": -1}, {"connect": "127.0.0.1:1"}, {"listen": "x"}],
)
def test_bad_arguments_are_refused_at_once(world, wrong):
    folder, paths = world
    with pytest.raises(ValueError):
        Matcher(paths[0], 0.2, **{"listen": "127.0.0.1:1", "state_dir": folder / "state-0", **wrong})


def test_another_batch_in_place_of_one_that_was_broken_off_is_refused(tmp_path):
    """Else the peer would have the results of two batches in one table; the same descriptors go on."""
    paths = mission(tmp_path / "m", 400)
    link = Link([(0, 1900 + k) for k in range(200)], timeout=2.0)

    def work(one, party):
        own = BATCHES[party][0]
        try:
            matches = one.match(own)
        except ChannelError:
            with pytest.raises(ValueError, match=r"was broken off with \d+ pairs decided"):
                one.match(-own)
            link.cuts.clear()
            matches = one.match(own)
        return [matches, *(one.match(batch) for batch in BATCHES[party][1:])]

    with patch.object(batching, "MOST_JOBS", 1):
        check_all(robots(tmp_path, paths, link, work, wait=1.0))


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (1, 1), (7, 5)])
def test_the_blocks_of_a_result_are_what_was_decided(shape):
    generator = np.random.default_rng(3)
    for density in (0.0, 0.3, 0.7, 1.0):
        decided = generator.random(shape) < density
        known = Matches(np.zeros(shape), decided, Stats(), 0)
        covered = np.zeros(shape, dtype=int)
        for rows, columns in known.blocks:
            covered[rows.start : rows.stop, columns.start : columns.stop] += 1
        assert np.array_equal(covered, decided)
