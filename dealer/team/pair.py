"""Deal one gallery of one pair of robots, once and for ever, whoever else is at it at the same time.

A cluster deals some pairs twice: a worker that is thought dead is replaced while it goes on, and results that
were lost with a worker are computed again. Masks are fresh each time, so two robots that got halves of two
dealings could never meet. So a pair is dealt in a folder of its own and published by renaming that folder,
which only the first one can; all others find the pair published and return the same record.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

from dealer.gallery import deal_gallery
from dealer.team.record import HALVES, Record
from dealer.team.room import Room
from dealer.team.tasks import Task
from spdz.tape.durable import PRIVATE_FOLDER, sync_folder
from spdz.version import __version__

_TAKEN = (errno.EEXIST, errno.ENOTEMPTY)


def deal_pair(
    out: str,
    mission_id: str,
    couple: tuple[str, str],
    gallery: str,
    version: str = __version__,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Record:
    """Deal a task of the room in ``out``, or find that it is dealt.

    Args:
        out: The folder that the room is in, as this machine sees it.
        mission_id: The id that the room must have.
        couple: The pair's robots.
        gallery: The gallery's name.
        version: The dealer's version.
        progress: Called with pairs of descriptors dealt and in all.

    Returns:
        The record of the tapes that are published.

    Raises:
        ValueError: if this is another version, or the room of another mission.
        OSError: if there is no such room here, or it cannot be written.
    """
    room, task = room_here(out, mission_id, version), Task(couple, gallery)
    if (record := room.record(task)) is not None:
        return record
    work = room.work / f"{task.key}.{secrets.token_hex(8)}"
    work.mkdir(mode=PRIVATE_FOLDER)
    try:
        plan = room.mission.gallery(gallery)
        deal_gallery(
            (work / HALVES[0], work / HALVES[1]),
            couple,
            plan.purpose.dealt_terms(room.mission.security),
            plan.slots(couple),
            mission=mission_id,
            description=plan.description(),
            progress=progress,
        )
        Record.of(work).write(work)
        _publish(work, room.pair(task))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    record = room.record(task)
    if record is None:
        raise OSError(f"{room.pair(task)} was published and is gone: does something else remove files there?")
    return record


def room_here(out: str, mission_id: str, version: str) -> Room:
    """The room as this process sees it.

    Raises:
        ValueError: if this is another version, or the room of another mission.
        FileNotFoundError: if there is no such folder here.
    """
    if version != __version__:
        raise ValueError(
            f"the dealer is spdz {version} and this worker spdz {__version__}: install one of them"
        )
    try:
        room = Room.enter(Path(out))
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"a worker does not see {out} as the dealer does: all need the same folder, at the same path"
        ) from error
    if room.mission_id != mission_id:
        raise ValueError(f"{out} holds another mission where a worker runs: all need the same folder")
    return room


def _publish(work: Path, target: Path) -> None:
    """Give the folder its name, unless there is one: a folder with something in it is never replaced."""
    try:
        os.rename(work, target)
    except OSError as error:
        if error.errno not in _TAKEN and not target.exists():  # a network file system may ask twice
            raise
    sync_folder(target.parent)
