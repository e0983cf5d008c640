"""Deal a mission: tapes for every pair of robots, and credentials for every robot.

For each pair the dealer reads the program on masks once a job and writes two tapes. It is the mission's
certificate authority as well, and forgets that key and every MAC key when it is done: it is trusted
before the mission, and absent during it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path

from dealer.folders import check_agents, mission_folders, sizes, tape_paths
from dealer.limits import check_job
from dealer.tapes import deal_tapes, tape_bytes
from protocols.catalog import Purpose
from spdz.foundations.types import Security
from spdz.readings.meter import measure


@dataclass(frozen=True, slots=True)
class Dealt:
    """What one run of the dealer wrote.

    Attributes:
        folders: Each robot's folder and its size in bytes.
        comparisons: Comparisons dealt for each pair.
        jobs: Jobs for each pair.
        pairs: Pairs of robots.
    """

    folders: dict[Path, int]
    comparisons: int
    jobs: int
    pairs: int


def deal_mission(
    out: Path,
    agents: Sequence[str],
    purpose: Purpose,
    comparisons: int,
    security: Security = "malicious",
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Dealt:
    """Deal tapes for every pair of robots and write one folder a robot.

    Args:
        out: Folder to create the robots' folders in; those must not exist yet.
        agents: Two or more robot names.
        purpose: What the tapes are for.
        comparisons: Comparisons for each pair, rounded up to whole jobs.
        security: The security model.
        progress: Called with jobs done and jobs in all.

    Returns:
        What was written.

    Raises:
        ValueError: for bad names, fewer than two robots, or a count below one.
        FileExistsError: if a robot's folder exists: dealt material is never overwritten.
        OSError: if the folder cannot be made or written.
    """
    check_agents(agents)
    if comparisons < 1:
        raise ValueError("deal at least one comparison")
    plan = measure(purpose.dealt_program, purpose.shapes, security)
    check_job(plan)
    needed = mission_bytes(agents, purpose, comparisons, security)
    jobs, couples = -(-comparisons // purpose.pairs), list(combinations(agents, 2))
    remedy = "deal fewer comparisons, larger tiles or a smaller max_norm"
    with mission_folders(out, agents, needed, remedy) as mission:
        for number, couple in enumerate(couples):
            deal_tapes(
                tape_paths(out, couple),
                couple,
                purpose.dealt_program,
                purpose.shapes,
                jobs,
                security,
                mission=mission,
                description=purpose.as_json(),
                progress=partial(_progress_of, progress, number * jobs, len(couples) * jobs),
            )
    return Dealt(sizes(out, agents), jobs * purpose.pairs, jobs, len(couples))


def mission_bytes(agents: Sequence[str], purpose: Purpose, comparisons: int, security: Security) -> int:
    """What all tapes of a mission will take on the disk, exactly.

    Args:
        agents: The robots' names.
        purpose: What the tapes are for.
        comparisons: Comparisons for each pair.
        security: The security model.

    Raises:
        ValueError: for a purpose that the engine refuses, or more jobs than a tape can have.
    """
    plan = measure(purpose.dealt_program, purpose.shapes, security)
    jobs, about = -(-comparisons // purpose.pairs), purpose.as_json()
    return sum(
        sum(tape_bytes(plan, couple, purpose.shapes, jobs, security, description=about))
        for couple in combinations(agents, 2)
    )


def _progress_of(report: Callable[[int, int], None], before: int, total: int, done: int) -> None:
    report(before + done, total)
