"""Agents that bring several descriptors a place: turns, and two sensors with one bit for both."""

from pathlib import Path

import numpy as np
import pytest
from agent_helpers import deal, found, news, places, robots, until

PLAN = """
[[agents]]
name = "alice"

[[agents]]
name = "bob"

[descriptors.lidar]
score = "S10"
dim = 12
threshold = 0.8
keyframes = 16
turns = 4

[descriptors.camera]
score = "S6"
dim = 8
threshold = 0.2
keyframes = 16

[places.everywhere]
of = ["lidar", "camera"]
rule = "{rule}"
"""


def turned(vector: np.ndarray) -> np.ndarray:
    """A vector of 12 sectors in its four quarter turns."""
    return np.stack([np.roll(vector, 3 * turn) for turn in range(4)])


@pytest.mark.parametrize(("rule", "expected"), [("any", {(0, 0), (1, 1), (2, 2)}), ("all", {(0, 0)})])
def test_a_place_of_turns_and_two_sensors_is_one_match(
    tmp_path: Path, rule: str, expected: set[tuple[int, int]]
) -> None:
    mission = deal(tmp_path, PLAN.format(rule=rule))
    lidar, camera, others = places(4, 12, seed=1), places(4, 8, seed=2), places(4, 8, seed=3)
    alice, bob = robots(mission)
    with alice, bob:
        for number in range(4):
            alice.add(number, {"lidar": turned(lidar[number]), "camera": camera[number]})
        # Bob sees place 0 with both, 1 with the lidar alone and turned, 2 with the camera alone, 3 with none.
        seen = [
            (np.roll(lidar[0], 6), camera[0]),
            (np.roll(lidar[1], 3), others[1]),
            (-lidar[2], camera[2]),
            (-lidar[3], others[3]),
        ]
        for number, (scan, image) in enumerate(seen):
            bob.add(number, {"lidar": turned(scan), "camera": image})
        for agent in (alice, bob):
            until(lambda agent=agent: agent.status()["galleries"][0]["pairs"] == 16)
            until(lambda agent=agent: found(agent, "verified") == expected)
        assert {match.gallery for match in news(alice)} == {"everywhere"}


def test_a_place_needs_all_of_its_descriptors_and_names_the_bad_one(tmp_path: Path) -> None:
    mission = deal(tmp_path, PLAN.format(rule="any"))
    alice, bob = robots(mission)
    good = {"lidar": turned(places(1, 12, seed=1)[0]), "camera": places(1, 8, seed=2)[0]}
    with alice, bob:
        with pytest.raises(
            ValueError, match="keyframe 1: it can be compared with nothing: everywhere needs camera"
        ):
            alice.add(1, {"lidar": good["lidar"]})
        with pytest.raises(ValueError, match=r"keyframe 1: lidar: expected an array of shape \(4, 12\)"):
            alice.add(1, {**good, "lidar": good["lidar"][0]})
        with pytest.raises(ValueError, match=r"keyframe 1: .*camera"):
            alice.add(1, {**good, "camera": 2 * good["camera"]})
        alice.add(1, good)
