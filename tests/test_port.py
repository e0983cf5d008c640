"""One port for all peers: who gets through, what they call about, and who is left out."""

import time

import pytest
from channel_helpers import LONG, SHORT, assert_alive, together
from port_helpers import Background, calling, open_port, parked, until

from spdz.foundations.errors import ChannelTimeout

__all__ = ["open_port"]


def test_robots_and_topics_meet_on_one_port_at_once(folders, open_port):
    port = open_port()
    calls = [(robot, topic) for robot in ("bob", "carol") for topic in ("lidar", "camera")]
    ends = together(
        *(lambda key=key: port.take(*key, LONG) for key in calls),
        *(calling(folders, port, *key) for key in calls),
    )
    for here, there in zip(ends[:4], ends[4:], strict=True):
        with here, there:
            assert_alive(here, there)


def test_a_call_may_come_long_before_it_is_taken(folders, open_port):
    port = open_port()
    caller = Background(calling(folders, port))
    until(lambda: parked(port) == {("bob", "lidar")})
    time.sleep(SHORT)
    assert caller.result is None  # it waits
    with port.take("bob", "lidar", 0) as here, caller.wait() as there:
        assert_alive(here, there)


def test_a_call_is_taken_by_whoever_waits_for_that_peer_and_topic(folders, open_port):
    port = open_port()
    with pytest.raises(ChannelTimeout), calling(folders, port, wait=SHORT)():
        pass
    others = [
        Background(lambda key=key: port.take(*key, SHORT)) for key in (("bob", "camera"), ("carol", "lidar"))
    ]
    caller = Background(calling(folders, port, wait=SHORT))
    for other in others:
        assert isinstance(other.wait(), ChannelTimeout)
    assert isinstance(caller.wait(), ChannelTimeout)
