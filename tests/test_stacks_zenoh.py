"""An agent on a ROS 2 graph over Zenoh: the same adapter, keys and attachments as rmw_zenoh has them."""

import json
import os
import signal
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from agent_helpers import deal, places, plan
from stack_helpers import ROLE, FakeAgent, News, cloud, descriptors, unit

pytest.importorskip("zenoh", reason="needs eclipse-zenoh: pip install eclipse-zenoh")
pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

import zenoh

from bench.parties import free_port
from protocols.stacks.bridge import Bridge, give
from protocols.stacks.codec import Codec
from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    InterRobotLoopClosure,
    InterRobotMatches,
    KeyframePointCloud,
    dds_name,
)
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.topics import topics
from protocols.stacks.transport import Payload
from protocols.stacks.zenoh import HUMBLE_HASH, Zenoh, attachment

NAMES = topics("/r0")
PATIENCE = 30.0
CODEC = Codec()


def session(**more):
    quiet = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    return json.dumps({"mode": "peer", "scouting": quiet, **more})


class Graph:
    """The robot's other nodes: one session that hears everything."""

    def __init__(self, port):
        self.heard = []
        self.session = zenoh.open(
            zenoh.Config.from_json5(session(listen={"endpoints": [f"tcp/127.0.0.1:{port}"]}))
        )
        self.all = self.session.declare_subscriber("**", self.heard.append)


@pytest.fixture(params=["rmw", "bridge"])
def keys(request):
    return request.param


@pytest.fixture
def graph(keys):
    """A transport and the graph that it is in."""
    port = free_port()
    others = Graph(port)
    link = session(connect={"endpoints": [f"tcp/127.0.0.1:{port}"]}, listen={"endpoints": []})
    transport = Zenoh(NAMES, 7, payload=KeyframePointCloud, keys=keys, session=link)
    yield transport, others
    transport.close()
    others.session.close()


def send(others, keys, topic, message, *, type_hash="RIHS01_0123", domain=7, heard=True):
    """Write a message as one of the robot's other nodes does, once somebody listens."""
    data = message if isinstance(message, bytes) else CODEC.encode(message)
    kind = GlobalDescriptors if isinstance(message, bytes) else type(message)
    key = topic[1:] if keys == "bridge" else f"{domain}{topic}/{dds_name(kind)}/{type_hash}"
    publisher = others.session.declare_publisher(key, allowed_destination=zenoh.Locality.REMOTE)
    if heard:
        wait_for(lambda: publisher.matching_status.matching)
    publisher.put(data)


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def take(transport, count):
    found = []
    wait_for(lambda: found.extend(transport.take(0.05)) or len(found) >= count)
    return found


def test_descriptors_and_keyframe_data_go_to_the_agent(graph, keys):
    transport, others = graph
    send(others, keys, NAMES.keyframes, cloud(3))
    send(others, keys, NAMES.descriptors, descriptors(3))
    agent = FakeAgent()
    slam = SwarmSlam(agent, ROLE, payloads=True)
    for message in take(transport, 2):
        give(slam, message)
    np.testing.assert_array_equal(agent.added[3][0], unit(3))
    assert agent.added[3][1] == CODEC.encode(cloud(3))


@pytest.mark.parametrize("keys", ["rmw"], indirect=True)
@pytest.mark.parametrize("type_hash", ["RIHS01_0123", HUMBLE_HASH])
def test_the_types_hash_of_any_distribution_is_heard(graph, keys, type_hash):
    transport, others = graph
    send(others, keys, NAMES.descriptors, descriptors(3), type_hash=type_hash)
    assert take(transport, 1)[0].descriptors[0].keyframe_id == 3


@pytest.mark.parametrize("keys", ["rmw"], indirect=True)
def test_another_domain_is_not_heard(graph, keys):
    transport, others = graph
    send(others, keys, NAMES.descriptors, descriptors(3), domain=8, heard=False)
    send(others, keys, NAMES.descriptors, descriptors(4))
    assert take(transport, 1)[0].descriptors[0].keyframe_id == 4


def test_bytes_that_are_no_message_are_refused_and_the_next_message_is_taken(graph, keys):
    transport, others = graph
    send(others, keys, NAMES.descriptors, b"junk")
    send(others, keys, NAMES.descriptors, descriptors(3))
    refused, message = take(transport, 2)
    assert isinstance(refused, ValueError) and message.descriptors[0].keyframe_id == 3


def test_matches_and_closures_are_all_that_is_published(graph, keys):
    transport, others = graph
    agent = FakeAgent(news=[News(1, 1, transform=(1.0, 2.0, 0.5), weight=0.9)])
    agent.add(3, {"lidar": unit(3)}, payload=b"what the robot saw")
    bridge = Bridge(agent, SwarmSlam(agent, ROLE), transport, NAMES)
    each = 2 if keys == "rmw" else 1  # with either form of the type's hash
    wait_for(lambda: bridge.step(0.05) or len(others.heard) >= 2 * each)
    heard = {str(sample.key_expr) for sample in others.heard}
    if keys == "rmw":
        assert heard == {
            f"7{name}/{dds_name(kind)}/{type_hash}"
            for name, kind in ((NAMES.matches, InterRobotMatches), (NAMES.closures, InterRobotLoopClosure))
            for type_hash in (CODEC.type_hash(kind), HUMBLE_HASH)
        }
    else:
        assert heard == {"cslam/inter_robot_matches", "cslam/inter_robot_loop_closure"}
    kinds = {"matches": InterRobotMatches, "closure": InterRobotLoopClosure}
    for sample in others.heard:
        data = sample.payload.to_bytes()
        kind = kinds["closure" if "loop_closure" in str(sample.key_expr) else "matches"]
        assert CODEC.encode(CODEC.decode(kind, data)) == data
        assert sample.congestion_control == zenoh.CongestionControl.BLOCK
        number, _, size, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
        assert number >= 1 and size == len(gid) == 16


@pytest.mark.parametrize("keys", ["rmw"], indirect=True)
def test_whether_anybody_reads_is_told(graph, keys):
    transport, others = graph
    wait_for(transport.has_reader)
    others.all.undeclare()
    wait_for(lambda: not transport.has_reader())
    held = others.session.declare_subscriber("7/cslam/inter_robot_matches/**")
    wait_for(transport.has_reader)
    assert held is not None


def test_only_public_messages_are_published(graph):
    transport, _ = graph
    for message in (descriptors(3), cloud(3), Payload(3, b"scan"), b"scan"):
        with pytest.raises(ValueError, match="is not published"):
            transport.publish(message)


def test_the_attachment_is_zenoh_s_serialization_of_two_integers_and_bytes():
    gid = bytes(range(16))
    expected = zenoh.ext.z_serialize((zenoh.ext.Int64(5), zenoh.ext.Int64(-3), gid)).to_bytes()
    assert attachment(5, -3, gid) == expected


def test_what_comes_faster_than_it_is_taken_is_lost_with_a_word(graph, monkeypatch):
    transport, _ = graph
    monkeypatch.setattr("protocols.stacks.zenoh._FULL", 1e-3)
    data = CODEC.encode(descriptors(3))
    for _ in range(103):
        transport._heard(GlobalDescriptors, data)
    *_, last = transport.take(0.01)
    assert isinstance(last, ValueError) and "3 messages were lost" in str(last)


@pytest.mark.parametrize("keys", ["rmw"], indirect=True)
def test_a_router_that_is_not_there_is_told_with_its_endpoint(graph, keys):
    transport, others = graph
    wait_for(lambda: transport.silence() is None)
    others.session.close()
    wait_for(lambda: transport.silence() is not None)
    assert "no Zenoh router or peer answers at tcp/127.0.0.1:" in transport.silence()


def test_a_configuration_that_is_none_is_refused(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="Zenoh configuration"):
        Zenoh(NAMES, session="{ mode: 'nonsense' }")
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(tmp_path / "none.json5"))
    with pytest.raises(ValueError, match="Zenoh configuration"):
        Zenoh(NAMES)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("keys", ["rmw"], indirect=True)
def test_the_command_runs_over_zenoh_and_says_why_nothing_matched(tmp_path, keys):
    port = free_port()
    others = Graph(port)
    file = tmp_path / "session.json5"
    file.write_text(session(connect={"endpoints": [f"tcp/127.0.0.1:{port}"]}, listen={"endpoints": []}))
    mission = deal(tmp_path, plan())
    where = f"--mission {mission}/alice --listen 127.0.0.1:0 --namespace /r0 --domain 7 --json".split()
    process = subprocess.Popen(
        [sys.executable, "-m", "spdz", "ros", "--transport", "zenoh", *where],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ZENOH_SESSION_CONFIG_URI": str(file)},
    )
    try:
        for keyframe, vector in enumerate(places(3, 16, seed=1)):
            send(others, keys, NAMES.descriptors, GlobalDescriptors((GlobalDescriptor(keyframe, 0, vector),)))
        send(others, keys, NAMES.descriptors, descriptors(9, dim=5))
        refusal = next(line for line in map(json.loads, process.stdout) if line["event"] == "refused")
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        others.session.close()
    assert "keyframe 9: its descriptor has 5 numbers, the plan says 16" in refusal["text"]
    report = json.loads(output.splitlines()[-1])
    assert report["counts"]["added"] == 3
    assert report["why"]["bob"]["code"] == "peer-absent"
