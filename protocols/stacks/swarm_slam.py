"""Swarm-SLAM's private front end, without I/O: descriptors in, matches and loop closures out.

It stands where Swarm-SLAM has its loop-closure detection node. That node broadcasts the descriptors of all
keyframes and compares what it hears. This one gives the robot's own descriptors to its agent, which compares
them privately, and publishes what the agent found: the first match of each keyframe with each peer, where
that node publishes the best, and a loop closure for every match that was verified.

Whatever is wrong with a message is refused by name and counted, and the rest goes on.
"""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from protocols.stacks.closure import as_transform, inverse
from protocols.stacks.front import Found, Front
from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    InterRobotLoopClosure,
    InterRobotMatch,
    InterRobotMatches,
    Transform,
)
from protocols.stacks.pairing import Pairing
from protocols.stacks.role import Role
from protocols.stacks.topics import KEYFRAME_DATA
from protocols.stacks.transport import Outgoing
from spdz.foundations.errors import SpdzError
from spdz.foundations.types import FloatArray

Announce: TypeAlias = Literal["verified", "candidate"]

End: TypeAlias = tuple[int, int]
"""A robot's id and its keyframe."""

MAX_UINT32 = (1 << 32) - 1
_WEIGHTS = float(np.finfo(np.float32).min), float(np.finfo(np.float32).max)

_ALWAYS = 5
"""How many refusals of one kind are told one by one; later ones are told at powers of two."""

_NEARLY = 0.01
"""How far a norm may be off, as a share of it, to be left to the agent, which knows it to the last digit."""


@dataclass(slots=True)
class SwarmSlam:
    """The adapter of one robot.

    Attributes:
        front: The robot's agent.
        role: What the plan says of the robot.
        announce: When a match is published: once it is verified, or as a candidate, when it is as little
            known to be true as those of Swarm-SLAM's own node.
        normalise: Divide each descriptor by its norm: S10 of the results is the cosine.
        payloads: Wait for what the robot saw at a keyframe, and give it to the agent with the descriptor.
        team: Descriptors of other robots are to be expected, as in a bag of a whole team: counted, not told.
        shared: The ROS graph reaches other robots too: the robot of the smaller id alone publishes a closure.
        on_event: Told what was refused and why, in one sentence.
        clock: Seconds, for those that wait.
        counts: How many of everything.
    """

    front: Front
    role: Role
    announce: Announce = "verified"
    normalise: bool = False
    payloads: bool = False
    team: bool = False
    shared: bool = False
    on_event: Callable[[str], None] = lambda sentence: None
    clock: Callable[[], float] = time.monotonic
    counts: Counter[str] = field(default_factory=Counter)
    _held: dict[int, bytes] = field(default_factory=dict)
    _pairing: Pairing = field(default_factory=Pairing)
    _first: dict[tuple[str, int], int] = field(default_factory=dict)
    _last: int = 0
    _untold: Counter[str] = field(default_factory=Counter)

    @property
    def untold(self) -> int:
        """Refusals that no sentence has told of so far."""
        return self._untold.total()

    def take(self, message: GlobalDescriptors, stamp: float | None = None) -> None:
        """Give the robot's own descriptors of a message to its agent.

        Args:
            message: As it came.
            stamp: Seconds, of the message.
        """
        for descriptor in message.descriptors:
            self.counts["received"] += 1
            self._take_one(descriptor, stamp)

    def saw(self, keyframe: int, payload: bytes) -> None:
        """Take what the robot saw at a keyframe."""
        waiting = self._pairing.payload(keyframe, payload)
        if waiting is not None:
            self._add(keyframe, waiting.vector, payload, waiting.stamp)

    def unreadable(self, error: ValueError) -> None:
        """Count a message that could not be read."""
        self._refuse("unreadable", str(error))

    def found(self, match: Found) -> list[Outgoing]:
        """Take news of a match; returns what is to be published of it."""
        if match.number <= self._last:
            return []
        self._last = match.number
        peer = self.role.ids.get(match.peer)
        if peer is None or peer == self.role.id:
            whose = "this robot itself" if peer is not None else "not in the plan"
            self._refuse(
                "foreign match", f"a match with {match.peer!r:.40}, who is {whose}, is not published"
            )
            return []
        self.counts[match.state] += 1
        if match.keyframe is None or match.peer_keyframe is None:  # the peer has not shown its own yet
            return []
        pair = (self.role.id, match.keyframe), (peer, match.peer_keyframe)
        if max(match.keyframe, match.peer_keyframe) > MAX_UINT32:
            sentence = f"a match with keyframe {match.peer_keyframe} of {match.peer} is not published"
            self._refuse("foreign match", f"{sentence}: ROS messages hold keyframes up to {MAX_UINT32}")
            return []
        messages: list[Outgoing] = []
        if match.state == "verified" or self.announce == "candidate":
            messages += self._announced(match, *pair)
        if match.state in ("verified", "rejected"):
            messages += self._closed(match, *pair)
        return messages

    def late(self) -> None:
        """Refuse the descriptors that have waited too long for what was seen at their keyframes."""
        for keyframe in self._pairing.late(self.clock()):
            del self._held[keyframe]
            sentence = f"keyframe {keyframe} came without what was seen there ({KEYFRAME_DATA}): refused"
            self._refuse("no keyframe data", sentence)

    def report(self, status: Mapping[str, Any]) -> dict[str, Any]:
        """What came and what became of it, JSON-ready.

        Args:
            status: The agent's, which says for each peer what has matched, or why nothing has.
        """
        counts = dict(self.counts)
        if self.payloads:
            counts["waiting for keyframe data"] = len(self._pairing)
        galleries = [one for one in status["galleries"] if one["gallery"] == self.role.descriptor]
        return {
            "counts": counts,
            "matches": {one["peer"]: dict(one["matches"]) for one in galleries},
            "why": {one["peer"]: dict(one["why"]) for one in galleries if one["why"]["text"]},
        }

    def _take_one(self, descriptor: GlobalDescriptor, stamp: float | None) -> None:
        keyframe, robot = descriptor.keyframe_id, descriptor.robot_id
        if robot != self.role.id and self.team:
            self.counts["of other robots"] += 1
            return
        if robot != self.role.id:
            self._refuse(
                "foreign robot",
                f"a descriptor of robot {robot} came where those of robot {self.role.id} belong: refused. If "
                "it came over the air, perhaps this robot's are broadcast in the clear too",
            )
            return
        vector = np.array(descriptor.descriptor, dtype=np.float64)
        digest = hashlib.sha256(vector.tobytes()).digest()
        if keyframe in self._held:
            if self._held[keyframe] == digest:
                self.counts["repeated"] += 1
            else:
                self._refuse(
                    "twice", f"keyframe {keyframe} came twice, with two descriptors: the first one stays"
                )
            return
        problem = _problem(vector, self.role, self.normalise)
        if problem:
            self._refuse("descriptor", f"keyframe {keyframe}: {problem}; refused")
            return
        self._held[keyframe] = digest
        if self.normalise:
            vector /= np.abs(vector).max()  # so that no square overflows
            vector /= np.linalg.norm(vector)
        payload = self._pairing.descriptor(keyframe, vector, stamp, self.clock()) if self.payloads else b""
        if payload is not None:
            self._add(keyframe, vector, payload, stamp)

    def _add(self, keyframe: int, vector: FloatArray, payload: bytes, stamp: float | None) -> None:
        try:
            self.front.add(keyframe, {self.role.descriptor: vector}, payload=payload, stamp=stamp)
        except (ValueError, SpdzError, OSError) as error:
            del self._held[keyframe]
            why = str(error).removeprefix(f"keyframe {keyframe}: ")
            self._refuse("agent", f"keyframe {keyframe}: {why}; refused")
        else:
            self.counts["added"] += 1

    def _announced(self, match: Found, own: End, other: End) -> list[Outgoing]:
        """The match, if it is the keyframe's first with this peer; the smaller robot id comes first."""
        if (match.peer, own[1]) in self._first:
            self.counts["further"] += match.match != self._first[match.peer, own[1]]
            return []
        self._first[match.peer, own[1]] = match.match
        self.counts["published"] += 1
        weight = self.role.weight if match.weight is None else float(np.clip(match.weight, *_WEIGHTS))
        return [
            InterRobotMatches(self.role.id, (InterRobotMatch(*min(own, other), *max(own, other), weight),))
        ]

    def _closed(self, match: Found, own: End, other: End) -> list[Outgoing]:
        """The loop closure of a match that was looked at."""
        first = own < other
        if self.shared and not first:
            return []
        transform = Transform()
        if match.state == "verified":
            if match.transform is None:
                self.counts["verified without a transform"] += 1
                return []
            try:
                transform = as_transform(match.transform)
            except ValueError as error:
                self._refuse(
                    "transform", f"match {match.match} with {match.peer} has no loop closure: {error}"
                )
                return []
            transform = transform if first else inverse(transform)
        self.counts["closures"] += 1
        (robot0, keyframe0), (robot1, keyframe1) = min(own, other), max(own, other)
        good = match.state == "verified"
        return [InterRobotLoopClosure(keyframe0, robot0, keyframe1, robot1, good, transform)]

    def _refuse(self, reason: str, sentence: str) -> None:
        self.counts[f"refused: {reason}"] += 1
        count = self.counts[f"refused: {reason}"]
        if count <= _ALWAYS or count & (count - 1) == 0:
            self.on_event(sentence if count <= _ALWAYS else f"{sentence} ({count} times by now)")
            self._untold[reason] = 0
        else:
            self._untold[reason] += 1


def _problem(vector: FloatArray, role: Role, normalise: bool) -> str | None:
    """Why a descriptor cannot be one of this plan, or None; norms that are nearly right are the agent's."""
    if vector.shape != (role.dim,):
        return f"its descriptor has {vector.size} numbers, the plan says {role.dim}"
    if not np.isfinite(vector).all():
        return "its descriptor has a number that is not finite"
    if normalise and not vector.any():
        return "its descriptor is zero, which cannot be normalised"
    return None if normalise else _wrong_norm(vector, *role.norms)


def _wrong_norm(vector: FloatArray, least: float, most: float) -> str | None:
    """What is said of a descriptor that was not brought to the norm that the plan is for, or None."""
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(vector))
    if least * (1 - _NEARLY) <= norm <= most * (1 + _NEARLY):
        return None
    remedy = "deal for other norms"
    if least <= 1 <= most:
        remedy = f"--normalise divides every descriptor by its norm; or {remedy}"
    return f"its descriptor has an L2 norm of {norm:.4g}, the plan says {least:g} to {most:g} ({remedy})"
