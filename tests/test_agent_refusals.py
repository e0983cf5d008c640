"""What an agent refuses, of its user and of its peers, and that it goes on."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_helpers import bobs, deal, feed, found, honest, news, places, plan, robots, until

from protocols.agent import Agent, Event, Meeting, RecordsError, Verdict, turns
from spdz import MacCheckFailed

UNIT = np.eye(16)[0]


@pytest.fixture
def alice(tmp_path: Path) -> Iterator[Agent]:
    mission = deal(tmp_path, plan())
    with Agent(mission / "alice", listen="127.0.0.1:0", state_dir=tmp_path / "a") as agent:
        yield agent


BAD: list[tuple[dict[str, Any], str]] = [
    ({"descriptors": {"lidar": np.full(16, np.nan)}}, "keyframe 1: .*lidar"),
    ({"descriptors": {"lidar": np.full(16, np.inf)}}, "keyframe 1: .*lidar"),
    ({"descriptors": {"lidar": UNIT * 1.1}}, "keyframe 1: .*lidar"),
    ({"descriptors": {"lidar": UNIT[:8]}}, r"keyframe 1: .*shape \(16,\)"),
    ({"descriptors": {"lidar": "near the door"}}, "keyframe 1: .*lidar"),
    ({"descriptors": {"camera": UNIT}}, "keyframe 1: the plan has no descriptor 'camera'; it has lidar"),
    ({"descriptors": {}}, "keyframe 1: it can be compared with nothing: lidar needs lidar"),
    ({"keyframe": -1}, "an integer from 0"),
    ({"keyframe": True}, "an integer from 0"),
    ({"payload": b"x" * ((8 << 20) + 1)}, "a payload is at most 8 MiB"),
    ({"payload": "text"}, "keyframe 1: a payload is bytes, not str"),
    ({"descriptors": UNIT}, "keyframe 1: descriptors are given by name"),
    ({"stamp": np.nan}, "stamp"),
    ({"stamp": 10**400}, "stamp"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_a_bad_keyframe_is_refused_by_name_and_the_next_one_is_taken(
    alice: Agent, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        alice.add(**{"keyframe": 1, "descriptors": {"lidar": UNIT}, **change})
    alice.add(1, {"lidar": UNIT})
    assert alice.status()["galleries"][0]["keyframes"] == 1


def test_a_keyframe_s_number_is_for_ever(alice: Agent) -> None:
    alice.add(1, {"lidar": UNIT}, b"scan")
    alice.add(1, {"lidar": UNIT}, b"scan")
    with pytest.raises(ValueError, match="keyframe 1 already"):
        alice.add(1, {"lidar": -UNIT}, b"scan")
    with pytest.raises(ValueError, match="keyframe 1 already"):
        alice.add(1, {"lidar": UNIT}, b"another")
    assert alice.status()["galleries"][0]["keyframes"] == 1


def test_nothing_secret_is_in_what_can_be_printed(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    vector = places(1, 16, seed=5)
    events: list[Event] = []
    alice, bob = robots(mission, verify=honest, on_event=events.append)
    with alice, bob:
        feed(alice, 0, vector)
        feed(bob, 0, vector)
        until(lambda: found(alice, "verified") and found(bob, "verified"))
        shown = repr([events, alice, alice.status(), news(alice), alice._desk.keyframes.get(0, "lidar")])
    assert "alice 0" not in shown and f"{vector[0, 0]:.6f}" not in shown


def test_three_strikes_stop_a_peer_until_it_is_forgiven(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(8, 16, seed=1)
    accepted = [False]

    def verify(meeting: Meeting) -> Verdict:
        return Verdict(accepted[0], "another place")

    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=verify, state_dir=tmp_path / "a")
    with alice, bobs(mission, alice) as bob:
        for i in range(4):
            feed(alice, i, a[i : i + 1])
            feed(bob, i, a[i : i + 1])
            until(
                lambda i=i: (
                    len(found(alice, "rejected")) == i + 1 or alice.status()["galleries"][0]["strikes"] == 3
                )
            )
        until(lambda: alice.status()["galleries"][0]["why"]["code"] == "stopped")
        assert len(found(alice, "rejected")) == 3
        assert "another place" in alice.status()["galleries"][0]["why"]["text"]
        accepted[0] = True
        assert alice.forgive("bob") == 3
        until(lambda: found(alice, "verified") == {(3, 3)})


def test_a_peer_that_does_not_show_its_half_gets_a_strike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = deal(tmp_path, plan())
    a = places(1, 16, seed=1)
    honest_pairs = turns.show

    def withhold(session: Any, wanted: Any, true: Any, *rest: Any) -> Any:
        return honest_pairs(session, wanted, true if session.party == 0 else set(), *rest)

    monkeypatch.setattr(turns, "show", withhold)
    alice, bob = robots(mission, grace=1.5)
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: found(alice, "withheld") == {(0, None)})
        assert alice.status()["galleries"][0]["strikes"] == 1
        assert alice.status()["galleries"][0]["why"]["code"] == "withheld"
        monkeypatch.setattr(turns, "show", honest_pairs)
        until(lambda: found(alice, "verified") == {(0, 0)})  # late, and no strike any more
        assert alice.status()["galleries"][0]["strikes"] == 0


def test_a_verification_that_raises_rejects_that_match_alone(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(2, 16, seed=1)

    def verify(meeting: Meeting) -> Verdict:
        if meeting.own.id == 0:
            raise ZeroDivisionError("oops")
        return Verdict(True)

    alice, bob = robots(mission, verify=verify)
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: found(alice, "verified") == {(1, 1)} and found(alice, "rejected") == {(0, 0)})
        (why,) = {match.why for match in news(alice) if match.state == "rejected"}
    assert why == "the verification raised ZeroDivisionError: oops"


def test_a_failed_mac_check_stops_the_peer_in_all_galleries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = deal(tmp_path, plan())
    take = turns.Turns.take

    def cheated(self: turns.Turns, session: Any) -> bool:
        if self._desk.robot == "alice":
            raise MacCheckFailed("an opened value does not carry a valid MAC")
        return take(self, session)

    monkeypatch.setattr(turns.Turns, "take", cheated)
    alice, bob = robots(mission)
    with alice, bob:
        until(lambda: alice.status()["galleries"][0]["state"] == "destroyed")
        until(lambda: alice.status()["galleries"][0]["strikes"] == 3)
        assert alice.status()["galleries"][0]["why"]["code"] == "destroyed"


def test_true_and_false_are_verdicts(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(2, 16, seed=1)
    alice, bob = robots(mission, verify=lambda meeting: np.bool_(meeting.own.id == 1))
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: found(alice, "verified") == {(1, 1)} and found(alice, "rejected") == {(0, 0)})


def test_a_peer_that_is_stopped_is_told_so_and_an_agent_can_begin_with_forgiving_it(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan(strikes=1))
    a, events = places(1, 16, seed=1), list[str]()
    alice = Agent(
        mission / "alice", listen="127.0.0.1:0", verify=lambda meeting: False, state_dir=tmp_path / "a"
    )
    bob = bobs(mission, alice, on_event=lambda event: events.append(event.text))
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: any("alice has stopped with this robot" in text for text in events))
        until(lambda: "alice says rejected: lidar keyframe 0" in events)
        alice.close()
        again: list[Event] = []
        with Agent(mission / "alice", forgive=["bob"], listen="127.0.0.1:0", on_event=again.append) as alice:
            assert alice.status()["galleries"][0]["strikes"] == 0
            assert not any(event.name == "stopped" for event in again)
        with pytest.raises(ValueError, match="'carol' is no peer of alice"):
            Agent(mission / "alice", forgive=["carol"], listen="127.0.0.1:0")


def test_a_budget_of_pairs_is_kept_and_told(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan(pairs=20))
    events: list[Event] = []
    alice, bob = robots(mission, on_event=events.append)
    with alice, bob:
        feed(alice, 0, places(12, 16, seed=1))
        feed(bob, 0, places(12, 16, seed=2))
        until(lambda: any(event.name == "budget" and event.peer == "bob" for event in events))
        until(lambda: alice.status()["galleries"][0]["why"]["code"] == "budget-spent")
        assert 0 < alice.status()["galleries"][0]["pairs"] <= 20


def test_a_peer_of_another_mission_is_told_on_both_sides(tmp_path: Path) -> None:
    mission, other = deal(tmp_path / "one", plan()), deal(tmp_path / "two", plan())
    events: dict[str, list[str]] = {"alice": [], "bob": []}
    with Agent(
        mission / "alice",
        listen="127.0.0.1:0",
        state_dir=tmp_path / "a",
        on_event=lambda event: events["alice"].append(event.text),
    ) as alice:
        peers = {"alice": alice.addresses[0]}
        bob = Agent(
            other / "bob",
            peers=peers,
            state_dir=tmp_path / "b",
            on_event=lambda event: events["bob"].append(event.text),
        )
        with bob:
            until(lambda: any("dealer run" in text or "dealer?" in text for text in events["alice"]))
            until(lambda: any("dealer" in text for text in events["bob"]))


def test_records_of_another_mission_are_refused(tmp_path: Path) -> None:
    mission, other = deal(tmp_path / "one", plan()), deal(tmp_path / "two", plan())
    Agent(mission / "alice", listen="127.0.0.1:0").close()
    (other / "alice" / "agent.db").write_bytes((mission / "alice" / "agent.db").read_bytes())
    with pytest.raises(RecordsError, match="of another mission"):
        Agent(other / "alice", listen="127.0.0.1:0")


def test_two_agents_do_not_share_a_folder(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    with Agent(mission / "alice", listen="127.0.0.1:0", state_dir=tmp_path / "a"):
        with pytest.raises(RecordsError, match="another agent works in"):
            Agent(mission / "alice", listen="127.0.0.1:0", state_dir=tmp_path / "a")


def test_a_damaged_record_file_is_refused(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    (mission / "alice" / "agent.db").write_bytes(b"no data base" * 400)
    with pytest.raises(RecordsError, match="cannot be used"):
        Agent(mission / "alice", listen="127.0.0.1:0")


def test_addresses_of_the_wrong_robots_are_refused(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    with pytest.raises(ValueError, match="no peer of alice"):
        Agent(mission / "alice", peers={"carol": "127.0.0.1:9"}, listen="127.0.0.1:0")
    with pytest.raises(ValueError, match="bob calls alice"):
        Agent(mission / "alice", peers={"bob": "127.0.0.1:9"}, listen="127.0.0.1:0")


def test_why_nothing_matched(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())

    def code(agent: Agent) -> str:
        return str(agent.status()["galleries"][0]["why"]["code"])

    alice = Agent(mission / "alice", listen="127.0.0.1:0", state_dir=tmp_path / "a")
    with alice:
        until(lambda: code(alice) == "no-keyframes")
        feed(alice, 0, places(1, 16, seed=1))
        until(lambda: code(alice) == "peer-absent")
        with bobs(mission, alice) as bob:
            until(lambda: code(alice) == "no-peer-keyframes")
            feed(bob, 0, places(1, 16, seed=2))
            until(lambda: code(alice) == "below-threshold")


@pytest.mark.parametrize(("security", "told"), [("malicious", 0), ("semi-honest", 1)])
def test_a_semi_honest_mission_is_told_to_be_one(tmp_path: Path, security: str, told: int) -> None:
    events: list[Event] = []
    mission = deal(tmp_path, plan(security=security))
    Agent(mission / "alice", listen="127.0.0.1:0", on_event=events.append).close()
    assert sum("semi-honest" in event.text for event in events) == told
