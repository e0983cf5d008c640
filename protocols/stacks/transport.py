"""What the adapter needs of DDS, of Zenoh, or of anything else that carries messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from protocols.stacks.messages import PUBLISHED, GlobalDescriptors, InterRobotLoopClosure, InterRobotMatches


@dataclass(frozen=True, slots=True)
class Payload:
    """What a robot saw at a keyframe.

    Attributes:
        keyframe: Its number.
        data: The CDR bytes of the message that told it.
    """

    keyframe: int
    data: bytes = field(repr=False)


Incoming = GlobalDescriptors | Payload | ValueError
"""A message, or why one could not be read."""

Outgoing = InterRobotMatches | InterRobotLoopClosure


class Transport(Protocol):
    """One robot's end of its ROS graph."""

    where: str

    def take(self, seconds: float) -> list[Incoming]:
        """What has come; waits up to so many seconds for the first."""

    def publish(self, message: Outgoing) -> None:
        """Send a public message; ValueError for any other, and OSError if it cannot be written."""

    def silence(self) -> str | None:
        """Why nothing can come from the graph, nor get there; None if it is there, as far as is known."""

    def writers(self) -> int | None:
        """How many others write descriptors; None where that cannot be told."""

    def has_reader(self) -> bool:
        """Whether anybody reads what is published."""

    def close(self) -> None:
        """Leave the graph."""


def require_public(message: object) -> None:
    """Let public messages pass.

    Raises:
        ValueError: for everything else: descriptors and payloads go over the agents' TLS sessions alone.
    """
    if not isinstance(message, PUBLISHED):
        raise ValueError(
            f"{type(message).__name__} is not published: descriptors and what robots saw go over the agents' "
            "TLS sessions alone"
        )
