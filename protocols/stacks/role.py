"""What the adapter needs of a mission's plan: who this robot is, and what its descriptors are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from protocols.mission import Mission
from protocols.scores import SCORES


@dataclass(frozen=True, slots=True)
class Role:
    """One robot of a plan, with the one kind of descriptor that its stack makes.

    Attributes:
        robot: Its name.
        ids: The integer of every robot of the plan, by name.
        descriptor: The plan's name of the descriptor.
        dim: Numbers of a descriptor.
        weight: What a match weighs whose verification gave no weight: the threshold, where the score is a
            similarity (the score is at least that); else 1.
        norms: The smallest and the largest L2 norm of a descriptor.
    """

    robot: str
    ids: Mapping[str, int]
    descriptor: str
    dim: int
    weight: float = 1.0
    norms: tuple[float, float] = (0.0, math.inf)

    @property
    def id(self) -> int:
        """This robot's integer."""
        return self.ids[self.robot]


def role_of(mission: Mission, robot: str, descriptor: str | None = None) -> Role:
    """What a robot's stack has to do in a mission.

    Args:
        mission: The plan.
        robot: Its name.
        descriptor: The plan's name of what its stack makes; None where the plan has one descriptor.

    Raises:
        ValueError: if it is not said which of several descriptors, or what is compared needs several at once.
    """
    names = [one.name for one in mission.descriptors]
    if descriptor is None and len(names) > 1:
        raise ValueError(f"say with --descriptor which one the robot's stack makes: {', '.join(names)}")
    plan = mission.descriptor(names[0] if descriptor is None else descriptor)
    for gallery in mission.galleries:
        if plan in gallery.descriptors and (len(gallery.descriptors) > 1 or plan.turns > 1):
            raise ValueError(
                f"{gallery.name} compares several descriptors of a keyframe at once, and a topic brings one "
                "of them: give them to the agent from Python (docs/swarm-slam.md)"
            )
    similarity = SCORES[plan.purpose.score].similarity
    return Role(
        robot,
        {agent.name: agent.id for agent in mission.agents},
        plan.name,
        plan.purpose.dim,
        plan.threshold if similarity else 1.0,
        (plan.purpose.min_norm, plan.purpose.max_norm),
    )
