"""Deal a mission from its plan: begin or go on, pair by pair, and hand out when all is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dealer.folders import check_disk, free_disk
from dealer.team.cluster import Cluster, deal_on_cluster
from dealer.team.handout import hand_out
from dealer.team.here import cores, deal_here
from dealer.team.room import ROOM, Room, opened_room
from dealer.team.tasks import Size, Task, size_of, tasks_of
from dealer.team.watch import Watch
from protocols.memory import available_memory, require_memory
from protocols.mission import Mission

_FEW = 20_000
"""Pairs of slots that one process has dealt before others have started."""
_REMEDY = "plan for fewer keyframes, a coarser resolution or a smaller max_norm, or choose another --out"


@dataclass(frozen=True, slots=True)
class Dealt:
    """What was dealt.

    Attributes:
        mission_id: The dealing's hex id, in every robot's folder.
        folders: Each robot's folder and the size of its tapes in bytes.
        tasks: Galleries of pairs of robots.
        resumed: How many of them an earlier run had dealt.
    """

    mission_id: str
    folders: dict[Path, int]
    tasks: int
    resumed: int


def deal_team(
    out: Path,
    mission: Mission,
    *,
    workers: int | None = None,
    cluster: Cluster | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Dealt:
    """Deal a mission, or go on where a dealing of the same plan was stopped.

    Args:
        out: Folder that the robots' folders appear in, each when it is complete.
        mission: The plan.
        workers: Processes on this machine; as many as its cores and memory have room for if not given.
        cluster: Where to deal instead.
        progress: Called with pairs of descriptors dealt and in all.

    Raises:
        ValueError: for a gallery that cannot be dealt, another plan's folder, too full a disk or too little
            memory.
        FileExistsError: if the mission is dealt already, or a robot's folder is in the way.
        OSError: if the folder cannot be made or written.
        DealingStopped: if workers were lost; the same call goes on.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"deal with at least one worker, not {workers}")
    if cluster is not None:
        cluster.check()
    sizes = _sizes(mission)
    largest = max(size.memory for size in sizes.values())
    _require_room(out, sizes, workers, cluster)
    with opened_room(out, mission) as room:
        left = [task for task in sizes if room.record(task) is None]
        check_disk(out, sum(sum(sizes[task].tape_bytes) for task in left), _REMEDY)
        if left:
            pairs = sum(sizes[task].pairs for task in left)
            _deal(room, sizes, left, workers or workers_for(largest, pairs), cluster, progress)
        return Dealt(room.mission_id, hand_out(room), len(sizes), len(sizes) - len(left))


@dataclass(frozen=True, slots=True)
class Here:
    """What there is to deal with.

    Attributes:
        free_memory: Bytes of memory of this machine.
        free_disk: Bytes of the disk that the robots' folders would be on.
        refusal: Why a mission would not be dealt here; None if it would.
    """

    free_memory: int
    free_disk: int
    refusal: str | None


def look_round(
    out: Path, mission: Mission, *, workers: int | None = None, cluster: Cluster | None = None
) -> Here:
    """What there is to deal a mission with; arguments as for :func:`deal_team`. Nothing is written."""
    refusal = None
    try:
        _require_room(out, _sizes(mission), workers, cluster)
    except (ValueError, OSError) as error:
        refusal = str(error)
    return Here(available_memory(), free_disk(out), refusal)


def _sizes(mission: Mission) -> dict[Task, Size]:
    return {task: size_of(mission, task) for task in tasks_of(mission)}


def _require_room(out: Path, sizes: dict[Task, Size], workers: int | None, cluster: Cluster | None) -> None:
    """Refuse what there is no memory for, or no room on the disk of a dealing that has not begun."""
    if cluster is None:
        require_memory(
            max(size.memory for size in sizes.values()) * (workers or 1),
            "dealing",
            "give fewer --workers, plan for fewer keyframes, or deal elsewhere",
        )
    if not (out / ROOM).exists():
        check_disk(out, sum(sum(size.tape_bytes) for size in sizes.values()), _REMEDY)


def _deal(
    room: Room,
    sizes: dict[Task, Size],
    left: list[Task],
    workers: int,
    cluster: Cluster | None,
    progress: Callable[[int, int], None],
) -> None:
    watch = Watch(room, sizes, progress)
    if cluster is None:
        deal_here(room, left, workers, on_dealt=watch.dealt, poll=watch.look)
    else:
        deal_on_cluster(room, left, cluster, on_dealt=watch.dealt, poll=watch.look)


def workers_for(memory: int, pairs: int) -> int:
    """Processes that this machine has cores for, and so much memory each; one for few pairs of slots."""
    if pairs < _FEW:
        return 1
    return max(1, min(cores(), available_memory() // max(1, memory)))
