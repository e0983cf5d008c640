"""A robot's end of its ROS 2 graph over DDS, by ``cyclonedds`` and without ROS.

Types are final and named as ROS 2 names them, data is XCDR version 1, topics begin with ``rt``: so it hears
ROS 2 nodes and is heard. The domain is bound to the loopback interface unless the environment variable
``CYCLONEDDS_URI`` says otherwise: a descriptor that is written on a network interface is anybody's, and
nothing here could keep it private then.
"""

from __future__ import annotations

import os
import types
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocols.stacks.codec import Codec, from_foreign
from protocols.stacks.messages import (
    GlobalDescriptors,
    InterRobotLoopClosure,
    InterRobotMatches,
    dds_name,
    wire_fields,
)
from protocols.stacks.missing import needs
from protocols.stacks.topics import DEPTH, Topics, check_domain, dds_topic
from protocols.stacks.transport import Incoming, Outgoing, Payload, require_public

LOOPBACK = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast>"
    '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
"""As ROS 2's ``ROS_LOCALHOST_ONLY=1`` has it: loopback, found by unicast."""

_ARM = "; where it has no wheel (ARM), use --transport zenoh"


def idl_types(*kinds: type) -> dict[type, Any]:
    """Cyclone's types of messages and of all that is in them.

    Raises:
        ValueError: if ``cyclonedds`` is not installed.
    """
    made: dict[type, Any] = {}
    for kind in kinds:
        _idl_type(kind, made)
    return made


def _idl_type(kind: type, made: dict[type, Any]) -> Any:
    with needs("cyclonedds", _ARM):
        from cyclonedds.idl import IdlStruct, annotations
        from cyclonedds.idl import types as idl
    if kind in made:
        return made[kind]
    many: Any = idl.sequence
    hints: dict[str, Any] = {}
    for field in wire_fields(kind):
        if isinstance(field.base, type):
            base = _idl_type(field.base, made)
        else:
            base = {"string": str, "bool": bool}.get(field.base) or getattr(idl, field.base)
        hints[field.name] = many[base] if field.many else base
    body = {"__annotations__": hints, "__module__": __name__}
    bare = types.new_class(
        kind.__name__, (IdlStruct,), {"typename": dds_name(kind)}, lambda space: space.update(body)
    )
    made[kind] = annotations.final(dataclass(bare))
    return made[kind]


def to_idl(message: Any, made: dict[type, Any]) -> Any:
    """A message as an object of Cyclone's type."""
    values = {}
    for field in wire_fields(type(message)):
        value = getattr(message, field.name)
        if isinstance(field.base, type):
            value = [to_idl(one, made) for one in value] if field.many else to_idl(value, made)
        values[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return made[type(message)](**values)


class Dds:
    """Reads the robot's own descriptors, writes its public messages.

    Attributes:
        where: For people.
    """

    def __init__(self, names: Topics, domain: int = 0, *, payload: type | None = None) -> None:
        """Join the domain.

        Args:
            names: The topics.
            domain: The ROS domain.
            payload: The message that tells what the robot saw; None if payloads are not wanted.

        Raises:
            ValueError: if ``cyclonedds`` is not installed, or for a domain out of range.
            OSError: if the domain cannot be joined.
        """
        with needs("cyclonedds", _ARM):
            from cyclonedds.core import (
                DDSException,
                InstanceState,
                ReadCondition,
                SampleState,
                ViewState,
                WaitSet,
            )
            from cyclonedds.domain import Domain, DomainParticipant
            from cyclonedds.pub import DataWriter
            from cyclonedds.sub import DataReader
            from cyclonedds.topic import Topic
        kinds = (GlobalDescriptors, InterRobotMatches, InterRobotLoopClosure, *([payload] if payload else []))
        self._types = idl_types(*kinds)
        self._codec = Codec() if payload else None
        own = not os.environ.get("CYCLONEDDS_URI")
        self.where = f"DDS domain {domain} on {'loopback' if own else 'what CYCLONEDDS_URI says'}"
        try:
            self._domain = Domain(check_domain(domain), LOOPBACK) if own else None
            self._participant = DomainParticipant(domain)
            quality = _quality()

            def topic(name: str, kind: type) -> Any:
                return Topic(self._participant, dds_topic(name), self._types[kind], qos=quality)

            self._readers = {
                kind: DataReader(self._participant, topic(name, kind), qos=quality)
                for name, kind in ((names.descriptors, GlobalDescriptors), (names.keyframes, payload))
                if kind is not None
            }
            self._writers = {
                kind: DataWriter(self._participant, topic(name, kind), qos=quality)
                for name, kind in (
                    (names.matches, InterRobotMatches),
                    (names.closures, InterRobotLoopClosure),
                )
            }
            self._waiting = WaitSet(self._participant)
            for reader in self._readers.values():
                state = SampleState.Any | ViewState.Any | InstanceState.Any
                self._waiting.attach(ReadCondition(reader, state))
        except DDSException as error:
            raise OSError(f"cannot join {self.where}: {error}") from error

    def take(self, seconds: float) -> list[Incoming]:
        """What has come; waits up to so many seconds for the first."""
        self._waiting.wait(timeout=max(1, int(seconds * 1e9)))
        found: list[Incoming] = []
        for kind, reader in reversed(self._readers.items()):
            for _ in range(DEPTH):
                message = self._take_one(kind, reader)
                if message is None:
                    break
                found.append(message)
        return found

    def _take_one(self, kind: type, reader: Any) -> Incoming | None:
        from cyclonedds.internal import InvalidSample

        try:
            samples = reader.take(1)
            while samples and isinstance(samples[0], InvalidSample):  # a writer has gone
                samples = reader.take(1)
            if not samples:
                return None
            message: Any = from_foreign(kind, samples[0])
        except Exception as error:  # what Cyclone's reading of foreign bytes raises is not told by type
            return ValueError(f"a message on {reader.topic.name} is no {kind.__name__}: {error}")
        if isinstance(message, GlobalDescriptors):
            return message
        if self._codec is None:  # no reader of keyframes was made
            return ValueError(f"a message on {reader.topic.name} was not asked for")
        return Payload(message.id, self._codec.encode(message))

    def publish(self, message: Outgoing) -> None:
        """Send a public message.

        Raises:
            ValueError: for any other.
            OSError: if it cannot be written.
        """
        from cyclonedds.core import DDSException

        require_public(message)
        try:
            self._writers[type(message)].write(to_idl(message, self._types))
        except DDSException as error:
            raise OSError(f"a message could not be written on {self.where}: {error}") from error

    def silence(self) -> None:
        """None: a DDS graph needs nobody in its middle."""
        return None

    def writers(self) -> int:
        """How many others write descriptors."""
        return len(self._readers[GlobalDescriptors].get_matched_publications())

    def has_reader(self) -> bool:
        """Whether anybody reads matches or loop closures."""
        return any(writer.get_matched_subscriptions() for writer in self._writers.values())

    def close(self) -> None:
        """Leave the domain."""
        if self._readers:
            self._readers.clear()
            self._writers.clear()
            del self._waiting, self._participant, self._domain  # entities end when nothing holds them


def _quality() -> Any:
    from cyclonedds.qos import Policy, Qos

    return Qos(
        Policy.Reliability.Reliable(max_blocking_time=100_000_000),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTH),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
    )
