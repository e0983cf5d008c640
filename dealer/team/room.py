"""The dealer's room: a folder beside the robots' in which a mission is dealt, and what is known of it later.

::

    DIR/.dealer.lock       held by the one dealer at work
    DIR/.dealer/
        plan.json          the plan, and the mission's id
        robots/alice/      alice's folder to be: plan.json, credentials, then tapes
        pairs/alice+bob.lidar/
            record.json    what was dealt for a pair of robots and a gallery, once and for ever
            0.tape 1.tape  both halves, until they are handed out
        work/              pairs that are being dealt; whatever is in it may be removed at any time
        finished.json      all robots' folders were handed out
    DIR/alice/             complete from the moment that it is there

The room appears with one rename, credentials included: the certificate authority's key is on no disk, and to
go on takes none. Records stay, so that nothing is ever dealt twice into one mission.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dealer.pki import MissionAuthority, write_credentials
from dealer.team.record import Record, read_json
from dealer.team.tasks import Task
from protocols.mission import Mission
from protocols.mission.folder import PLAN_FILE, plan_file
from protocols.mission.mission import canonical
from spdz.tape.durable import (
    PRIVATE_FOLDER,
    create_private,
    make_private_folder,
    replace_file,
    sync_folder,
    try_lock,
)

ROOM, LOCK = ".dealer", ".dealer.lock"
_BEGUN = f"{ROOM}.*.partial"


@dataclass(frozen=True, slots=True)
class Room:
    """A room that there is.

    Attributes:
        out: The folder that it is in.
        mission: The plan that is dealt.
        mission_id: Hex id of this dealing.
    """

    out: Path
    mission: Mission
    mission_id: str

    @property
    def path(self) -> Path:
        """The room's folder."""
        return self.out / ROOM

    @property
    def work(self) -> Path:
        """Where pairs are dealt."""
        return self.path / "work"

    @property
    def finished(self) -> Path:
        """The file that says that all is handed out."""
        return self.path / "finished.json"

    def robot(self, name: str) -> Path:
        """A robot's folder to be."""
        return self.path / "robots" / name

    def pair(self, task: Task) -> Path:
        """Where a task's tapes are published."""
        return self.path / "pairs" / task.key

    def record(self, task: Task) -> Record | None:
        """What was dealt for a task, or None.

        Raises:
            ValueError: if the record is damaged.
        """
        return Record.read(self.pair(task))

    def clear(self) -> None:
        """Remove what was half dealt, or half written."""
        for half_done in self.work.iterdir():
            shutil.rmtree(half_done, ignore_errors=True)
        for half_written in self.path.glob(".*.partial"):
            half_written.unlink()

    def close(self) -> None:
        """Remove what is of no use once all is handed out."""
        for name in ("robots", "work"):
            shutil.rmtree(self.path / name, ignore_errors=True)

    @classmethod
    def enter(cls, out: Path) -> Room:
        """A room as a worker finds it.

        Raises:
            ValueError: if its plan is damaged.
            FileNotFoundError: if there is none.
        """
        file = out / ROOM / PLAN_FILE
        values = read_json(file)
        if values is None:
            raise FileNotFoundError(f"there is no {file}")
        return cls(out, Mission.from_json(values.get("mission"), str(file)), str(values.get("id")))


@contextmanager
def opened_room(out: Path, mission: Mission) -> Iterator[Room]:
    """Go on in the room of this folder, or make one; nobody else can until the context is left.

    Raises:
        ValueError: if another plan is dealt there, or somebody is at it.
        FileExistsError: if the mission is dealt, or a robot's folder is in the way.
        OSError: if the folder cannot be made or written.
    """
    _make_folder(out)
    with _locked(out):
        for begun in out.glob(_BEGUN):
            shutil.rmtree(begun)
        if not (out / ROOM).exists():
            _make_room(out, mission)
        yield _reentered(out, mission)


def _reentered(out: Path, mission: Mission) -> Room:
    """The room, fit to go on in: what was half done is gone."""
    room = Room.enter(out)
    if room.mission.digest != mission.digest:
        raise ValueError(
            f"{out} has another plan's mission in it (they differ in {difference(room.mission, mission)}): "
            "choose another --out, or go on with the plan that it was begun with"
        )
    if room.finished.exists():
        room.close()
        raise FileExistsError(
            f"{out}: this mission was dealt into the robots' folders, and is never dealt again: robots that "
            "had other halves could not meet. Choose another --out for a new one"
        )
    room.clear()
    return room


def difference(one: Mission, other: Mission) -> str:
    """The first field in which two plans differ."""
    return _difference(one.as_json(), other.as_json(), "") or "nothing"


def _difference(one: Any, other: Any, where: str) -> str | None:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in [*one, *(key for key in other if key not in one)]:
            inner = f"{where}.{key}" if where else str(key)
            if (found := _difference(one.get(key), other.get(key), inner)) is not None:
                return found
        return None if list(one) == list(other) else f"the order of {where}"
    return None if one == other else where


def _make_room(out: Path, mission: Mission) -> None:
    for agent in mission.agents:
        if os.path.lexists(out / agent.name):
            raise FileExistsError(
                f"{out / agent.name} exists; dealt material is never overwritten: choose another --out"
            )
    authority = MissionAuthority()
    credentials = {agent.name: authority.credentials(agent.name) for agent in mission.agents}
    authority.forget()
    room = Room(out, mission, secrets.token_hex(16))
    begun = out / _BEGUN.replace("*", secrets.token_hex(4))
    begun.mkdir(mode=PRIVATE_FOLDER)
    try:
        for name in ("pairs", "work", "robots"):
            make_private_folder(begun / name)
        for name, one in credentials.items():
            write_credentials(begun / "robots" / name, one)
            replace_file(begun / "robots" / name / PLAN_FILE, plan_file(mission, name, room.mission_id))
        replace_file(begun / PLAN_FILE, canonical({"mission": mission.as_json(), "id": room.mission_id}))
        os.rename(begun, room.path)  # where a lock holds on one machine only, one of two is refused
    except BaseException:
        shutil.rmtree(begun, ignore_errors=True)
        raise
    sync_folder(out)


def _make_folder(out: Path) -> None:
    try:
        make_private_folder(out)
    except (FileExistsError, NotADirectoryError) as error:
        raise NotADirectoryError(
            f"{out} is not a folder: choose a folder, or a new name, for --out"
        ) from error
    except OSError as error:
        raise OSError(f"the folder {out} cannot be made ({error.strerror}): choose another --out") from error


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    path = out / LOCK
    try:
        descriptor = create_private(path)
    except FileExistsError:
        descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        if not try_lock(descriptor):
            raise ValueError(f"another dealer is at work in {out}: wait for it, or end it and go on then")
        yield
    finally:
        os.close(descriptor)
