"""Hand dealt tapes out to the robots' folders, and the folders to whoever carries them to the robots.

Everything is a rename, and every step finds out by itself whether it was done: a dealer that is stopped goes
on at any of them. A robot's folder is filled where nobody looks for it and then takes its place as a whole.
"""

from __future__ import annotations

import os
from pathlib import Path

from dealer.team.record import HALVES, Record, read_header
from dealer.team.room import Room
from dealer.team.tasks import Task, tasks_of
from protocols.mission.folder import tape_name
from protocols.mission.mission import canonical
from spdz.foundations.errors import TapeError
from spdz.tape.durable import replace_file, sync_folder

_AGAIN = "Begin again with another --out"


def hand_out(room: Room) -> dict[Path, int]:
    """Move all tapes into the robots' folders and those to their places; every task must be published.

    Returns:
        Each robot's folder and the size of its tapes in bytes.

    Raises:
        ValueError: if a tape is gone, damaged, or of another dealing than its other half.
        OSError: if something is in the way, or cannot be written.
    """
    tasks = tasks_of(room.mission)
    for task in tasks:
        _check(room, task)
    for task in tasks:
        for source, target in _moves(room, task):
            if source.exists():
                _refuse_to_overwrite(target)
                os.rename(source, target)
    for task in tasks:
        sync_folder(room.pair(task))
    totals: dict[Path, int] = {}
    for agent in room.mission.agents:
        own = [task for task in tasks if agent.name in task.couple]
        totals[room.out / agent.name] = sum(_record(room, t).sizes[t.couple.index(agent.name)] for t in own)
        staged = room.robot(agent.name)
        if staged.exists():
            _refuse_to_overwrite(room.out / agent.name)
            sync_folder(staged)
            os.rename(staged, room.out / agent.name)
    sync_folder(room.out)
    sync_folder(room.path / "robots")
    replace_file(room.finished, canonical({folder.name: size for folder, size in totals.items()}))
    room.close()
    return totals


def _moves(room: Room, task: Task) -> list[tuple[Path, Path]]:
    first, second = task.couple
    return [
        (room.pair(task) / half, room.robot(own) / tape_name(peer, task.gallery))
        for half, own, peer in zip(HALVES, (first, second), (second, first), strict=True)
    ]


def _check(room: Room, task: Task) -> None:
    """Refuse halves that are not of one dealing of this task."""
    record = _record(room, task)
    for party, (source, target) in enumerate(_moves(room, task)):
        own = task.couple[party]
        if not room.robot(own).exists():  # handed out by an earlier run, and perhaps taken away since
            continue
        path = source if source.exists() else target
        try:
            header = read_header(path)
        except (OSError, TapeError) as error:
            raise ValueError(f"a dealt tape is of no use any more: {error}. {_AGAIN}") from error
        found = (header.mission, header.tape, header.agents, header.party, header.program.get("gallery"))
        if found != (room.mission_id, record.tape, task.couple, party, task.gallery):
            raise ValueError(f"{path} is not what was dealt. {_AGAIN}")


def _record(room: Room, task: Task) -> Record:
    record = room.record(task)
    if record is None:
        raise ValueError(f"{task.key} is not dealt")
    return record


def _refuse_to_overwrite(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists; dealt material is never overwritten: move it away and go on")
