"""A mission's forecast for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict

from dealer.team.deal import Here
from dealer.team.forecast import Forecast, RobotCost
from dealer.words import counted, in_seconds
from protocols.memory import in_bytes
from protocols.mission import Mission

_WIDTHS = (8, 12, 12, 12, 12)
_FEW = 8
"""Robots that get a row of their own."""


def as_json(mission: Mission, cost: Forecast, here: Here) -> str:
    """One object."""
    fields = asdict(cost) | asdict(here)
    for one in mission.galleries:
        fields["galleries"][one.name] |= {**one.description(), "security": mission.security}
    return json.dumps({"digest": mission.digest, "pairs": len(mission.pairs), **fields})


def as_text(mission: Mission, cost: Forecast, here: Here) -> Iterator[str]:
    """Tables, and what their columns mean."""
    named = f" {mission.name!r}" if mission.name else ""
    yield (
        f"plan: mission{named}, {mission.security}: {len(mission.agents)} robots, "
        f"{counted(len(mission.pairs), 'pair')} of them, {counted(cost.tasks, 'gallery', 'galleries')}, "
        f"{counted(cost.pairs_of_slots, 'pair')} of slots"
    )
    for one in mission.galleries:
        largest = cost.galleries[one.name]
        rows, columns = largest.slots
        terms = one.terms(mission.security)
        yield f"  {one.name}: {terms.rule}; a slot has {terms.dim:,} numbers"
        yield (
            f"    at most {rows:,} x {columns:,} slots for a pair of robots: each stores "
            f"{in_bytes(max(largest.tape_bytes))} ({largest.pair_tape_bytes:,} bytes a pair of slots) and "
            f"sends {in_bytes(max(largest.bytes_sent))}"
        )
    yield _row("robot", "peers", "tapes", "sends", "memory", "matching")
    shown = cost.robots if len(cost.robots) <= _FEW else _extremes(cost.robots)
    for robot in shown:
        yield _row(
            robot.name,
            f"{robot.peers}",
            in_bytes(robot.tape_bytes),
            in_bytes(robot.bytes_sent),
            in_bytes(robot.memory),
            in_seconds(robot.matching_seconds),
        )
    if len(shown) < len(cost.robots):
        yield f"  (those with the least and the most of {len(cost.robots)})"
    yield (
        f"dealing: {in_bytes(cost.tape_bytes)} in all, {in_seconds(cost.dealing_seconds)} with "
        f"{counted(cost.workers, 'worker')} here ({in_seconds(cost.core_seconds)} of one core), and "
        f"{in_bytes(cost.dealing_memory)} of memory"
    )
    yield f"here: {in_bytes(here.free_memory)} of memory and {in_bytes(here.free_disk)} of the disk are free"
    if here.refusal is not None:
        yield f"dealing would be refused here: {here.refusal}"
    yield "the columns:"
    yield "  tapes     on the robot's disk; exact"
    yield "  sends     until all is compared; exact, without frames, agreements and checks"
    yield "  memory    all slots filled, all galleries open; from above, beside the interpreter's 60 MB"
    yield "  matching  time of one core like this one, without the line"
    yield "times were measured on small galleries in memory: the disk is not counted. Nothing was written"


def _extremes(robots: list[RobotCost]) -> list[RobotCost]:
    ordered = sorted(robots, key=lambda robot: robot.tape_bytes)
    return [ordered[0], ordered[-1]]


def _row(name: str, *cells: str) -> str:
    return (
        "  "
        + name.ljust(12)
        + "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))
    )
