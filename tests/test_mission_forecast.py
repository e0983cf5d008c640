"""What a mission's plan foresees: every robot's tapes to the byte, and what all of it takes."""

import json
from dataclasses import replace

import pytest
from mission_helpers import COUPLE, TEAM, plan

from dealer import cli, folders
from dealer.gallery_plan import Seconds
from dealer.team import forecast as forecasts
from dealer.team.deal import deal_team
from dealer.team.forecast import forecast
from dealer.team.tasks import size_of, tasks_of
from protocols import memory


@pytest.fixture
def untimed(monkeypatch):
    """Times of a machine that takes a second a pair, and nothing else."""
    usual = forecasts.gallery_cost

    def cost(*arguments, timed):
        return replace(usual(*arguments, timed=False), seconds=Seconds(0.0, 1.0, 0.0, 2.0) if timed else None)

    monkeypatch.setattr(forecasts, "gallery_cost", cost)


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_tapes_are_as_large_as_the_plan_says(tmp_path, untimed, security):
    mission = plan(tmp_path, f'security = "{security}"\n{TEAM}')
    cost = forecast(mission)
    dealt = deal_team(tmp_path / "m", mission, workers=1)
    assert {robot.name: robot.tape_bytes for robot in cost.robots} == {
        folder.name: size for folder, size in dealt.folders.items()
    }
    assert cost.tape_bytes == sum(dealt.folders.values())
    assert (cost.tasks, cost.pairs_of_slots) == (6, 3 * 18 + 3 * 5 + 18 * 5 + 3 * 16)


def test_every_gallery_is_timed_once_and_every_robot_is_told_its_own(tmp_path, untimed):
    mission = plan(tmp_path)
    cost = forecast(mission, workers=2)
    capacities = [size_of(mission, task).pairs for task in tasks_of(mission)]
    assert cost.core_seconds == sum(capacities)
    assert cost.dealing_seconds == max(max(capacities), sum(capacities) / 2)
    assert cost.workers == 2 and cost.dealing_memory > 0
    alice, bob, carol = cost.robots
    assert [robot.peers for robot in cost.robots] == [2, 2, 2]
    assert alice.matching_seconds == 2 * (3 * 18 + 3 * 5 + 2 * 16)
    assert bob.matching_seconds == 2 * (3 * 18 + 18 * 5 + 2 * 16)
    assert bob.tape_bytes > carol.tape_bytes and bob.bytes_sent > carol.bytes_sent > 0
    assert cost.galleries["both"].slots == (18, 5)  # the largest


def test_a_single_task_takes_one_worker(tmp_path, untimed):
    cost = forecast(plan(tmp_path, COUPLE), workers=7)
    assert cost.workers == 1 and cost.dealing_seconds == cost.core_seconds


def test_the_command_shows_a_plan_and_writes_nothing(tmp_path, capsys):
    plan(tmp_path)
    assert cli.main([str(tmp_path / "mission.toml"), "--plan"]) == 0
    told = capsys.readouterr().out
    assert "3 robots, 3 pairs of them, 6 galleries, 207 pairs of slots" in told
    assert "sonar: sonar S6 <= 0.5 (2 turns), to 2^-16; a slot has 8 numbers" in told
    assert "both: all of lidar S10 >= 0.5, camera S10 >= 0.5, to 2^-16; a slot has 10 numbers" in told
    assert all(f"  {name} " in told for name in ("alice", "bob", "carol"))
    assert [path.name for path in tmp_path.iterdir()] == ["mission.toml"]


def test_large_teams_are_shown_by_their_extremes(tmp_path, untimed, capsys):
    names = [f"robot{number:02d}" for number in range(20)]
    agents = ", ".join(f'{{ name = "{name}" }}' for name in names)
    text = f"agents = [{agents}]\n{COUPLE.partition(chr(10))[2]}"
    plan(tmp_path, text.replace("keyframes = 2", "keyframes = 5000"))
    assert cli.main([str(tmp_path / "mission.toml"), "--plan"]) == 0
    told = capsys.readouterr().out
    assert "190 pairs of them" in told and "(those with the least and the most of 20)" in told
    assert told.count("\n") < 18


def test_a_plan_is_one_json_object(tmp_path, capsys):
    mission = plan(tmp_path)
    assert cli.main([str(tmp_path / "mission.toml"), "--plan", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["digest"] == mission.digest and told["pairs"] == 3 and told["tasks"] == 6
    assert [robot["name"] for robot in told["robots"]] == ["alice", "bob", "carol"]
    assert (
        told["galleries"]["both"]["rule"] == "all" and told["galleries"]["both"]["seconds"]["deal_pair"] > 0
    )
    assert told["dealing_seconds"] > 0 and told["core_seconds"] > 0
    assert told["free_memory"] > 0 and told["free_disk"] > 0 and told["refusal"] is None


@pytest.mark.parametrize(
    ("module", "name", "there", "says"),
    [
        (memory, "available_memory", lambda: 10**7, "dealing needs about 33.6 MB of memory, and 10 MB are"),
        (folders.shutil, "disk_usage", lambda path: (10**6, 0, 1000), "60.3 kB and 1 kB are free in"),
    ],
)
def test_a_plan_says_that_dealing_would_be_refused(
    tmp_path, untimed, capsys, monkeypatch, module, name, there, says
):
    plan(tmp_path, COUPLE)
    command = [str(tmp_path / "mission.toml"), "--plan", "--out", str(tmp_path / "m")]
    assert cli.main(command) == 0
    told = capsys.readouterr().out
    assert "of the disk are free\n" in told and "refused" not in told
    assert "1 pair of them, 1 gallery, 4 pairs of slots" in told and "with 1 worker here" in told
    monkeypatch.setattr(module, name, there)
    assert cli.main(command) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "would be refused here" in line)
    assert says in line and not (tmp_path / "m").exists()
