"""What a mission will take, robot by robot, before anything is dealt.

Bytes on the disk and on the line are exact, as those of a gallery are (:mod:`dealer.gallery_plan`); times are
those of small galleries that are dealt and compared here, in memory, and memory is an estimate from above.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from dealer.gallery_plan import GalleryCost, gallery_cost
from dealer.team.deal import workers_for
from dealer.team.tasks import Task, size_of, tasks_of
from protocols.mission import GalleryPlan, Mission


@dataclass(frozen=True, slots=True)
class RobotCost:
    """What one robot needs, all of its peers and galleries together.

    Attributes:
        name: The robot.
        peers: Robots that it meets.
        tape_bytes: Of all its tapes.
        bytes_sent: Until all expected keyframes are compared.
        memory: Bytes, with all slots filled and every gallery open at once.
        matching_seconds: Of one core, until all is compared, the line not counted.
    """

    name: str
    peers: int
    tape_bytes: int
    bytes_sent: float
    memory: int
    matching_seconds: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a mission needs.

    Attributes:
        galleries: Of each gallery what its largest pair of robots needs.
        robots: What each robot needs.
        tasks: Galleries of pairs of robots.
        pairs_of_slots: In all, as many as keyframes are expected to make.
        tape_bytes: Of all tapes.
        workers: Processes that deal.
        core_seconds: To deal all, of one core, the disk not counted.
        dealing_seconds: Of so many workers, a gallery of a pair each at a time.
        dealing_memory: Bytes, of all workers together, beside 60 MB each for the interpreter.
    """

    galleries: dict[str, GalleryCost]
    robots: list[RobotCost]
    tasks: int
    pairs_of_slots: int
    tape_bytes: int
    workers: int
    core_seconds: float
    dealing_seconds: float
    dealing_memory: int


def forecast(mission: Mission, workers: int | None = None) -> Forecast:
    """Foresee a mission's dealing and matching.

    Args:
        mission: The plan.
        workers: Processes that deal; as many as the machine has cores and memory for if not given.

    Raises:
        ValueError: if a gallery cannot be dealt.
    """
    costs = _costs(mission)
    memory = max(cost.dealing_memory for cost in costs.values())
    pairs = sum(cost.capacity[0] * cost.capacity[1] for cost in costs.values())
    workers = min(workers or workers_for(memory, pairs), len(costs))
    seconds = [cost.dealing_seconds or 0.0 for cost in costs.values()]
    largest: dict[str, GalleryCost] = {}
    for task, cost in costs.items():
        if task.gallery not in largest or cost.pairs > largest[task.gallery].pairs:
            largest[task.gallery] = cost
    return Forecast(
        galleries={one.name: largest[one.name] for one in mission.galleries},
        robots=[_robot(mission, agent.name, costs) for agent in mission.agents],
        tasks=len(costs),
        pairs_of_slots=sum(cost.pairs for cost in costs.values()),
        tape_bytes=sum(sum(cost.tape_bytes) for cost in costs.values()),
        workers=workers,
        core_seconds=sum(seconds),
        dealing_seconds=max(*seconds, sum(seconds) / workers),
        dealing_memory=workers * memory,
    )


def _costs(mission: Mission) -> dict[Task, GalleryCost]:
    """The cost of every task; what depends on neither names nor sizes is found once."""
    found: dict[Task, GalleryCost] = {}
    known: dict[tuple[str, tuple[int, int]], GalleryCost] = {}
    timed: dict[str, GalleryCost] = {}
    for task in tasks_of(mission):  # the largest of a gallery first: it is the one that is timed
        gallery = mission.gallery(task.gallery)
        slots = gallery.slots(task.couple)
        size = size_of(mission, task)
        if (gallery.name, slots) not in known:
            cost = _cost(mission, gallery, task.couple, slots, timed=gallery.name not in timed)
            timed.setdefault(gallery.name, cost)
            known[gallery.name, slots] = replace(cost, seconds=timed[gallery.name].seconds)
        found[task] = replace(known[gallery.name, slots], tape_bytes=size.tape_bytes)
    return found


def _cost(
    mission: Mission,
    gallery: GalleryPlan,
    couple: tuple[str, str],
    slots: tuple[int, int],
    *,
    timed: bool,
) -> GalleryCost:
    return gallery_cost(couple, gallery.purpose, slots, mission.security, timed=timed)


def _robot(mission: Mission, name: str, costs: Mapping[Task, GalleryCost]) -> RobotCost:
    own = [(cost, task.couple.index(name)) for task, cost in costs.items() if name in task.couple]
    return RobotCost(
        name=name,
        peers=len(mission.peers(name)),
        tape_bytes=sum(cost.tape_bytes[party] for cost, party in own),
        bytes_sent=sum(cost.bytes_sent[party] for cost, party in own),
        memory=sum(cost.matching_memory for cost, _ in own),
        matching_seconds=sum(cost.matching_seconds or 0.0 for cost, _ in own),
    )
