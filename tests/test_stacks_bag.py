"""Bags: written and read by rosbags, replayed into an agent."""

import json
import math
import subprocess
import sys
import threading

import numpy as np
import pytest
from agent_helpers import deal, near, places, plan
from stack_helpers import ROLE, FakeAgent, News, cloud, descriptors, unit

pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

from rosbags.rosbag2 import Writer
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from bench.parties import free_port
from protocols.stacks.bag import Bag, write_bag
from protocols.stacks.codec import Codec
from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    InterRobotMatches,
    KeyframePointCloud,
    ros_name,
)
from protocols.stacks.replay import Replay
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.transport import Payload

TOPIC = "/cslam/global_descriptors"
REPLAY = [sys.executable, "-m", "spdz", "replay"]


def record(path, keyframes=5, pace=0.5, topic=TOPIC, more=()):
    """A bag of some keyframes at a pace; returns its path."""
    start = 1_700_000_000.0
    messages = [(start + pace * i, topic, descriptors(i)) for i in range(keyframes)]
    write_bag(
        path,
        sorted([*messages, *((start + after, name, one) for after, name, one in more)], key=lambda m: m[0]),
    )
    return path


def read(*arguments):
    bag = Bag(*arguments)
    try:
        return list(bag)
    finally:
        bag.close()


def test_what_was_recorded_is_read_with_its_stamps(tmp_path):
    recorded = read(record(tmp_path / "bag"))
    assert [one.stamp - recorded[0].stamp for one in recorded] == pytest.approx([0, 0.5, 1, 1.5, 2])
    np.testing.assert_array_equal(recorded[4].message.descriptors[0].descriptor, unit(4))


def test_other_topics_are_passed_over_and_one_topic_can_be_asked_for(tmp_path):
    more = [
        (0.1, "/cslam/inter_robot_matches", InterRobotMatches(0, ())),
        (0.2, "/r1/own", descriptors(9, robot=1)),
    ]
    bag = record(tmp_path / "bag", more=more)
    assert len(read(bag)) == 6 and len(read(bag, TOPIC)) == 5 and len(read(bag, "/r1/own")) == 1


def test_what_was_seen_at_keyframes_is_read_where_it_is_asked_for(tmp_path):
    bag = record(tmp_path / "bag", more=[(0.1, "/r0/cslam/keyframe_data", cloud(1))])
    assert len(read(bag)) == 5
    (payload,) = [
        one.message for one in read(bag, None, KeyframePointCloud) if isinstance(one.message, Payload)
    ]
    assert payload == Payload(1, Codec().encode(cloud(1)))


def test_a_bag_without_descriptors_says_what_it_has(tmp_path):
    write_bag(tmp_path / "bag", [(1.0, "/m", InterRobotMatches(0, ()))])
    with pytest.raises(
        ValueError, match=r"no topic of cslam_common_interfaces/msg/GlobalDescriptors; it has /m"
    ):
        Bag(tmp_path / "bag")
    record(tmp_path / "other")
    with pytest.raises(ValueError, match=r"no topic /typo of .* it has /cslam/global_descriptors"):
        Bag(tmp_path / "other", "/typo")


def foreign(path, text):
    """A bag whose descriptors are defined otherwise."""
    store, name = Typestore(), ros_name(GlobalDescriptors)
    store.register(get_types_from_msg(text, name))
    with Writer(path, version=9) as writer:
        writer.write(writer.add_connection(TOPIC, name, typestore=store), 1, b"\0\1\0\0\0\0\0\0")


def test_a_bag_whose_messages_are_defined_otherwise_is_refused(tmp_path):
    foreign(tmp_path / "bag", "uint8[] numbers\n")
    with pytest.raises(ValueError, match="are defined in another way"):
        Bag(tmp_path / "bag")


def test_a_message_that_is_damaged_is_refused_and_the_rest_is_read(tmp_path):
    codec, name = Codec(), ros_name(GlobalDescriptors)
    with Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection(TOPIC, name, typestore=codec.store)
        for stamp, data in enumerate([codec.encode(descriptors(1)), b"junk", codec.encode(descriptors(2))]):
            writer.write(connection, stamp, data)
    first, second, third = read(tmp_path / "bag")
    assert isinstance(second.message, ValueError)
    assert [one.message.descriptors[0].keyframe_id for one in (first, third)] == [1, 2]


@pytest.mark.parametrize(
    "damage", ["cut off", "cut short", "no metadata", "metadata that is none", "no bag at all", "zeros"]
)
def test_a_bag_that_is_damaged_is_one_sentence(tmp_path, damage):
    bag = record(tmp_path / "bag", keyframes=400)
    (file,) = bag.glob("*.db3")
    data = file.read_bytes()
    if damage == "cut off":
        file.write_bytes(data[:-6000])
    elif damage == "cut short":
        bag = record(tmp_path / "small", keyframes=3)
        (file,) = bag.glob("*.db3")
        file.write_bytes(file.read_bytes()[:-50])
    elif damage == "zeros":
        file.write_bytes(data[:4096] + bytes(len(data) - 4096))
    elif damage == "no metadata":
        (bag / "metadata.yaml").unlink()
    elif damage == "metadata that is none":
        (bag / "metadata.yaml").write_text("{{{")
    else:
        bag = tmp_path / "nothing"
    with pytest.raises(ValueError, match=str(bag)) as told:
        read(bag)
    assert "\n" not in str(told.value)


def test_a_folder_that_is_named_like_a_bag_of_ros_1_is_told(tmp_path):
    with pytest.raises(ValueError, match="rename it"):
        Bag(record(tmp_path / "run.bag"))


def test_a_bag_is_never_written_over(tmp_path):
    record(tmp_path / "bag")
    with pytest.raises(ValueError, match="exists already"):
        record(tmp_path / "bag")


# -- replaying --------------------------------------------------------------------------------------


def replay(bag, agent, **how):
    feeding = Replay(agent, SwarmSlam(agent, ROLE), **how)
    opened = Bag(bag)
    try:
        feeding.feed(opened, threading.Event())
    finally:
        opened.close()
    return feeding


def test_replay_gives_the_agent_every_keyframe_with_its_stamp(tmp_path):
    agent = FakeAgent()
    replay(record(tmp_path / "bag"), agent, speed=math.inf)
    assert sorted(agent.added) == list(range(5))
    assert agent.added[2][2] == pytest.approx(1_700_000_001.0)


class Slept:
    """A clock that runs while somebody sleeps."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.mark.parametrize(("speed", "seconds"), [(1.0, 2.0), (4.0, 0.5), (0.5, 4.0), (math.inf, 0.0)])
def test_replay_keeps_the_recorded_pace_times_the_speed(tmp_path, monkeypatch, speed, seconds):
    clock = Slept()
    monkeypatch.setattr("protocols.stacks.replay.time.sleep", clock.sleep)
    replay(record(tmp_path / "bag"), FakeAgent(), speed=speed, clock=clock)
    assert clock.now == pytest.approx(seconds, abs=1e-9)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_a_speed_that_is_none_is_refused(speed):
    with pytest.raises(ValueError, match="a positive number"):
        Replay(FakeAgent(), SwarmSlam(FakeAgent(), ROLE), speed)


def test_replay_shows_what_is_found_and_ends_when_all_is_settled(tmp_path):
    agent, shown = FakeAgent(news=[News(1, 1), News(2, 2)]), []
    agent.why = {"bob": "settled"}
    feeding = replay(record(tmp_path / "bag"), agent, speed=math.inf, show=shown.append)
    feeding.linger(0.2, threading.Event())
    assert [news.number for news in shown] == [1, 2]


def lingered(monkeypatch, **until_100):
    """When a replay ends that waits for 5 quiet seconds, with a gallery that is otherwise for 100 seconds."""
    clock, agent = Slept(), FakeAgent(why={"bob": ""})
    monkeypatch.setattr("protocols.stacks.replay.time.sleep", clock.sleep)
    (settled,) = agent.status()["galleries"]
    agent.status = lambda: {"galleries": [settled if clock.now > 100 else settled | until_100]}
    Replay(agent, SwarmSlam(agent, ROLE), clock=clock).linger(5.0, threading.Event())
    return clock.now


def test_replay_does_not_end_before_all_is_compared_with_who_is_there(monkeypatch):
    assert 105 < lingered(monkeypatch, settled=False) < 106


@pytest.mark.parametrize(
    "without", [{"settled": False, "held": 0, "state": "waiting"}, {"held": 0}, {"state": "stopped"}]
)
def test_replay_ends_where_the_peer_is_away_or_nothing_was_taken(monkeypatch, without):
    assert 5 < lingered(monkeypatch, **without) < 6


# -- two agents from one bag ------------------------------------------------------------------------


def matches_of(output):
    lines = [json.loads(line) for line in output.splitlines()]
    assert [line for line in lines if line["event"] in ("rejected", "withheld", "error")] == []
    return {(line["keyframe"], line["peer_keyframe"]) for line in lines if line["event"] == "verified"}, lines


@pytest.mark.timeout(300)
def test_two_robots_replay_one_bag_and_find_what_the_clear_computation_finds(tmp_path):
    dim, threshold = 16, 0.8
    a = places(20, dim, seed=1)
    b = np.concatenate([near(a[5:13], seed=2, noise=0.5), places(8, dim, seed=3)])
    expected = {(int(i), 100 + int(j)) for i, j in np.argwhere(a @ b.T >= threshold)}
    assert 3 <= len(expected) <= 20
    mission = deal(tmp_path, plan(dim=dim, threshold=threshold))
    messages = [
        (10 + 0.5 * i, TOPIC, GlobalDescriptors((GlobalDescriptor(i, 0, x),))) for i, x in enumerate(a)
    ]
    messages += [
        (10.2 + 0.5 * j, TOPIC, GlobalDescriptors((GlobalDescriptor(100 + j, 1, y),)))
        for j, y in enumerate(b)
    ]
    write_bag(tmp_path / "team", sorted(messages, key=lambda message: message[0]))
    port = free_port()
    sides = {"alice": ["--listen", f"127.0.0.1:{port}"], "bob": ["--peer", f"alice=127.0.0.1:{port}"]}
    how = ["--speed", "5", "--json", "--until-quiet", "8"]
    processes = [
        subprocess.Popen(
            [*REPLAY, str(tmp_path / "team"), "--mission", str(mission / robot), *how, *where],
            stdout=subprocess.PIPE,
            text=True,
        )
        for robot, where in sides.items()
    ]
    try:
        outputs = [process.communicate(timeout=100)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()
            process.stdout.close()
    assert [process.returncode for process in processes] == [0, 0]
    alices, told = matches_of(outputs[0])
    bobs, _ = matches_of(outputs[1])
    assert alices == expected and bobs == {(j, i) for i, j in expected}
    report = told[-1]
    assert report["counts"]["added"] == 20 and report["counts"]["of other robots"] == 16


def test_replaying_a_bag_that_is_none_is_one_json_error(tmp_path):
    mission = deal(tmp_path, plan())
    where = ["--mission", str(mission / "alice"), "--listen", "127.0.0.1:0", "--json"]
    done = subprocess.run(
        [*REPLAY, str(tmp_path / "none"), *where], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 2 and done.stderr == ""
    assert "is no bag" in json.loads(done.stdout)["message"]


@pytest.mark.parametrize("ends", ["--until-quiet=0.5", "--until-quiet=200 --for=2"])
def test_a_replay_without_its_peer_ends_and_says_what_was_refused_and_why_nothing_matched(tmp_path, ends):
    mission = deal(tmp_path, plan(dim=8))
    vectors = [3.0 * unit(number) for number in range(6)]
    messages = [
        (1.0, TOPIC, GlobalDescriptors((GlobalDescriptor(number, 0, vector),)))
        for number, vector in enumerate(vectors)
    ]
    write_bag(tmp_path / "bag", messages)
    where = ["--mission", str(mission / "alice"), "--listen", "127.0.0.1:0", *ends.split()]
    done = subprocess.run(
        [*REPLAY, str(tmp_path / "bag"), *where], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0 and done.stdout == ""
    refusals = [line for line in done.stderr.splitlines() if line.startswith("keyframe ")]
    assert len(refusals) == 5 and "norm of 3, the plan says 0 to 1 (--normalise divides" in refusals[0]
    assert "in all: 6 received, 6 refused (1 more than is told above)" in done.stderr
    assert "this robot has no keyframes yet" in done.stderr


def test_a_speed_that_is_no_number_is_told(tmp_path):
    words = [*REPLAY, str(tmp_path), "--mission", str(tmp_path), "--speed", "fast"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2 and "expected a number or max, not 'fast'" in done.stderr
