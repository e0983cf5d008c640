"""The run: deal, start the robots, let keyframes come, kill one of them, and look at what was found."""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.agents.keyframes import team
from bench.agents.process import Robot
from bench.demo.places import DEFAULT_THRESHOLD
from bench.parties import free_port
from dealer.team.deal import deal_team
from protocols.mission import Mission
from spdz.arithmetic.fixed_point import encode
from spdz.foundations.types import FloatArray, Security

NAMES = ("alice", "bob", "carol", "dave", "erin", "frank")
GALLERY = "lidar"
_UNCLEAR = 2.0**-16
_SETTLING = 60.0


@dataclass(frozen=True, slots=True)
class Asked:
    """What the user wants.

    Attributes:
        robots: How many.
        keyframes: Of each.
        rate: Keyframes a second that come to each.
        kills: How often the last robot is killed and started again.
        linger: Seconds that all stay up after the last keyframe, and memory is looked at.
        security: The security model.
    """

    robots: int
    keyframes: int
    rate: float
    kills: int
    linger: float
    security: Security


@dataclass(frozen=True, slots=True)
class Row:
    """What was measured; times in seconds, memory in MB.

    Attributes:
        dealt_seconds: To deal the mission.
        pairs: Pairs of keyframes compared, of all pairs of robots.
        candidates: That the clear computation finds.
        missed: Of them, not found by either robot of the pair.
        wrong: Found by a robot, and not by the clear computation.
        repeated: News that were printed more than once.
        delay_seconds: From the later of a match's keyframes to its bit: median, 95 %, largest. Matches of a
            robot while it was dead, or catching up after a start, are in the largest.
        memory_mb: Largest of each robot.
        memory_growth_mb_per_hour: Slope of each robot's memory after the last keyframe.
        kills: How often the last robot was killed.
    """

    robots: int
    keyframes: int
    rate: float
    security: str
    kills: int
    dealt_seconds: float
    seconds: float
    pairs: int
    candidates: int
    missed: int
    wrong: int
    repeated: int
    delay_seconds: tuple[float, float, float]
    memory_mb: tuple[float, ...]
    memory_growth_mb_per_hour: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


def run(asked: Asked, progress: Callable[[int, int], None] = lambda done, total: None) -> Row:
    """Do it."""
    descriptors = team(asked.robots, asked.keyframes)
    names = NAMES[: asked.robots]
    with tempfile.TemporaryDirectory(prefix="spdz-agents-") as folder:
        plan, out = Path(folder) / "mission.toml", Path(folder) / "mission"
        plan.write_text(_plan(asked, names))
        started = time.monotonic()
        deal_team(out, Mission.load(plan))
        dealt = time.monotonic() - started
        robots = [Robot(out / name, rows, GALLERY) for name, rows in zip(names, descriptors, strict=True)]
        started = time.monotonic()
        for robot in robots:
            robot.start()
        try:
            memory = _feed(robots, asked, progress)
        finally:
            for robot in robots:
                robot.stop()
        seconds = time.monotonic() - started
    return _row(asked, dealt, seconds, robots, descriptors, memory)


def _plan(asked: Asked, names: tuple[str, ...]) -> str:
    agents = "".join(
        f'[[agents]]\nname = "{name}"\naddress = "127.0.0.1:{free_port()}"\n\n' for name in names
    )
    return f"""security = "{asked.security}"

{agents}[descriptors.{GALLERY}]
kind = "D5"
threshold = {DEFAULT_THRESHOLD}
keyframes = {asked.keyframes}

[budgets]
matches_per_minute = 100000
"""


def _feed(robots: list[Robot], asked: Asked, progress: Callable[[int, int], None]) -> list[list[float]]:
    """Let keyframes come and kill a robot now and then; returns memory over time after the last keyframe."""
    killed = {asked.keyframes * (i + 1) // (asked.kills + 1) for i in range(asked.kills)}
    start, total = time.monotonic() + 3.0, asked.keyframes * len(robots)
    for number in range(asked.keyframes):
        time.sleep(max(0.0, start + number / asked.rate - time.monotonic()))
        if number in killed:
            robots[-1].kill()
            robots[-1].start()
        for robot in robots:
            robot.bring(number)
        progress((number + 1) * len(robots), total)
    memory: list[list[float]] = []
    deadline = time.monotonic() + max(asked.linger, 5.0)
    while time.monotonic() < deadline:
        memory.append([time.monotonic(), *(robot.memory for robot in robots)])
        time.sleep(1.0)
    _settle(robots)
    return memory


def _settle(robots: list[Robot]) -> None:
    """Wait until no more news come."""
    deadline, heard = time.monotonic() + _SETTLING, -1
    while time.monotonic() < deadline and heard != (now := sum(len(one.heard.numbers) for one in robots)):
        heard = now
        time.sleep(3.0)


def _row(
    asked: Asked,
    dealt: float,
    seconds: float,
    robots: list[Robot],
    descriptors: list[FloatArray],
    memory: list[list[float]],
) -> Row:
    index = {robot.name: i for i, robot in enumerate(robots)}
    raw = [encode(rows, max_norm=1.0).astype(np.float64) * 2.0**-16 for rows in descriptors]
    candidates = missed = wrong = repeated = 0
    found: list[dict[int, set[tuple[int, int]]]] = [{} for _ in robots]
    for i, robot in enumerate(robots):
        for own, peer, theirs in robot.heard.matches.values():
            found[i].setdefault(index[peer], set()).add((own, theirs))
        repeated += len(robot.heard.numbers) - len(set(robot.heard.numbers))
    for i, j in itertools.combinations(range(len(robots)), 2):
        scores = raw[i] @ raw[j].T
        clear = {(int(a), int(b)) for a, b in np.argwhere(scores >= DEFAULT_THRESHOLD)}
        close = {(int(a), int(b)) for a, b in np.argwhere(abs(scores - DEFAULT_THRESHOLD) < _UNCLEAR)}
        here = found[i].get(j, set())
        there = {(a, b) for b, a in found[j].get(i, set())}
        candidates += len(clear)
        missed += len(clear - here - close) + len(clear - there - close)
        wrong += len(here - clear - close) + len(there - clear - close)
    delays = [
        when - max(robot.came[robot.heard.matches[match][0]], _other(robots, robot, match))
        for robot in robots
        for match, when in robot.heard.candidates.items()
        if match in robot.heard.matches
    ]
    couples = len(robots) * (len(robots) - 1) // 2
    times = np.array([sample[0] for sample in memory])
    slopes = [
        float(np.polyfit(times - times[0], [row[i + 1] for row in memory], 1)[0]) for i in range(len(robots))
    ]
    quantiles = statistics.quantiles(delays, n=20) if len(delays) > 1 else [0.0] * 19
    return Row(
        robots=asked.robots,
        keyframes=asked.keyframes,
        rate=asked.rate,
        security=asked.security,
        kills=asked.kills,
        dealt_seconds=round(dealt, 2),
        seconds=round(seconds, 1),
        pairs=couples * asked.keyframes**2,
        candidates=candidates,
        missed=missed,
        wrong=wrong,
        repeated=repeated,
        delay_seconds=(
            round(statistics.median(delays or [0.0]), 3),
            round(quantiles[18], 3),
            round(max(delays or [0.0]), 3),
        ),
        memory_mb=tuple(round(max(row[i + 1] for row in memory), 1) for i in range(len(robots))),
        memory_growth_mb_per_hour=tuple(round(slope * 3600, 1) for slope in slopes),
    )


def _other(robots: list[Robot], robot: Robot, match: int) -> float:
    """When the other half of a match came."""
    _, peer, number = robot.heard.matches[match]
    return next(one for one in robots if one.name == peer).came[number]
