"""An agent on a ROS 2 graph over real DDS: two processes on loopback."""

import itertools
import json
import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from stack_helpers import ROLE, FakeAgent, News, cloud, descriptors, unit

pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for this machine")
pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

from protocols.stacks.bridge import Bridge, give
from protocols.stacks.codec import Codec
from protocols.stacks.dds import LOOPBACK, Dds, _quality, idl_types, to_idl
from protocols.stacks.messages import GlobalDescriptors, KeyframePointCloud
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.topics import topics
from protocols.stacks.transport import Payload

NAMES = topics("/r0")
_DOMAINS = itertools.count(os.getpid())
PATIENCE = 60.0


@pytest.fixture(params=["as it is", "CYCLONEDDS_URI"])
def domain(request, monkeypatch):
    """A domain of one's own; bound to loopback by the transport itself, or by the user's variable."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    if request.param == "CYCLONEDDS_URI":
        monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return 100 + next(_DOMAINS) % 100


class Echo(FakeAgent):
    """Finds a match for every keyframe that it is given."""

    def add(self, keyframe, *arguments, **more):
        super().add(keyframe, *arguments, **more)
        self.news.append(News(len(self.news) + 1, keyframe, "bob", keyframe, 100 + keyframe))


def stack(domain, keyframes):
    environment = os.environ | {"CYCLONEDDS_URI": LOOPBACK}
    command = [sys.executable, Path(__file__).with_name("stack_worker.py"), str(domain), str(keyframes)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def run(transport, agent, domain, keyframes):
    """A robot's stack in another process and the bridge in this one; what the stack tells at its end."""
    ended = threading.Event()
    bridge = Bridge(agent, SwarmSlam(agent, ROLE), transport, NAMES)
    loop = threading.Thread(target=bridge.run, args=(ended,))
    loop.start()
    process = stack(domain, keyframes)
    try:
        output, _ = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        ended.set()
        loop.join(timeout=10)
        transport.close()
    assert process.returncode == 0
    return json.loads(output)


def test_descriptors_go_to_the_agent_and_matches_come_back_and_nothing_else_is_written(domain):
    agent = Echo()
    told = run(Dds(NAMES, domain), agent, domain, keyframes=25)
    assert sorted(agent.added) == list(range(25))
    np.testing.assert_array_equal(agent.added[24][0], unit(24))
    heard = [[0, keyframe, 1, 100 + keyframe, np.float32(0.8)] for keyframe in range(25)]
    assert sorted(told["heard"]) == heard
    assert told["written"] == {
        "rt/cslam/inter_robot_loop_closure": "cslam_common_interfaces::msg::dds_::InterRobotLoopClosure_",
        "rt/cslam/inter_robot_matches": "cslam_common_interfaces::msg::dds_::InterRobotMatches_",
    }


@pytest.fixture
def graph(domain):
    """The transport, and another participant of its domain in this process."""
    from cyclonedds.domain import DomainParticipant

    transport = Dds(NAMES, domain, payload=KeyframePointCloud)
    participant = DomainParticipant(domain)
    yield transport, participant
    del participant
    transport.close()  # a second time changes nothing


def writer(participant, topic, kind):
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    made = idl_types(kind)
    return DataWriter(participant, Topic(participant, topic, made[kind]), qos=_quality()), made


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def take(transport, count):
    found = []
    deadline = time.monotonic() + PATIENCE
    while len(found) < count and time.monotonic() < deadline:
        found += transport.take(0.1)
    return found


def test_what_was_seen_at_a_keyframe_goes_to_the_agent_as_the_bytes_of_its_message(graph):
    transport, participant = graph
    clouds, made = writer(participant, "rt/r0/cslam/keyframe_data", KeyframePointCloud)
    own, types = writer(participant, "rt/r0/cslam/global_descriptors", GlobalDescriptors)
    clouds.write(to_idl(cloud(3, points=1000), made))
    own.write(to_idl(descriptors(3), types))
    agent = FakeAgent()
    slam = SwarmSlam(agent, ROLE, payloads=True)
    for message in take(transport, 2):
        give(slam, message)
    assert agent.added[3][1] == Codec().encode(cloud(3, points=1000))


def test_only_public_messages_are_published(graph):
    transport, _ = graph
    for message in (
        descriptors(3),
        cloud(3),
        Payload(3, b"scan"),
        descriptors(3).descriptors[0],
        b"scan",
        None,
    ):
        with pytest.raises(ValueError, match="is not published"):
            transport.publish(message)


def test_writers_and_readers_are_counted(graph):
    transport, participant = graph
    assert transport.writers() == 0 and not transport.has_reader()
    held, _ = writer(participant, "rt/r0/cslam/global_descriptors", GlobalDescriptors)
    wait_for(lambda: transport.writers() == 1)
    assert held is not None


def test_quality_of_service_is_reliable_volatile_and_a_hundred_deep(graph):
    from cyclonedds.qos import Policy

    transport, _ = graph
    for entity in (*transport._readers.values(), *transport._writers.values()):
        quality = entity.get_qos()
        assert isinstance(quality[Policy.Reliability], Policy.Reliability.Reliable)
        assert quality[Policy.Durability] == Policy.Durability.Volatile
        assert quality[Policy.History] == Policy.History.KeepLast(100)


@pytest.mark.parametrize("domain", ["CYCLONEDDS_URI"], indirect=True)
def test_a_closed_transport_is_gone_from_the_graph(graph):
    transport, participant = graph
    held, _ = writer(participant, "rt/r0/cslam/global_descriptors", GlobalDescriptors)
    wait_for(lambda: held.get_matched_subscriptions())
    transport.close()
    wait_for(lambda: not held.get_matched_subscriptions())


def test_a_domain_that_was_left_can_be_joined_again(domain):
    for _ in range(2):
        Dds(NAMES, domain).close()


def test_a_domain_that_cannot_be_joined_is_told_with_where(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><Nonsense/></Domain></CycloneDDS>")
    with pytest.raises(OSError, match="cannot join DDS domain 99 on what CYCLONEDDS_URI says"):
        Dds(NAMES, 99)


def test_a_message_of_another_type_under_the_same_name_is_refused_or_never_matches(graph):
    transport, participant = graph
    from dataclasses import dataclass

    from cyclonedds.idl import IdlStruct, annotations, types
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    name = "cslam_common_interfaces::msg::dds_::GlobalDescriptors_"

    @annotations.final
    @dataclass
    class Foreign(IdlStruct, typename=name):
        octets: types.sequence[types.uint8]

    foreign = DataWriter(participant, Topic(participant, "rt/r0/cslam/global_descriptors", Foreign))
    foreign.write(Foreign(octets=[1, 2, 3]))
    own, made = writer(participant, "rt/r0/cslam/global_descriptors", GlobalDescriptors)
    own.write(to_idl(descriptors(3), made))
    *refused, good = take(transport, 1)
    assert all(isinstance(one, ValueError) for one in refused)
    assert good.descriptors[0].keyframe_id == 3


def test_bytes_that_cyclone_cannot_read_are_refused_by_the_topic_s_name(graph):
    transport, _ = graph

    class Broken:
        topic = transport._readers[GlobalDescriptors].topic

        def take(self, count):
            raise struct.error("unpack requires a buffer of 8 bytes")

    refused = transport._take_one(GlobalDescriptors, Broken())
    assert isinstance(refused, ValueError) and "rt/r0/cslam/global_descriptors" in str(refused)
