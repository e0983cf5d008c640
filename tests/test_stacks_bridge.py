"""The process in the place of the detection node: what goes through it, what it says when nothing does."""

import threading

import pytest
from stack_helpers import ROLE, FakeAgent, News, cloud, descriptors

from protocols.stacks.bridge import PATIENCE, Bridge
from protocols.stacks.messages import InterRobotMatches
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.topics import topics
from protocols.stacks.transport import Payload, require_public

NAMES = topics("/r0")


class Wire:
    """A transport that holds what is put into it."""

    where = "a test"

    def __init__(self):
        self.incoming, self.published, self.reader, self.writing = [], [], True, 0
        self.nobody = None

    def take(self, seconds):
        taken, self.incoming = self.incoming, []
        return taken

    def publish(self, message):
        require_public(message)
        self.published.append(message)

    def silence(self):
        return self.nobody

    def writers(self):
        return self.writing

    def has_reader(self):
        return self.reader


@pytest.fixture
def parts():
    """Bridge, wire, agent, what was said, and the clock."""
    agent, wire, said, now = FakeAgent(), Wire(), [], [0.0]
    slam = SwarmSlam(agent, ROLE, on_event=said.append, clock=lambda: now[0])
    return Bridge(agent, slam, wire, NAMES, say=said.append, clock=lambda: now[0]), wire, agent, said, now


def test_descriptors_go_in_and_matches_come_out(parts):
    bridge, wire, agent, _, _ = parts
    agent.news = [News(1, 1)]
    wire.incoming = [descriptors(3), ValueError("damaged"), Payload(3, b"scan")]
    bridge.step(0.0)
    assert list(agent.added) == [3]
    assert [type(message) for message in wire.published] == [InterRobotMatches]


def test_matches_wait_unread_until_somebody_reads_them(parts):
    bridge, wire, agent, _, _ = parts
    wire.reader, agent.news = False, [News(1, 1)]
    bridge.step(0.0)
    assert agent.read == 0 and not wire.published
    wire.reader = True
    bridge.step(0.0)
    assert agent.read == 1 and len(wire.published) == 1


def test_a_match_counts_as_read_only_once_it_is_published(parts):
    bridge, wire, agent, said, now = parts
    bridge.adapter.counts["received"] = 1
    agent.news = [News(1, 1), News(2, 2, keyframe=4)]
    publish = wire.publish
    wire.publish = lambda message: (_ for _ in ()).throw(OSError("the graph is gone"))
    for second in range(12):
        now[0] = float(second)
        bridge.step(0.0)
    assert agent.read == 0 and len(said) == 1 and "the graph is gone; it is tried again" in said[0]
    wire.publish = publish
    bridge.step(0.0)
    assert agent.read == 2
    assert [message.matches[0].robot0_keyframe_id for message in wire.published] == [3, 4]


def test_every_news_is_shown(parts):
    bridge, _, agent, _, _ = parts
    shown = []
    bridge.show = shown.append
    agent.news = [News(1, 1, state="candidate", peer_keyframe=None), News(2, 1)]
    bridge.step(0.0)
    assert [news.number for news in shown] == [1, 2]


@pytest.mark.parametrize(("writing", "told"), [(0, "nobody writes there"), (2, "2 write there")])
def test_silence_on_the_descriptors_topic_is_told_ever_more_rarely(parts, writing, told):
    bridge, wire, _, said, now = parts
    wire.writing = writing
    for second in range(100):
        now[0] = float(second)
        bridge.step(0.0)
    assert len(said) == 3  # after 10, 30 and 70 seconds
    assert "/r0/cslam/global_descriptors" in said[0] and told in said[0] and "a test" in said[0]
    wire.incoming = [descriptors(3)]
    now[0] += 1000
    bridge.step(0.0)
    assert len(said) == 3


def test_that_nobody_answers_is_told_after_some_seconds(parts):
    bridge, wire, _, said, now = parts
    wire.nobody, wire.writing = "no router answers at tcp/localhost:7447", None
    for now[0] in (0.0, 9.0, 11.0, 12.0):
        bridge.step(0.0)
    assert [sentence for sentence in said if "answers" in sentence] == [f"{wire.nobody} (a test)"]


def test_that_nobody_reads_is_told_with_the_topics(parts):
    bridge, wire, _, said, now = parts
    wire.reader = False
    wire.incoming = [descriptors(3)]
    bridge.step(0.0)
    now[0] = PATIENCE + 1
    bridge.step(0.0)
    (sentence,) = said
    assert "nobody reads /cslam/inter_robot_matches or /cslam/inter_robot_loop_closure" in sentence


@pytest.mark.parametrize(
    "message", [descriptors(3), descriptors(3).descriptors[0], cloud(3), Payload(3, b""), b"x"]
)
def test_nothing_but_matches_and_closures_may_be_published(message):
    with pytest.raises(ValueError, match="over the agents' TLS sessions alone"):
        require_public(message)


def test_it_ends_when_it_is_told_to(parts):
    bridge = parts[0]
    ended = threading.Event()
    loop = threading.Thread(target=bridge.run, args=(ended, 0.001))
    loop.start()
    ended.set()
    loop.join(timeout=10)
    assert not loop.is_alive()
