"""The robots' folders of a mission: made with credentials, and removed again where dealing fails."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from dealer.pki import MissionAuthority, check_name, write_credentials
from protocols.memory import in_bytes


def check_agents(agents: Sequence[str]) -> None:
    """Refuse a team that no mission can be dealt for.

    Raises:
        ValueError: for fewer than two robots, or bad or repeated names.
    """
    if len(agents) < 2 or len(set(agents)) != len(agents):
        raise ValueError("name two or more different robots")
    for number, agent in enumerate(agents):
        check_name(agent, {other.lower() for other in agents[:number]})


@contextmanager
def mission_folders(out: Path, agents: Sequence[str], needed: int, remedy: str) -> Iterator[str]:
    """Make one folder a robot, with its credentials; within the context the tapes are written into them.

    Args:
        out: Where the folders go; those of the robots must not exist yet.
        agents: The robots' names.
        needed: Bytes that will be written.
        remedy: What to do where the disk has not so many, for the message.

    Yields:
        The mission's hex id.

    Raises:
        ValueError: for bad names, or too full a disk.
        FileExistsError: if a robot's folder exists: dealt material is never overwritten.
        OSError: if the folder cannot be made or written.
    """
    check_agents(agents)
    authority = MissionAuthority()
    credentials = {agent: authority.credentials(agent) for agent in agents}
    authority.forget()
    check_disk(out, needed, remedy)
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
        yield secrets.token_hex(16)
    except BaseException:
        for agent in agents:  # half a mission is of no use, and these folders were not there before
            shutil.rmtree(out / agent, ignore_errors=True)
        if fresh:
            with suppress(OSError):  # somebody else's files are in it by now
                out.rmdir()
        raise


def tape_paths(out: Path, couple: tuple[str, str]) -> tuple[Path, Path]:
    """Where the two tapes of a pair of robots go."""
    first, second = couple
    return out / first / f"{second}.tape", out / second / f"{first}.tape"


def sizes(out: Path, agents: Sequence[str]) -> dict[Path, int]:
    """Each robot's folder and its size in bytes."""
    return {out / agent: sum(file.stat().st_size for file in (out / agent).iterdir()) for agent in agents}


def check_disk(out: Path, needed: int, remedy: str) -> None:
    """Refuse what the disk under a folder, which need not be there yet, has no room for.

    Raises:
        ValueError: naming the need, what is free, and the remedy.
        NotADirectoryError: if a file is in the way.
    """
    there = _existing(out)
    if not there.is_dir():
        raise NotADirectoryError(f"{there} is not a folder: choose a folder, or a new name, for --out")
    total, _, free = shutil.disk_usage(there)
    has_size = total > 0  # /proc and its like have none, and say for themselves what they lack
    if has_size and needed > free:
        raise ValueError(
            f"the tapes would take {in_bytes(needed)} and {in_bytes(free)} are free in {there}: {remedy}"
        )


def free_disk(out: Path) -> int:
    """Bytes that are free where a folder is, or would be."""
    return shutil.disk_usage(_existing(out))[2]


def _existing(path: Path) -> Path:
    """The path itself, or the nearest folder around it that is there."""
    return next(one for one in (path.absolute(), *path.absolute().parents) if os.path.lexists(one))
