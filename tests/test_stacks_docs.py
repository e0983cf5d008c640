"""docs/swarm-slam.md: its node runs on stand-ins for ROS, its bag is replayed by two robots."""

import os
import re
import subprocess
import sys
import types
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from agent_helpers import deal, places, plan
from stack_helpers import News, cloud

pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

from bench.parties import free_port
from protocols.agent import Keyframe, Meeting
from protocols.stacks.codec import Codec
from protocols.stacks.messages import InterRobotLoopClosure, InterRobotMatches

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "swarm-slam.md").read_text(encoding="utf-8")


def blocks(heading, language):
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return re.findall(rf"^```{language}\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)


def stand_in(monkeypatch, **modules):
    """Put modules with these attributes where the page's code imports them from."""
    for name, attributes in modules.items():
        dotted = name.replace("__", ".")
        parts = dotted.split(".")
        for end in range(1, len(parts) + 1):
            parent = ".".join(parts[:end])
            if parent not in sys.modules:
                monkeypatch.setitem(sys.modules, parent, types.ModuleType(parent))
        module = types.ModuleType(dotted)
        vars(module).update(attributes)
        monkeypatch.setitem(sys.modules, dotted, module)
        if len(parts) > 1:
            monkeypatch.setattr(sys.modules[".".join(parts[:-1])], parts[-1], module, raising=False)


class Node:
    """What the page's node uses of rclpy's."""

    parameters: ClassVar[dict[str, str]] = {}

    def __init__(self, name):
        self.name, self.published, self.subscribed, self.warned = name, [], {}, []

    def declare_parameter(self, name, default):
        return types.SimpleNamespace(value=self.parameters[name])

    def get_logger(self):
        return types.SimpleNamespace(warning=self.warned.append)

    def create_subscription(self, kind, topic, callback, depth):
        assert depth == 100
        self.subscribed[topic] = callback

    def create_publisher(self, kind, topic, depth):
        assert depth == 100
        return types.SimpleNamespace(publish=lambda data: self.published.append((topic, data)))

    def create_timer(self, seconds, callback):
        self.timer = callback


@pytest.fixture
def ros(monkeypatch):
    named = {
        name: type(name, (), {})
        for name in ("InterRobotLoopClosure", "InterRobotMatches", "KeyframePointCloud")
    }
    vectors = places(10, 16, seed=1)

    class ScanContext:
        def __init__(self, params, node):
            pass

        def compute_embedding(self, points):
            return 5.0 * vectors[points]

    stand_in(
        monkeypatch,
        rclpy={},
        rclpy__node={"Node": Node},
        rclpy__serialization={"serialize_message": lambda message: Codec().encode(message)},
        cslam_common_interfaces__msg=named,
        cslam__lidar_pr__icp_utils={"ros_pointcloud_to_points": lambda message: message.header.stamp.sec},
        cslam__lidar_pr__scancontext={"ScanContext": ScanContext},
        my_verification={"verify": lambda meeting: None},
    )
    return vectors


def test_the_node_is_a_front_end_in_40_lines(ros, tmp_path, monkeypatch):
    (code, _) = blocks("A node of 40 lines", "python")
    code_lines = [line for line in code.splitlines() if line.strip()]
    assert len(code_lines) <= 40
    mission = deal(tmp_path, plan())
    np.save(tmp_path / "mean.npy", np.zeros(16))
    monkeypatch.setattr(
        Node, "parameters", {"mission": str(mission / "alice"), "mean": str(tmp_path / "mean.npy")}
    )
    namespace = {"__name__": "page"}
    exec(compile(code, "swarm-slam.md", "exec"), namespace)
    node = namespace["PrivateDetection"]()
    with node.agent:
        node.subscribed["cslam/keyframe_data"](cloud(3))
        (gallery,) = node.agent.status()["galleries"]
        assert gallery["keyframes"] == 1 and node.warned == []
        monkeypatch.setattr(node.agent, "matches", lambda timeout: [News(1, 1, transform=(1.0, 2.0, 0.5))])
        node.timer()
    (first, matches), (second, closure) = node.published
    assert (first, second) == ("/cslam/inter_robot_matches", "/cslam/inter_robot_loop_closure")
    assert Codec().decode(InterRobotMatches, matches).matches[0].robot1_keyframe_id == 5
    assert Codec().decode(InterRobotLoopClosure, closure).success


def test_the_verification_reads_both_keyframes():
    (_, code) = blocks("A node of 40 lines", "python")
    seen = []

    def register(own, other):
        seen.extend([own.header.stamp.sec, other.header.stamp.sec])
        return (0, 0, 0, 0, 0, 0, 1), 0.9

    namespace = {"register": register}
    exec(compile(code, "swarm-slam.md", "exec"), namespace)
    sides = [Keyframe(number, None, Codec().encode(cloud(number))) for number in (3, 5)]
    verdict = namespace["verify"](Meeting("bob", "lidar", *sides))
    assert verdict.accepted and verdict.weight == 0.9 and seen == [3, 5]


def test_the_launch_file_starts_the_command_as_it_is(monkeypatch):
    (code,) = blocks("A process of its own", "python")

    class Action:
        def __init__(self, *words, **more):
            self.words, self.more = words, more

    stand_in(
        monkeypatch,
        launch={"LaunchDescription": lambda actions: actions},
        launch__actions={"ExecuteProcess": Action, "SetEnvironmentVariable": Action},
        launch_ros__actions={"Node": Action},
    )
    namespace = {}
    exec(compile(code, "swarm-slam.md", "exec"), namespace)
    command = namespace["generate_launch_description"]()[-1].more["cmd"]
    from spdz.__main__ import parser

    options = parser().parse_args(command[3:])
    assert options.namespace == "/r0" and options.payload == "KeyframePointCloud" and options.normalise


@pytest.mark.timeout(200)
def test_the_bag_is_made_and_replayed_as_the_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,), (commands,) = (
        blocks("From a bag, without ROS", "python"),
        blocks("From a bag, without ROS", "bash"),
    )
    exec(compile(code.replace("9000", str(free_port())), "swarm-slam.md", "exec"), {})
    deal_it, *robots = [[sys.executable, *line.split()[1:]] for line in commands.splitlines()]
    path = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(deal_it, check=True, timeout=100, capture_output=True, env=path)
    running = [subprocess.Popen(robot, stdout=subprocess.PIPE, text=True, env=path) for robot in robots]
    try:
        outputs = [process.communicate(timeout=100)[0] for process in running]
    finally:
        for process in running:
            process.kill()
            process.wait()
            process.stdout.close()
    (shown,) = [block for block in blocks("From a bag, without ROS", "") if "verified" in block]
    assert outputs[0].startswith("candidate: ") and outputs[0].endswith(shown)
    assert "verified: cosplace keyframe 2 and alice's 4" in outputs[1]
