"""Where messages go: ROS names, and what DDS and Zenoh make of them.

Sources: the names and queue lengths of Swarm-SLAM's loop-closure detection node; design.ros2.org, "Topic and
Service name mapping to DDS" (``rt`` before the name); the design document of rmw_zenoh (keys
``<domain>/<topic>/<type>/<hash>``); the manual of zenoh-bridge-ros2dds (the name without its first slash).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from protocols.stacks.messages import GlobalDescriptors, InterRobotLoopClosure, InterRobotMatches, dds_name

DEPTH = 100
"""Messages that a queue holds, as in Swarm-SLAM; reliable and volatile."""

DESCRIPTORS = "cslam/global_descriptors"
KEYFRAME_DATA = "cslam/keyframe_data"
MATCHES = "/cslam/inter_robot_matches"
CLOSURES = "/cslam/inter_robot_loop_closure"
TYPES: dict[str, type] = {
    DESCRIPTORS: GlobalDescriptors,
    MATCHES: InterRobotMatches,
    CLOSURES: InterRobotLoopClosure,
}
HIGHEST_DOMAIN = 232

_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, slots=True)
class Topics:
    """The ROS names of what is read and written, absolute.

    Attributes:
        descriptors: The robot's own descriptors, read.
        keyframes: What it saw at its keyframes, read if payloads are wanted.
        matches: Written.
        closures: Written.
    """

    descriptors: str
    keyframes: str
    matches: str
    closures: str


def topics(
    namespace: str = "/",
    descriptors: str = DESCRIPTORS,
    keyframes: str = KEYFRAME_DATA,
    matches: str = MATCHES,
    closures: str = CLOSURES,
) -> Topics:
    """Resolve names as a ROS node in a namespace does.

    Args:
        namespace: The robot's namespace, such as ``/r0``.
        descriptors: Topic of the robot's own descriptors; relative to the namespace, or absolute.
        keyframes: Topic of what it saw at its keyframes; likewise.
        matches: Topic of the matches; likewise.
        closures: Topic of the loop closures; likewise.

    Raises:
        ValueError: for a name that ROS does not allow.
    """
    if namespace != "/" and not (namespace.startswith("/") and _NAME.fullmatch(namespace)):
        raise ValueError(f"a namespace is / or like /r0, not {namespace!r}")
    return Topics(*(resolve(name, namespace) for name in (descriptors, keyframes, matches, closures)))


def resolve(name: str, namespace: str = "/") -> str:
    """The absolute name of a topic.

    Raises:
        ValueError: for a name that ROS does not allow.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"a topic is words of letters, digits and _ with / between, such as {DESCRIPTORS}, not {name!r}"
        )
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


def check_domain(domain: int) -> int:
    """A ROS domain id.

    Raises:
        ValueError: if it is out of range.
    """
    if not 0 <= domain <= HIGHEST_DOMAIN:
        raise ValueError(f"a ROS domain is 0 to {HIGHEST_DOMAIN}, not {domain}")
    return domain


def dds_topic(name: str) -> str:
    """What a topic is called on DDS."""
    return f"rt{name}"


def rmw_key(name: str, kind: type, domain: int, type_hash: str) -> str:
    """The Zenoh key of a topic under rmw_zenoh.

    Args:
        name: The topic.
        kind: Its message.
        domain: The ROS domain.
        type_hash: The type's hash, ``TypeHashNotSupported`` on Humble, or ``*`` to hear both.
    """
    return f"{domain}{name}/{dds_name(kind)}/{type_hash}"


def bridge_key(name: str) -> str:
    """The Zenoh key of a topic behind zenoh-bridge-ros2dds."""
    return name.removeprefix("/")


def remapped(rules: Sequence[str]) -> dict[str, str]:
    """Arguments of :func:`topics` from rules such as ``cslam/global_descriptors:=/r0/own_descriptors``.

    Raises:
        ValueError: for a rule of another form, or a name that is not read or written here.
    """
    known = {
        DESCRIPTORS: "descriptors",
        KEYFRAME_DATA: "keyframes",
        MATCHES: "matches",
        CLOSURES: "closures",
    }
    found = {}
    for rule in rules:
        name, sign, topic = rule.partition(":=")
        if not sign or name not in known:
            raise ValueError(f"--remap is NAME:=TOPIC with a name of {', '.join(known)}, not {rule!r:.80}")
        found[known[name]] = topic
    return found
