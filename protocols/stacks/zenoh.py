"""A robot's end of its ROS 2 graph over Zenoh, by ``eclipse-zenoh``, which has wheels for ARM.

Keys are those of ROS 2's own middleware ``rmw_zenoh``, or of ``zenoh-bridge-ros2dds``, which carries a graph
that is on DDS. Payloads are the same CDR bytes as on DDS. Congestion control is *block*: Zenoh's default
drops a message where a queue is full.

The session is that of ROS 2's nodes: a peer that meets the robot's own router on the loopback interface. A
file that the environment variable ``ZENOH_SESSION_CONFIG_URI`` names takes its place, as it does for
rmw_zenoh.
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import struct
import time
from itertools import count
from typing import Any, Literal, TypeAlias

from protocols.stacks.codec import Codec
from protocols.stacks.messages import GlobalDescriptors, InterRobotLoopClosure, InterRobotMatches
from protocols.stacks.missing import needs
from protocols.stacks.topics import DEPTH, Topics, bridge_key, check_domain, rmw_key
from protocols.stacks.transport import Incoming, Outgoing, Payload, require_public

Keys: TypeAlias = Literal["rmw", "bridge"]

SESSION = """{
  mode: "peer",
  connect: { endpoints: ["tcp/localhost:7447"] },
  listen: { endpoints: ["tcp/localhost:0"] },
  scouting: { multicast: { enabled: false } },
}"""
"""As rmw_zenoh's default session: the robot's router, found on loopback; nothing listens elsewhere."""

HUMBLE_HASH = "TypeHashNotSupported"
"""What stands for the type's hash where ROS 2 has none: on Humble."""

_FULL = 1.0
"""Seconds that Zenoh's thread waits for room; what finds none by then is lost, and counted."""


class Zenoh:
    """Reads the robot's own descriptors, writes its public messages.

    Attributes:
        where: For people.
    """

    def __init__(
        self,
        names: Topics,
        domain: int = 0,
        *,
        payload: type | None = None,
        keys: Keys = "rmw",
        session: str | None = None,
    ) -> None:
        """Open the session.

        Args:
            names: The topics.
            domain: The ROS domain (rmw_zenoh has it in its keys).
            payload: The message that tells what the robot saw; None if payloads are not wanted.
            keys: Whose keys.
            session: A Zenoh configuration as JSON5; None for the default, or what the environment names.

        Raises:
            ValueError: if ``eclipse-zenoh`` or ``rosbags`` is not installed, or for a bad configuration.
            OSError: if no session can be opened.
        """
        with needs("eclipse-zenoh"):
            import zenoh as library
        zenoh: Any = library  # its type stubs say otherwise of what is used here
        check_domain(domain)
        self._codec = Codec()
        self._inbox: queue.Queue[tuple[type, bytes]] = queue.Queue(DEPTH)
        self._lost = 0
        self._sent, self._gid = count(1), secrets.token_bytes(16)
        file = os.environ.get("ZENOH_SESSION_CONFIG_URI")
        self.where = f"Zenoh, keys of {'rmw_zenoh' if keys == 'rmw' else 'zenoh-bridge-ros2dds'}"
        try:
            if session is None and file:
                config = zenoh.Config.from_file(file.removeprefix("file://"))
            else:
                config = zenoh.Config.from_json5(session or SESSION)
        except zenoh.ZError as error:
            raise ValueError(f"a Zenoh configuration that cannot be read: {error}") from error
        self._endpoints = ", ".join(_endpoints(config)) or "any endpoint"

        def heard(kind: type) -> Any:
            return lambda sample: self._heard(kind, sample.payload.to_bytes())

        try:
            self._session = zenoh.open(config)
            self._listening = [
                self._session.declare_subscriber(
                    self._keys(name, kind, domain, keys, hear=True)[0], heard(kind)
                )
                for name, kind in ((names.descriptors, GlobalDescriptors), (names.keyframes, payload))
                if kind is not None
            ]
            self._publishers = {
                kind: [
                    self._session.declare_publisher(
                        key,
                        congestion_control=zenoh.CongestionControl.BLOCK,
                        reliability=zenoh.Reliability.RELIABLE,
                    )
                    for key in self._keys(name, kind, domain, keys)
                ]
                for name, kind in (
                    (names.matches, InterRobotMatches),
                    (names.closures, InterRobotLoopClosure),
                )
            }
        except zenoh.ZError as error:
            raise OSError(f"cannot open a session of {self.where}: {error}") from error

    def _keys(self, name: str, kind: type, domain: int, keys: Keys, *, hear: bool = False) -> list[str]:
        """Where a topic is heard or written: with either form of the type's hash under rmw_zenoh."""
        if keys == "bridge":
            return [bridge_key(name)]
        hashes = ["*"] if hear else [self._codec.type_hash(kind), HUMBLE_HASH]
        return [rmw_key(name, kind, domain, each) for each in hashes]

    def _heard(self, kind: type, data: bytes) -> None:
        try:
            self._inbox.put((kind, data), timeout=_FULL)
        except queue.Full:
            self._lost += 1

    def take(self, seconds: float) -> list[Incoming]:
        """What has come; waits up to so many seconds for the first."""
        found: list[Incoming] = []
        try:
            found.append(self._read(*self._inbox.get(timeout=max(seconds, 1e-3))))
            while len(found) < DEPTH:
                found.append(self._read(*self._inbox.get_nowait()))
        except queue.Empty:
            pass
        if self._lost:
            found.append(
                ValueError(f"{self._lost} messages were lost: they came faster than they were taken")
            )
            self._lost = 0
        return found

    def _read(self, kind: type, data: bytes) -> Incoming:
        try:
            message: Any = self._codec.decode(kind, data)
        except ValueError as error:
            return error
        return message if isinstance(message, GlobalDescriptors) else Payload(message.id, data)

    def publish(self, message: Outgoing) -> None:
        """Send a public message.

        Raises:
            ValueError: for any other.
            OSError: if it cannot be written.
        """
        import zenoh

        require_public(message)
        data = self._codec.encode(message)
        try:
            for publisher in self._publishers[type(message)]:
                publisher.put(data, attachment=attachment(next(self._sent), time.time_ns(), self._gid))
        except zenoh.ZError as error:
            raise OSError(f"a message could not be written on {self.where}: {error}") from error

    def silence(self) -> str | None:
        """That neither router nor peer answers, or None."""
        info = self._session.info
        if info.routers_zid() or info.peers_zid():
            return None
        return (
            f"no Zenoh router or peer answers at {self._endpoints}: start the robot's router, or name "
            "another configuration with ZENOH_SESSION_CONFIG_URI"
        )

    def writers(self) -> None:
        """None: Zenoh does not tell."""
        return None

    def has_reader(self) -> bool:
        """Whether anybody reads matches or loop closures."""
        return any(one.matching_status.matching for each in self._publishers.values() for one in each)

    def close(self) -> None:
        """Close the session."""
        self._session.close()


def _endpoints(config: Any) -> list[str]:
    """Where a session looks for others: a list, or one for each mode."""
    found = json.loads(config.get_json("connect/endpoints"))
    lists = found.values() if isinstance(found, dict) else [found]
    return [str(one) for each in lists for one in each]


def attachment(number: int, stamp: int, gid: bytes) -> bytes:
    """What rmw_zenoh wants beside every message; it drops one without.

    Args:
        number: Counts the writer's messages from 1.
        stamp: Nanoseconds since 1970.
        gid: 16 bytes that tell writers apart.

    Source: ``AttachmentData`` of rmw_zenoh, in Zenoh's serialization: two little-endian 64-bit integers, then
    the length of the id and the id.
    """
    return struct.pack("<qqB", number, stamp, len(gid)) + gid
