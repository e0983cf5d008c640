"""Missions dealt in a moment, and what agents of them are fed with."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dealer.gallery import deal_gallery
from dealer.pki import MissionAuthority, write_credentials
from protocols.agent import Agent, Match, Meeting, Verdict
from protocols.mission import Mission
from protocols.mission.folder import plan_file, tape_name
from spdz.foundations.types import FloatArray

PLAN = """
security = "{security}"

[[agents]]
name = "alice"

[[agents]]
name = "bob"
{more}
[descriptors.lidar]
score = "{score}"
dim = {dim}
threshold = {threshold}
keyframes = {keyframes}

[budgets]
strikes = {strikes}
pairs_per_minute = {pairs}
matches_per_minute = {matches}
"""


def deal(folder: Path, text: str) -> Path:
    """Deal a plan into ``folder/mission``; returns that."""
    folder.mkdir(parents=True, exist_ok=True)
    file, out = folder / "mission.toml", folder / "mission"
    file.write_text(text)
    mission, run = Mission.load(file), secrets.token_hex(16)
    authority = MissionAuthority()
    for agent in mission.agents:
        write_credentials(out / agent.name, authority.credentials(agent.name))
        (out / agent.name / "plan.json").write_bytes(plan_file(mission, agent.name, run))
    for first, second in mission.pairs:
        for gallery in mission.galleries:
            paths = (
                out / first / tape_name(second, gallery.name),
                out / second / tape_name(first, gallery.name),
            )
            deal_gallery(
                paths,
                (first, second),
                gallery.terms(mission.security),
                gallery.slots((first, second)),
                mission=run,
                description=gallery.description(),
            )
    return out


def plan(
    *,
    security: str = "malicious",
    score: str = "S10",
    dim: int = 16,
    threshold: float = 0.8,
    keyframes: int = 48,
    strikes: int = 3,
    pairs: int = 1_000_000,
    matches: int = 60,
    more: str = "",
) -> str:
    """The text of a plan for alice and bob, and whoever ``more`` names."""
    return PLAN.format(**locals())


def robots(folder: Path, **options: Any) -> tuple[Agent, Agent]:
    """Alice's and Bob's agent of a dealt mission, on loopback."""
    alice = Agent(folder / "alice", listen="127.0.0.1:0", state_dir=folder / "alice" / "state", **options)
    bob = bobs(folder, alice, **options)
    return alice, bob


def bobs(folder: Path, alice: Agent, **options: Any) -> Agent:
    """Bob's agent, who knows where Alice listens."""
    peers = {"alice": alice.addresses[0]}
    return Agent(folder / "bob", peers=peers, state_dir=folder / "bob" / "state", **options)


def places(count: int, dim: int, seed: int) -> FloatArray:
    """Unit vectors, shape (count, dim)."""
    vectors = np.random.default_rng(seed).standard_normal((count, dim))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def near(vectors: FloatArray, seed: int, noise: float = 0.1) -> FloatArray:
    """Unit vectors beside others."""
    others = vectors + noise * places(len(vectors), vectors.shape[1], seed)
    return np.asarray(others / np.linalg.norm(others, axis=1, keepdims=True))


def until(condition: Callable[[], object], seconds: float = 30.0) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.01)


def found(agent: Agent, state: str = "candidate") -> set[tuple[int, int | None]]:
    """Keyframes of all matches that reached a state: own, the peer's."""
    return {(match.keyframe, match.peer_keyframe) for match in news(agent) if match.state == state}


def news(agent: Agent) -> list[Match]:
    """All news of matches, without reading them."""
    return agent._news.after(0)


def payload_of(robot: str, keyframe: int) -> bytes:
    """What the tests' robots show of a keyframe."""
    return f"{robot} {keyframe}".encode()


def honest(meeting: Meeting) -> Verdict:
    """A verification that looks at who shows what."""
    good = meeting.other.payload == payload_of(meeting.peer, meeting.other.id)
    return Verdict(good, "" if good else "another payload", (1.0, 2.0, 0.5), 0.9)


def feed(agent: Agent, first: int, vectors: FloatArray, name: str = "lidar") -> None:
    """Give an agent keyframes numbered from ``first`` on."""
    for number, vector in enumerate(vectors, first):
        agent.add(number, {name: vector}, payload_of(agent.robot, number), float(number))
