"""Galleries whose robots are restarted, run out of slots, stop, or are used by several threads."""

from threading import Event
from unittest.mock import patch

import link_helpers
import numpy as np
import pytest
from link_helpers import Link, unit
from stream_helpers import (
    STREAMS,
    check_stream,
    deal,
    decided,
    fresh,
    maps,
    robot,
    robots,
    stream,
    table_of,
)

from spdz import (
    ChannelError,
)
from spdz.session import gallery

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def hang_up(one):
    """As a process that is killed: no farewell."""
    one.close()
    one._number = None


@pytest.mark.parametrize("after", range(len(STREAMS[1]) + 1))
def test_a_robot_that_was_restarted_between_steps_goes_on_with_its_peers_number(mission, after):
    def work(one, party):
        if party == 0:
            return stream(one, party)
        steps = []
        for new in STREAMS[1][:after]:
            one.add(new)
            steps.append(one.step())
        hang_up(one)
        with robot(mission, 1) as again:
            for new in STREAMS[1][after:]:
                again.add(new)
                steps.append(again.step())
            again.connect()
            assert again.filled == list(range(len(maps()[1])))
            return steps, list(again.results())

    check_stream(robots(mission, Link(), work))


@pytest.mark.parametrize("limit", range(400, 3900, 250))
def test_a_robot_that_was_restarted_within_a_step_adds_the_rest_and_goes_on(mission, limit):
    """It tells by ``holds`` what it has brought already."""

    def work(one, party):
        if party == 0:
            return stream(one, party)
        one._wait, blocks, done = 1e-3, [], 0
        try:
            for new in STREAMS[1]:
                one.add(new)
                blocks += one.step().blocks
                done += 1
        except ChannelError as error:
            blocks += error.partial.blocks
        hang_up(one)
        with robot(mission, 1) as again:
            again.connect()
            # Alice tells her number; a step that she is through with is not made again. She may have missed
            # the end of the last step that Bob was through with: his map is that of the one that he was in.
            for k in range(again._number, len(STREAMS[1])):
                so_far = np.concatenate(STREAMS[1][: max(k, done) + 1])
                again.add(so_far[again.holds(so_far) :])
                blocks += again.step().blocks
            assert np.array_equal(again._session.plain(again.filled), np.rint(maps()[1] * 65536))
            return done, list(again.results())

    first, second = robots(mission, Link([(1, limit)]), work)
    check_first(first)
    assert not isinstance(second, Exception), second
    decided(second[1], 1)


def check_first(result):
    assert not isinstance(result, Exception), result
    steps, stored = result
    decided(stored, 0)
    decided([block for step in steps for block in step.blocks], 0)


def test_a_robot_that_was_restarted_between_filling_and_preparing_knows_what_it_holds(mission):
    """And it does not bring it twice."""

    def work(one, party):
        if party == 0:
            return stream(one, party)
        one.add(STREAMS[1][0])
        with patch.object(
            gallery.GallerySession, "_begin", side_effect=lambda: one._session._channel.close()
        ):
            one._wait = 1e-3
            with pytest.raises(ChannelError):
                one.step()
        hang_up(one)
        with robot(mission, 1) as again:
            again.connect()
            assert again.unfinished or not again.filled
            for k in range(again._number, len(STREAMS[1])):
                so_far = np.concatenate(STREAMS[1][: k + 1])
                again.add(so_far[again.holds(so_far) :])
                again.step()
            assert not again.unfinished
            return [], list(again.results())

    first, second = robots(mission, Link(), work)
    check_first(first)
    assert not isinstance(second, Exception), second
    decided(second[1], 1)


class Silent(link_helpers.Cut):
    """A link that loses the rest and tells neither end."""

    def put(self, piece):
        if piece is not None and self.left > 0:
            self.there.put(piece[: self.left])
            self.left -= len(piece)


def test_what_a_served_peer_has_brought_since_comes_with_the_next_step(dealt, tmp_path):
    """Bob misses the end of step 0, gives up for a while, and comes back with something new."""
    late, ends, gone = unit(50, 1), [], Event()

    def first_step(one, party):
        one.add(STREAMS[party][0])
        one.step()
        if party == 0:
            ends.append(one._session._channel.bytes_sent)

    robots(fresh(dealt, tmp_path / "whole"), Link(), first_step)

    def work(one, party):
        one.add(STREAMS[party][0])
        if party == 0:
            steps = [one.step()]
            assert gone.wait(20)
            one.add(STREAMS[0][2])
        else:
            one._wait = 1e-3
            with pytest.raises(ChannelError):
                one.step()
            one._wait = 60.0
            one.add(late)
            gone.set()
            steps = [one.step()]
        steps.append(one.step())
        assert one.partial is None
        return steps

    with patch.object(link_helpers, "Cut", Silent):
        results = robots(fresh(dealt, tmp_path / "m"), Link([(0, ends[0] - 1)], timeout=1.0), work)
    for result in results:
        assert not isinstance(result, Exception), result
    (one, two), (three, four) = results
    assert (one.own, one.peer, two.own, two.peer) == ([0, 1], [0], [2, 3, 4], [1])
    assert (three.own, three.peer + four.peer) == ([0, 1], [0, 1, 2, 3, 4]) and four.own == []
    for steps, shape in zip(results, ((5, 2), (2, 5)), strict=True):
        _, known = table_of([block for step in steps for block in step.blocks], shape)
        assert (known == 1).all()
