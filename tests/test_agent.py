"""Two and three agents: what they find, and that they find it once."""

import asyncio
from pathlib import Path

import numpy as np
import pytest
from agent_helpers import bobs, deal, feed, found, honest, near, news, places, plan, robots, until

from protocols.agent import Agent, AsyncAgent, Verdict

CAROL = '\n[[agents]]\nname = "carol"\n'


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_both_robots_verify_the_pairs_that_the_clear_computation_finds(tmp_path: Path, security: str) -> None:
    mission = deal(tmp_path, plan(security=security))
    a = places(12, 16, seed=1)
    b = np.concatenate([near(a[3:8], seed=2, noise=0.4), places(6, 16, seed=3)])
    expected = {(100 + i, 200 + j) for i, j in np.argwhere(a @ b.T >= 0.8)}
    alice, bob = robots(mission, verify=honest)
    with alice, bob:
        feed(alice, 100, a)
        feed(bob, 200, b)
        until(lambda: len(found(alice, "verified")) == len(found(bob, "verified")) == len(expected))
        assert found(alice, "verified") == expected
        assert found(bob, "verified") == {(j, i) for i, j in expected}


def test_keyframes_that_come_one_by_one_are_matched_as_they_come(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(6, 16, seed=1)
    alice, bob = robots(mission, verify=honest)
    with alice, bob:
        for i, vector in enumerate(a):
            alice.add(i, {"lidar": vector}, b"alice %d" % i)
            bob.add(i, {"lidar": vector}, b"bob %d" % i)
            until(lambda i=i: (i, i) in found(alice, "verified") and (i, i) in found(bob, "verified"))


def test_a_place_that_was_seen_twice_is_shown_once_and_matched_twice(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(1, 16, seed=1)
    alice, bob = robots(mission, verify=honest)
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: (0, 0) in found(alice, "verified") and (0, 0) in found(bob, "verified"))
        feed(bob, 1, near(a, seed=2))  # Bob has seen Alice's half already
        until(lambda: (0, 1) in found(alice, "verified") and (1, 0) in found(bob, "verified"))


def test_three_robots_match_pair_by_pair(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan(more=CAROL))
    shared = places(3, 16, seed=1)
    alice, bob = robots(mission, verify=honest)
    with alice, bob:
        peers = {"alice": alice.addresses[0], "bob": bob.addresses[0]}
        with Agent(mission / "carol", peers=peers, verify=honest, state_dir=tmp_path / "s") as carol:
            for agent in (alice, bob, carol):
                feed(agent, 0, shared)
            both = {(i, i) for i in range(3)}
            for agent in (alice, bob, carol):
                until(lambda agent=agent: len(news(agent)) == 12)
                assert found(agent, "verified") == both


def test_a_match_is_news_once_over_restarts(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(4, 16, seed=1)
    alice, bob = robots(mission, verify=honest)
    with bob:
        with alice:
            feed(alice, 0, a[:2])
            feed(bob, 0, a)
            until(lambda: len(found(alice, "verified")) == 2)
            first = list(alice.matches(0.0))
        listen = bob._reaching._addresses["alice"]
        with Agent(
            mission / "alice", listen=listen, verify=honest, state_dir=mission / "alice/state"
        ) as again:
            feed(again, 0, a)  # the first two are known
            until(lambda: len(found(again, "verified")) == 4)
            second = list(again.matches(0.0))
    numbers = [match.number for match in first + second]
    assert numbers == sorted(set(numbers)) == list(range(1, 9))
    assert {match.keyframe for match in second} == {2, 3}


def test_what_was_not_read_before_a_restart_comes_after_it(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(2, 16, seed=1)
    alice, bob = robots(mission)
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: len(found(alice, "verified")) == len(found(bob, "verified")) == 2)
        seen = next(bob.matches(0.0))
        bob.close()
        with bobs(mission, alice) as again:
            rest = list(again.matches(0.0))
    assert seen.number == 1 and [match.number for match in rest] == [1, 2, 3, 4]


def test_verdicts_are_told_to_both(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(1, 16, seed=1)
    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=honest, state_dir=tmp_path / "a")
    with alice, bobs(mission, alice, verify=lambda meeting: Verdict(False, "no")) as bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: [match.peer_state for match in news(alice)][-1:] == ["rejected"])
        until(lambda: [match.peer_state for match in news(bob)][-1:] == ["verified"])


def test_an_agent_on_asyncio(tmp_path: Path) -> None:
    mission = deal(tmp_path, plan())
    a = places(2, 16, seed=1)

    async def run() -> list[str]:
        states: list[str] = []
        alice = AsyncAgent(mission / "alice", listen="127.0.0.1:0", verify=honest, state_dir=tmp_path / "a")
        async with alice:
            peers = {"alice": alice.agent.addresses[0]}
            bob = AsyncAgent(mission / "bob", peers=peers, verify=honest, state_dir=tmp_path / "b")
            async with bob:
                for agent in (alice, bob):
                    await agent.add(1, {"lidar": a[0]}, f"{agent.agent.robot} 1".encode())
                async for match in bob.matches():
                    states.append(match.state)
                    if match.state == "verified":
                        break
        return states

    assert asyncio.run(run()) == ["candidate", "verified"]
