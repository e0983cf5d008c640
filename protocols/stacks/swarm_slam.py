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
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from protocols.stacks.closure import as_transform, inverse
from protocols.stacks.front import Found, Front, Told
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
from spdz.foundations.types import FloatArray

Announce: TypeAlias = Literal["verified", "candidate"]

MOST = 10
"""Matches of one message, as Swarm-SLAM's ``detection_publication_max_elems_per_msg``."""

_ALWAYS = 5
"""How many refusals of one kind are told one by one; later ones are told at powers of two."""


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
        shared: The ROS graph reaches other robots too: the robot of the smaller id alone publishes a closure.
        on_event: Told what was refused and why, in one sentence.
        clock: Seconds, for those that wait.
        counts: How many of everything.
        why: What the agent said last, by its event's name, with how often it said so.
    """

    front: Front
    role: Role
    announce: Announce = "verified"
    normalise: bool = False
    payloads: bool = False
    shared: bool = False
    on_event: Callable[[str], None] = lambda sentence: None
    clock: Callable[[], float] = time.monotonic
    counts: Counter[str] = field(default_factory=Counter)
    why: dict[str, tuple[int, str]] = field(default_factory=dict)
    _held: dict[int, bytes] = field(default_factory=dict)
    _pairing: Pairing = field(default_factory=Pairing)
    _states: dict[int, str] = field(default_factory=dict)
    _announced: set[tuple[int, str]] = field(default_factory=set)
    _matches: deque[InterRobotMatch] = field(default_factory=deque)
    _closures: deque[InterRobotLoopClosure] = field(default_factory=deque)

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

    def heard(self, event: Told) -> None:
        """Keep what the agent says."""
        count, _ = self.why.get(event.name, (0, ""))
        self.why[event.name] = (count + 1, event.text)

    def found(self, match: Found) -> None:
        """Take a match of the agent, or its next state."""
        if self._states.get(match.number) == match.state:
            return
        peer = self.role.ids.get(match.peer)
        if peer is None or peer == self.role.id:
            self._refuse(
                "foreign match",
                f"match {match.number} is with {match.peer!r}, who is "
                f"{'this robot itself' if peer is not None else 'not in the plan'}: not published",
            )
            return
        self._states[match.number] = match.state
        self.counts[match.state] += 1
        if match.state == self.announce:
            self._announce(match, peer)
        if match.state in ("verified", "rejected"):
            self._close(match, peer)

    def outgoing(self) -> list[InterRobotMatches | InterRobotLoopClosure]:
        """What is to be published now; what waited too long for its payload is refused."""
        for keyframe in self._pairing.late(self.clock()):
            del self._held[keyframe]
            self._refuse(
                "no keyframe data", f"keyframe {keyframe} came without what the robot saw there: refused"
            )
        messages: list[InterRobotMatches | InterRobotLoopClosure] = []
        while self._matches:
            some = [self._matches.popleft() for _ in range(min(MOST, len(self._matches)))]
            messages.append(InterRobotMatches(self.role.id, tuple(some)))
        messages += self._closures
        self._closures.clear()
        return messages

    def report(self) -> dict[str, object]:
        """All counts, and what the agent said last of each kind."""
        waiting = {"waiting for keyframe data": len(self._pairing)} if self.payloads else {}
        agent = {name: {"times": count, "last": text} for name, (count, text) in self.why.items()}
        return {**self.counts, **waiting, "agent": agent}

    def _take_one(self, descriptor: GlobalDescriptor, stamp: float | None) -> None:
        keyframe, robot = descriptor.keyframe_id, descriptor.robot_id
        if robot != self.role.id:
            self._refuse(
                "foreign robot",
                f"a descriptor of robot {robot} came where only those of robot {self.role.id} belong: refused. "
                "What comes over the air is broadcast in the clear, perhaps this robot's too",
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
        problem = _problem(vector, self.role.dim, self.normalise)
        if problem:
            self._refuse("descriptor", f"keyframe {keyframe}: {problem}; refused")
            return
        self._held[keyframe] = digest
        if self.normalise:
            vector /= np.linalg.norm(vector)
        payload = self._pairing.descriptor(keyframe, vector, stamp, self.clock()) if self.payloads else b""
        if payload is not None:
            self._add(keyframe, vector, payload, stamp)

    def _add(self, keyframe: int, vector: FloatArray, payload: bytes, stamp: float | None) -> None:
        try:
            self.front.add(keyframe, {self.role.descriptor: vector}, payload=payload, stamp=stamp)
        except ValueError as error:
            del self._held[keyframe]
            self._refuse("agent", f"keyframe {keyframe}: {error}; refused")
        else:
            self.counts["added"] += 1

    def _announce(self, match: Found, peer: int) -> None:
        if (match.keyframe, match.peer) in self._announced:
            self.counts["further"] += 1
            return
        self._announced.add((match.keyframe, match.peer))
        weight = self.role.weight if match.weight is None else float(match.weight)
        mine, other = (self.role.id, match.keyframe), (peer, match.peer_keyframe)
        self._matches.append(InterRobotMatch(*min(mine, other), *max(mine, other), weight))
        self.counts["published"] += 1

    def _close(self, match: Found, peer: int) -> None:
        first = self.role.id < peer
        if self.shared and not first:
            return
        transform = Transform()
        if match.state == "verified":
            if match.transform is None:
                self.counts["verified without a transform"] += 1
                return
            try:
                transform = as_transform(match.transform)
            except ValueError as error:
                self._refuse("transform", f"match {match.number} has no loop closure: {error}")
                return
            transform = transform if first else inverse(transform)
        mine, other = (match.keyframe, self.role.id), (match.peer_keyframe, peer)
        ends = (*mine, *other) if first else (*other, *mine)
        self._closures.append(InterRobotLoopClosure(*ends, match.state == "verified", transform))
        self.counts["closures"] += 1

    def _refuse(self, reason: str, sentence: str) -> None:
        self.counts[f"refused: {reason}"] += 1
        count = self.counts[f"refused: {reason}"]
        if count <= _ALWAYS or count & (count - 1) == 0:
            self.on_event(sentence if count <= _ALWAYS else f"{sentence} ({count} times by now)")


def _problem(vector: FloatArray, dim: int, normalise: bool) -> str | None:
    """Why a descriptor cannot be one of this plan, or None; its norm is looked at by the agent."""
    if vector.shape != (dim,):
        return f"its descriptor has {vector.size} numbers, the plan says {dim}"
    if not np.isfinite(vector).all():
        return "its descriptor has a number that is not finite"
    if normalise and not np.linalg.norm(vector) > 0:
        return "its descriptor is zero, which cannot be normalised"
    return None
