"""``python -m spdz ros``: two robots, each on a DDS graph of its own, meet over their agents' TLS alone."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from agent_helpers import deal, near, places, plan
from stack_helpers import cloud

pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for this machine")
pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

from bench.parties import free_port
from protocols.stacks.codec import from_foreign
from protocols.stacks.dds import LOOPBACK, _quality, idl_types, to_idl
from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    InterRobotLoopClosure,
    InterRobotMatches,
    KeyframePointCloud,
)

HERE = Path(__file__).parent
PATIENCE = 60.0
_DOMAINS = itertools.count(os.getpid())


class Stack:
    """The other nodes of a robot: what writes its keyframes, and what reads its matches."""

    def __init__(self, domain, namespace):
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        participant = DomainParticipant(domain)
        self.types = idl_types(
            GlobalDescriptors, KeyframePointCloud, InterRobotMatches, InterRobotLoopClosure
        )

        def topic(name, kind):
            return Topic(participant, f"rt{name}", self.types[kind])

        self.own = DataWriter(
            participant, topic(f"{namespace}/cslam/global_descriptors", GlobalDescriptors), qos=_quality()
        )
        self.seen = DataWriter(
            participant, topic(f"{namespace}/cslam/keyframe_data", KeyframePointCloud), qos=_quality()
        )
        self.readers = {
            InterRobotMatches: DataReader(
                participant, topic("/cslam/inter_robot_matches", InterRobotMatches), qos=_quality()
            ),
            InterRobotLoopClosure: DataReader(
                participant, topic("/cslam/inter_robot_loop_closure", InterRobotLoopClosure), qos=_quality()
            ),
        }
        self.spy = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        self.mine = str(participant.guid)[:24]
        self.matches, self.closures, self.written = set(), set(), set()

    def met(self):
        return self.own.get_matched_subscriptions() and self.seen.get_matched_subscriptions()

    def write(self, robot, keyframe, vector):
        self.seen.write(to_idl(cloud(keyframe), self.types))
        message = GlobalDescriptors((GlobalDescriptor(keyframe, robot, vector),))
        self.own.write(to_idl(message, self.types))

    def listen(self):
        for message in self.readers[InterRobotMatches].take(100):
            self.matches.update(from_foreign(InterRobotMatches, message).matches)
        for message in self.readers[InterRobotLoopClosure].take(100):
            self.closures.add(from_foreign(InterRobotLoopClosure, message))
        for one in self.spy.take(100):
            if str(one.participant_key)[:24] != self.mine:
                self.written.add(one.topic_name)


def start(*words):
    """The command, in the tests' folder, where the verification is."""
    path = {"PYTHONPATH": os.pathsep.join([str(HERE.parent), str(HERE)])}
    command = [sys.executable, "-m", "spdz", "ros", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=HERE, env=os.environ | path)


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.02)


@pytest.mark.timeout(200)
def test_two_robots_on_graphs_of_their_own_find_what_the_clear_computation_finds(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    a = places(10, 16, seed=1)
    b = np.concatenate([near(a[4:8], seed=2), places(4, 16, seed=3)])
    expected = {(int(i), 100 + int(j)) for i, j in np.argwhere(a @ b.T >= 0.8)}
    mission = deal(tmp_path, plan())
    port, domains = free_port(), (100 + next(_DOMAINS) % 50, 150 + next(_DOMAINS) % 50)
    stacks = [Stack(domain, f"/r{robot}") for robot, domain in enumerate(domains)]
    sides = {"alice": ["--listen", f"127.0.0.1:{port}"], "bob": ["--peer", f"alice=127.0.0.1:{port}"]}
    how = ["--payload", "KeyframePointCloud", "--verify", "stack_verify:verify", "--json"]
    processes = [
        start(
            "--mission",
            str(mission / name),
            *how,
            *where,
            "--namespace",
            f"/r{robot}",
            "--domain",
            str(domain),
        )
        for robot, ((name, where), domain) in enumerate(zip(sides.items(), domains, strict=True))
    ]
    try:
        wait_for(lambda: all(stack.met() for stack in stacks))
        for keyframe in range(max(len(a), len(b))):
            for robot, rows in enumerate((a, b)):
                if keyframe < len(rows):
                    stacks[robot].write(robot, 100 * robot + keyframe, rows[keyframe])

        def all_found():
            for stack in stacks:
                stack.listen()
            return all(len(stack.closures) == len(stack.matches) == len(expected) for stack in stacks)

        wait_for(all_found)
        for process in processes:
            process.send_signal(signal.SIGTERM)
        outputs = [process.communicate(timeout=60)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()
            process.stdout.close()
    assert [process.returncode for process in processes] == [0, 0]
    for stack in stacks:
        assert {(one.robot0_keyframe_id, one.robot1_keyframe_id) for one in stack.matches} == expected
        assert {(one.robot0_id, one.robot1_id) for one in stack.matches} == {(0, 1)}
        assert {one.weight for one in stack.matches} == {float(np.float32(0.9))}
        assert all(one.success for one in stack.closures)
        assert stack.written == {"rt/cslam/inter_robot_matches", "rt/cslam/inter_robot_loop_closure"}
    for stack, turned in zip(
        stacks, (1, -1), strict=True
    ):  # both see it from alice: one of them turned it round
        sines = [one.transform.rotation.z for one in stack.closures]
        np.testing.assert_allclose(sines, turned * np.sin(0.25))
    report = json.loads(outputs[0].splitlines()[-1])
    assert report["counts"]["added"] == len(a) and report["matches"]["bob"] == {"verified": len(expected)}
