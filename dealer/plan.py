"""What a mission will cost with one tile or another, before anything is dealt.

Jobs, rounds, bytes sent and bytes on the disk are exact; memory and times are estimates. A tile is picked by
what a radio link that may break and a disk have to carry.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dealer.limits import check_job, dealing_memory
from dealer.randomness import random_mac_key
from dealer.recipe import deal_job
from dealer.tapes import tape_bytes
from dealer.words import in_seconds
from protocols.batching import DEALT_BYTES
from protocols.catalog import Purpose
from protocols.costs import bytes_sent, job_cost, matching_memory, most_jobs_lost, rounds
from protocols.memory import in_bytes
from spdz.foundations.types import Security
from spdz.readings.meter import Plan, measure

LINK_BYTES, LINK_ROUND = 2.5e6, 0.005
"""A link to pick tiles for: bytes a second for both robots together, and seconds a round."""

ROBOT_MEMORY = 10**9
"""Memory that a robot should not need more of for a picked tile, in bytes."""

_NEARLY = 1.05  # times on the link that do not matter
_ROW = 64  # descriptors of a map that one new descriptor meets in a job
_TIMED_BYTES = 32 << 20  # jobs above this are not dealt for timing
_TIMED_SECONDS = 0.05
_ABSURD_PAIR = 8_000_000  # bytes a pair, from which on S1 and S2 come with a warning


@dataclass(frozen=True, slots=True)
class TilePlan:
    """What one pair of robots needs with one tile. Pairs are (party 0, party 1), the order of the names.

    A meeting is one ``match`` of both maps; where comparisons were counted, one ``match`` of them all.

    Attributes:
        tile: Descriptors of either robot in a job.
        jobs: Jobs to deal in all: of every meeting, and the spare ones.
        comparisons: Comparisons in these jobs, those that fill up border tiles included.
        meeting_jobs: Jobs of one meeting that nothing interrupts.
        spare_jobs: Jobs to deal beyond all meetings, for interruptions.
        lost_jobs: Jobs that one interruption costs at most.
        together: Jobs that ``match`` runs in the same rounds.
        rounds: Rounds of one meeting in one go.
        bytes_sent: What either robot sends then, frame headers included, TLS and TCP not.
        tape_bytes: Sizes of the tape files.
        job_bytes: What the larger tape stores for one job.
        dealing_memory: Bytes of memory to deal, an estimate.
        matching_memory: Bytes of memory to match, the needier robot's, an estimate.
        dealing_seconds: On this machine, writing to the disk not counted, extrapolated from single jobs;
            None where that was not asked for.
        link_seconds: Of rounds and bytes of one meeting on the link above.
    """

    tile: tuple[int, int]
    jobs: int
    comparisons: int
    meeting_jobs: int
    spare_jobs: int
    lost_jobs: int
    together: int
    rounds: int
    bytes_sent: tuple[int, int]
    tape_bytes: tuple[int, int]
    job_bytes: int
    dealing_memory: int
    matching_memory: int
    dealing_seconds: float | None
    link_seconds: float

    @property
    def interrupted_seconds(self) -> float:
        """Of one meeting on the link above with one interruption, at worst."""
        return self.link_seconds * (1 + self.lost_jobs / self.meeting_jobs)


@dataclass(frozen=True, slots=True)
class Impossible:
    """A tile that cannot be dealt, and why."""

    tile: tuple[int, int]
    reason: str


def jobs_for(maps: tuple[int, int], tile: tuple[int, int]) -> int:
    """Tiles that cover all pairs of two maps."""
    return -(-maps[0] // tile[0]) * -(-maps[1] // tile[1])


def candidate_tiles(maps: tuple[int, int]) -> list[tuple[int, int]]:
    """Tiles worth considering for maps of m and k descriptors, smallest first.

    Squares of 1, 2, 4, .. descriptors, cut so that the map is divided evenly and little is filled up; and one
    descriptor of either map against many of the other.
    """
    squares = [1 << power for power in range((max(maps) - 1).bit_length() + 1)]
    tiles = {(_even(maps[0], side), _even(maps[1], side)) for side in squares}
    tiles |= {(1, _even(maps[1], _ROW)), (_even(maps[0], _ROW), 1)}
    return sorted(tiles, key=lambda tile: (tile[0] * tile[1], tile))


def plan_tile(
    agents: Sequence[str],
    purpose: Purpose,
    jobs: int,
    maps: tuple[int, int] | None,
    security: Security,
    *,
    meetings: int = 1,
    interruptions: int = 0,
) -> TilePlan:
    """The plan for the tile of a purpose, without a time for dealing.

    Args:
        agents: The robots' names.
        purpose: What the tapes are for.
        jobs: Jobs of one meeting.
        maps: Descriptors of either robot; as many as one batch has if not given.
        security: The security model.
        meetings: How many times such maps meet.
        interruptions: How many there shall be room for, in all meetings together.

    Raises:
        ValueError: if such jobs cannot be dealt or sent, for no meeting, or fewer interruptions than none.
    """
    if meetings < 1 or interruptions < 0:
        raise ValueError("deal for at least one meeting, and for no fewer than 0 interruptions")
    cost = job_cost(purpose, security)
    check_job(cost.plan)
    sizes = maps or tuple(min(jobs, cost.together) * side for side in purpose.tile)
    sent, passed = bytes_sent(cost, jobs), rounds(cost, jobs)
    first, second = agents[:2]
    lost = most_jobs_lost(cost, jobs)
    dealt = meetings * jobs + interruptions * lost
    return TilePlan(
        tile=purpose.tile,
        jobs=dealt,
        comparisons=dealt * purpose.pairs,
        meeting_jobs=jobs,
        spare_jobs=interruptions * lost,
        lost_jobs=lost,
        together=min(jobs, cost.together),
        rounds=passed,
        bytes_sent=sent,
        tape_bytes=tape_bytes(
            cost.plan, (first, second), purpose.shapes, dealt, security, description=purpose.as_json()
        ),
        job_bytes=max(cost.plan.correction_bytes),
        dealing_memory=dealing_memory(cost.plan),
        matching_memory=matching_memory(cost, jobs, max(sizes) * purpose.dim),
        dealing_seconds=None,
        link_seconds=sum(sent) / LINK_BYTES + passed * LINK_ROUND,
    )


def plan_maps(
    agents: Sequence[str],
    purpose: Purpose,
    maps: tuple[int, int],
    security: Security,
    *,
    meetings: int = 1,
    interruptions: int = 0,
) -> list[TilePlan | Impossible]:
    """Plans for all tiles worth considering; arguments as for :func:`plan_tile`, whatever the purpose's tile.

    Raises:
        ValueError: if there is no tile that can be dealt.
    """
    plans: list[TilePlan | Impossible] = []
    for tile in candidate_tiles(maps):
        try:
            candidate = replace(purpose, tile=tile)
            plan = plan_tile(
                agents,
                candidate,
                jobs_for(maps, tile),
                maps,
                security,
                meetings=meetings,
                interruptions=interruptions,
            )
            plans.append(plan)
        except ValueError as error:
            plans.append(Impossible(tile, str(error)))
    if isinstance(plans[0], Impossible) and not any(isinstance(plan, TilePlan) for plan in plans):
        raise ValueError(plans[0].reason)
    return plans


def pick(plans: Sequence[TilePlan | Impossible]) -> tuple[TilePlan, str]:
    """The tile to deal with, of those that are possible, and why.

    Quick is a meeting with one interruption: large tiles send less, and lose more with each.
    """
    possible = [plan for plan in plans if isinstance(plan, TilePlan)]
    fit = [p for p in possible if p.job_bytes <= DEALT_BYTES and p.matching_memory <= ROBOT_MEMORY]
    if not fit:
        return min(possible, key=lambda plan: plan.job_bytes), "the smallest job: every job is large"
    least = min(plan.interrupted_seconds for plan in fit)
    near = [plan for plan in fit if plan.interrupted_seconds <= _NEARLY * least]
    picked = min(near, key=lambda plan: (sum(plan.tape_bytes), plan.comparisons, plan.jobs))
    why = (
        f"the quickest meeting over a link of {LINK_BYTES * 8 / 1e6:.0f} Mbit/s and {LINK_ROUND * 1e3:.0f} "
        f"ms a round, one interruption included ({in_seconds(picked.interrupted_seconds)})"
    )
    if len(near) > 1:
        why += "; others are as quick (within 5%), and this one's tapes are the smallest"
    if len(fit) < len(possible):
        why += (
            f"; tiles that need more than {in_bytes(DEALT_BYTES)} of tape a job, or {in_bytes(ROBOT_MEMORY)} "
            "of a robot's memory, were left out"
        )
    return picked, why


def with_dealing_seconds(
    plans: Sequence[TilePlan | Impossible], purpose: Purpose, security: Security
) -> list[TilePlan | Impossible]:
    """Deal a job or a few of each tile, in memory, and extrapolate; large jobs go by their bytes."""
    seconds_a_byte, timed = 0.0, []
    for plan in plans:
        if isinstance(plan, TilePlan):
            tiled = replace(purpose, tile=plan.tile)
            metered = measure(tiled.dealt_program, tiled.shapes, security)
            size = max(1, sum(metered.correction_bytes) + sum(metered.pad_bytes))
            if size <= _TIMED_BYTES or not seconds_a_byte:
                seconds_a_byte = _seconds_a_job(tiled, metered, security) / size
            plan = replace(plan, dealing_seconds=plan.jobs * size * seconds_a_byte)
        timed.append(plan)
    return timed


def advice(purpose: Purpose, security: Security) -> str | None:
    """What to deal for instead, where S1 or S2 of long vectors take absurdly much."""
    stored = max(measure(purpose.dealt_program, purpose.shapes, security).correction_bytes) / purpose.pairs
    if purpose.score not in ("S1", "S2") or stored < _ABSURD_PAIR:
        return None
    other: Any = replace(purpose, score="S10", max_norm=1.0)
    less = max(measure(other.dealt_program, other.shapes, security).correction_bytes) / purpose.pairs
    return (
        f"{purpose.score} stores a key for every coordinate of every pair: {in_bytes(stored)} a pair "
        f"at {purpose.dim} coordinates. For bags of words, S10 of the square roots x -> sqrt(x / |x|_1) with "
        f"--max-norm 1 takes {in_bytes(less)} (docs/scores.md, bags of words)"
    )


def _seconds_a_job(purpose: Purpose, plan: Plan, security: Security) -> float:
    mac_key = random_mac_key() if security == "malicious" else None
    program = purpose.dealt_program
    seconds: list[float] = []
    while sum(seconds) < _TIMED_SECONDS:
        started = time.perf_counter()
        deal_job(program, plan, security, (secrets.token_bytes(32), secrets.token_bytes(32)), mac_key)
        seconds.append(time.perf_counter() - started)
    return min(seconds)  # the others were disturbed


def _even(descriptors: int, side: int) -> int:
    """The side near ``side`` that divides a map into equal tiles, the last one nearly full."""
    return -(-descriptors // -(-descriptors // side))
