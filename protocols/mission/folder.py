"""The folder that a robot takes on a mission: its plan, its credentials, a tape for each peer and gallery."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

from protocols.mission.errors import PlanError
from protocols.mission.mission import Mission, canonical
from spdz.channels.credentials import check_credentials
from spdz.foundations.errors import TapeError
from spdz.gallery.format import read_gallery_header

PLAN_FILE = "plan.json"
_MOST_BYTES = 1 << 22
_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class Folder:
    """A robot's dealt folder.

    Attributes:
        path: The folder.
        robot: Whose it is.
        mission: The plan.
        mission_id: Hex id of the dealing run: folders of one mission have the same.
    """

    path: Path
    robot: str
    mission: Mission
    mission_id: str

    @classmethod
    def open(cls, path: str | Path) -> Folder:
        """Read and check a folder: its plan, whose credentials are in it, that all tapes are of its dealing.

        Of the tapes only the headers are read: one that is damaged or used up concerns its peer alone.

        Raises:
            ValueError: saying what is wrong with it, and what to do.
        """
        path = Path(path)
        mission, robot, mission_id = _plan(path)
        folder = cls(path, robot, mission, mission_id)
        check_credentials(path, robot)
        missing = [tape.name for tape in folder.tapes() if not tape.is_file()]
        if missing:
            more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            raise ValueError(
                f"{path} lacks {', '.join(missing[:3])}{more}: the folder was not copied as a whole. Copy "
                "what is missing from where the dealer wrote it, and nothing that was used already"
            )
        for tape in folder.tapes():
            if _dealing(tape) not in (None, mission_id):
                raise ValueError(
                    f"{tape}: this tape is of another dealing: copy the folder again, as a whole"
                )
        return folder

    @property
    def peers(self) -> list[str]:
        """Whom this robot meets."""
        return self.mission.peers(self.robot)

    def tape(self, peer: str, gallery: str) -> Path:
        """This robot's tape for a gallery with a peer.

        Raises:
            ValueError: if it does not meet this peer, or there is no such gallery.
        """
        if peer not in self.peers:
            raise ValueError(f"{self.robot} does not meet {peer!r}, but {', '.join(self.peers)}")
        return self.path / tape_name(peer, self.mission.gallery(gallery).name)

    def tapes(self) -> list[Path]:
        """All of this robot's tapes."""
        return [self.tape(peer, one.name) for peer in self.peers for one in self.mission.galleries]


def tape_name(peer: str, gallery: str) -> str:
    """The file of a robot's tape for a gallery with a peer."""
    return f"{peer}.{gallery}.tape"


def plan_file(mission: Mission, robot: str, mission_id: str) -> bytes:
    """The content of a robot's ``plan.json``."""
    return canonical({"mission": mission.as_json(), "robot": robot, "id": mission_id})


def _dealing(tape: Path) -> str | None:
    """The mission's id in a tape's header; None where there is none to be read."""
    try:
        with tape.open("rb") as file:
            return read_gallery_header(file.fileno(), tape)[0].mission
    except (OSError, TapeError):
        return None


def _plan(folder: Path) -> tuple[Mission, str, str]:
    file = folder / PLAN_FILE
    wrong = (
        f"give a folder that `python -m spdz.dealer mission.toml --out DIR` wrote for a robot: {folder} has"
    )
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give the one that the dealer wrote for this robot")
    try:
        with file.open("rb") as opened:
            octets = opened.read(_MOST_BYTES + 1)
    except OSError as error:
        raise ValueError(f"{wrong} no readable {PLAN_FILE} ({error.strerror or error})") from error
    try:
        values = json.loads(octets) if len(octets) <= _MOST_BYTES else None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{wrong} a damaged {PLAN_FILE}; copy the folder again, as a whole") from error
    if not isinstance(values, dict) or set(values) != {"mission", "robot", "id"}:
        raise ValueError(f"{wrong} another {PLAN_FILE} in it")
    mission = Mission.from_json(values["mission"], str(file))
    robot, mission_id = values["robot"], values["id"]
    if robot not in [agent.name for agent in mission.agents]:
        raise PlanError(
            f"the plan has no robot {robot!r}: copy the folder again", file=str(file), field="robot"
        )
    if not isinstance(mission_id, str) or not _ID.fullmatch(mission_id):
        raise PlanError("this is no mission's id: copy the folder again", file=str(file), field="id")
    return mission, robot, mission_id
