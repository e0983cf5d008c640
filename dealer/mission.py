"""Deal a mission: tapes for every pair of robots, and credentials for every robot.

For each pair the dealer reads the program on masks once a job and writes two tapes. It is the mission's
certificate authority as well, and forgets that key and every MAC key when it is done: it is trusted
before the mission, and absent during it.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path

from dealer.limits import check_job
from dealer.pki import MissionAuthority, check_name, write_credentials
from dealer.tapes import deal_tapes, tape_bytes
from protocols.catalog import Purpose
from protocols.memory import in_bytes
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
    authority = MissionAuthority()
    credentials = {agent: authority.credentials(agent) for agent in agents}
    authority.forget()
    needed = mission_bytes(agents, purpose, comparisons, security)
    there = next(path for path in (out.absolute(), *out.absolute().parents) if os.path.lexists(path))
    if not there.is_dir():
        raise NotADirectoryError(f"{there} is not a folder: choose a folder, or a new name, for --out")
    total, _, free = shutil.disk_usage(there)
    has_size = total > 0  # /proc and its like have none, and say for themselves what they lack
    if has_size and needed > free:
        raise ValueError(
            f"the tapes would take {in_bytes(needed)} and {in_bytes(free)} are free in {there}: deal "
            "fewer comparisons, larger tiles or a smaller max_norm"
        )
    for agent in agents:
        if (out / agent).exists():
            raise FileExistsError(
                f"{out / agent} exists; dealt material is never overwritten: choose another --out"
            )
    fresh = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"the folder {out} cannot be made ({error.strerror}): choose another --out") from error
    try:
        for agent in agents:
            write_credentials(out / agent, credentials[agent])
        jobs = -(-comparisons // purpose.pairs)
        mission = secrets.token_hex(16)
        couples = list(combinations(agents, 2))
        for number, couple in enumerate(couples):
            deal_tapes(
                (out / couple[0] / f"{couple[1]}.tape", out / couple[1] / f"{couple[0]}.tape"),
                couple,
                purpose.dealt_program,
                purpose.shapes,
                jobs,
                security,
                mission=mission,
                description=purpose.as_json(),
                progress=partial(_progress_of, progress, number * jobs, len(couples) * jobs),
            )
    except BaseException:
        for agent in agents:  # half a mission is of no use, and these folders were not there before
            shutil.rmtree(out / agent, ignore_errors=True)
        if fresh:
            with suppress(OSError):  # somebody else's files are in it by now
                out.rmdir()
        raise
    sizes = {out / agent: sum(file.stat().st_size for file in (out / agent).iterdir()) for agent in agents}
    return Dealt(sizes, jobs * purpose.pairs, jobs, len(couples))


def check_agents(agents: Sequence[str]) -> None:
    """Refuse a team that no mission can be dealt for.

    Raises:
        ValueError: for fewer than two robots, or bad or repeated names.
    """
    if len(agents) < 2 or len(set(agents)) != len(agents):
        raise ValueError("name two or more different robots")
    for number, agent in enumerate(agents):
        check_name(agent, {other.lower() for other in agents[:number]})


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
