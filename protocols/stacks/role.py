"""What the adapter needs of a mission's plan: who this robot is, and what its descriptors are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


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
    """

    robot: str
    ids: Mapping[str, int]
    descriptor: str
    dim: int
    weight: float = 1.0

    @property
    def id(self) -> int:
        """This robot's integer."""
        return self.ids[self.robot]
