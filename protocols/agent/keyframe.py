"""What an agent is given, what two agents show each other of a match, and what a user's verification says."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

from spdz.channels.telling import printable
from spdz.foundations.types import FloatArray

MAX_ID = (1 << 53) - 1
"""Largest number of a keyframe: what JSON keeps exactly."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """One place that a robot saw.

    Attributes:
        id: The robot's own number of it.
        vector: What was compared of it, shape (N,): the descriptor, or all descriptors of a place end to end.
            Of the other robot's keyframe it is the vector that its MAC proves to be the one compared.
        payload: What the robot shows of it to a peer that it matched with; opaque to the agent.
        stamp: The robot's own time of it in seconds, if it has one.
    """

    id: int
    vector: FloatArray | None = field(default=None, repr=False)
    payload: bytes = field(default=b"", repr=False)
    stamp: float | None = None


@dataclass(frozen=True, slots=True)
class Meeting:
    """A candidate whose keyframes both robots have shown each other.

    Attributes:
        peer: The other robot.
        gallery: What was compared: a descriptor of the plan, or a place of several.
        own: This robot's keyframe.
        other: The peer's.
    """

    peer: str
    gallery: str
    own: Keyframe
    other: Keyframe


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a verification found.

    Attributes:
        accepted: Whether the two keyframes show the same place, and the peer's payload is of the place that
            its vector describes.
        why: A few words for people, where it was not accepted.
        transform: The pose of the peer's keyframe in the own one's frame, as the user likes to write it.
        weight: How sure it is, or whatever a back end takes as a weight.

    Raises:
        ValueError: for numbers that are not finite, or anything else that is none of these.
    """

    accepted: bool
    why: str = ""
    transform: tuple[float, ...] | None = None
    weight: float | None = None

    def __post_init__(self) -> None:
        try:
            accepted = bool(self.accepted)
            transform = None if self.transform is None else tuple(float(number) for number in self.transform)
            weight = None if self.weight is None else float(self.weight)
        except (TypeError, ValueError, OverflowError):
            raise ValueError("a verdict is True or False, with a transform and a weight of numbers") from None
        numbers = (*(transform or ()), *(() if weight is None else (weight,)))
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError("a verdict's transform and weight are finite numbers")
        if not isinstance(self.why, str):
            raise ValueError("a verdict says why in a text")
        fields = {"accepted": accepted, "why": printable(self.why), "transform": transform, "weight": weight}
        for name, value in fields.items():  # NumPy's numbers, say: what is kept is Python's
            object.__setattr__(self, name, value)


Verify: TypeAlias = Callable[[Meeting], Verdict]
"""A user's verification: called in a thread of the agent's own, one meeting at a time."""


def is_stamp(number: float) -> bool:
    """Whether a number, perhaps an integer of any size, is a time in seconds."""
    try:
        return math.isfinite(number)
    except OverflowError:
        return False


def check_id(number: object) -> int:
    """Accept a keyframe's number.

    Raises:
        ValueError: if it is none.
    """
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= MAX_ID:
        raise ValueError(f"a keyframe's number is an integer from 0 to 2^53 - 1, not {number!r:.40}")
    return number
