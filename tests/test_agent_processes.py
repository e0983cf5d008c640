"""``python -m spdz agent`` as processes: killed, fed with rubbish, and told apart from others."""

import base64
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_helpers import deal, places, plan, until

from bench.agents.process import Robot
from bench.parties import free_port


def two(folder: Path, **options: Any) -> Path:
    """A mission whose robots find each other by the plan."""
    text = plan(**options)
    for name in ("alice", "bob"):
        text = text.replace(f'name = "{name}"', f'name = "{name}"\naddress = "127.0.0.1:{free_port()}"')
    return deal(folder, text)


def agent(mission: Path, name: str, *more: str, lines: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "spdz", "agent", "--mission", str(mission / name)]
    command += ["--state-dir", str(mission / name / "state"), *more]
    return subprocess.run(command, input=lines, capture_output=True, text=True, timeout=60, check=False)


def test_a_robot_that_is_killed_again_and_again_loses_and_repeats_no_match(tmp_path: Path) -> None:
    mission = two(tmp_path, keyframes=32)
    shared = places(16, 16, seed=1)
    alice, bob = (Robot(mission / name, shared, "lidar") for name in ("alice", "bob"))
    alice.start()
    bob.start()
    try:
        for number in range(16):
            for robot in (alice, bob):
                robot.bring(number)
            if number in (3, 8, 12):
                until(lambda number=number: len(alice.heard.matches) > number // 2)
                bob.kill()
                bob.start()
        for robot in (alice, bob):
            until(lambda robot=robot: len(robot.heard.matches) == 16)
    finally:
        statuses = [robot.stop() for robot in (alice, bob)]
    assert statuses == [0, 0]
    for robot in (alice, bob):
        assert {(own, theirs) for own, _, theirs in robot.heard.matches.values()} == {
            (i, i) for i in range(16)
        }
        assert sorted(set(robot.heard.numbers)) == list(range(1, 33))
    assert len(alice.heard.numbers) == 32  # who was not killed says everything once


def test_rubbish_on_standard_input_is_named_and_the_rest_is_taken(tmp_path: Path) -> None:
    mission = two(tmp_path)
    unit = np.eye(16)[0].tolist()
    lines = [
        "rubbish",
        json.dumps({"keyframe": 1, "descriptors": {"lidar": [float("nan")] * 16}}),
        json.dumps(
            {"keyframe": 2, "descriptors": {"lidar": unit}, "payload": base64.b64encode(b"x").decode()}
        ),
    ]
    done = agent(mission, "alice", "--stdin", "--json", "--for", "1", lines="\n".join(lines))
    events = [json.loads(line) for line in done.stdout.splitlines()]
    refused = [event["text"] for event in events if event["event"] == "refused"]
    assert done.returncode == 0
    assert refused[0].startswith("line 1 is left out: a line is not JSON")
    assert refused[1].startswith("line 2 is left out: keyframe 1: ")
    assert [event["code"] for event in events if event["event"] == "why"] == ["peer-absent"]


def test_a_folder_is_watched_and_metrics_are_written(tmp_path: Path) -> None:
    mission, watched, metrics = two(tmp_path), tmp_path / "in", tmp_path / "metrics.prom"
    watched.mkdir()
    np.savez(watched / "5.npz", lidar=np.eye(16)[0])
    more = ("--watch", str(watched), "--metrics", str(metrics), "--for", "3")
    assert agent(mission, "alice", *more).returncode == 0
    labels = 'robot="alice",peer="bob",gallery="lidar"'
    assert f"spdz_keyframes{{{labels}}} 1" in metrics.read_text().splitlines()


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (("--verify", "nowhere:nothing"), "--verify nowhere:nothing: No module named 'nowhere'"),
        (("--verify", "math:pi"), "--verify math:pi is not a function"),
        (("--peer", "bob"), "--peer is NAME=HOST:PORT"),
        (("--listen", "nowhere"), "nowhere"),
        (("--forgive", "carol"), "no peer of alice"),
        (("--grace", "-1"), "grace is a positive number of seconds"),
        (("--until-quiet", "0"), "--until-quiet takes a positive number of seconds, not 0"),
    ],
)
def test_bad_arguments_are_one_sentence(tmp_path: Path, more: tuple[str, ...], sentence: str) -> None:
    done = agent(two(tmp_path), "alice", *more, "--for", "1")
    assert done.returncode == 2
    assert sentence in done.stderr and "Traceback" not in done.stderr


def test_a_folder_that_is_none_is_one_sentence(tmp_path: Path) -> None:
    done = agent(tmp_path, "nobody")
    assert done.returncode == 2 and "is no folder" in done.stderr and "Traceback" not in done.stderr
