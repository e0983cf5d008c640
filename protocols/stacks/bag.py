"""Recorded messages of ROS 2: bags, read and written by ``rosbags``, without ROS.

A bag that an older ROS 2 recorded holds no definitions of its messages; those of
:mod:`protocols.stacks.messages` are used for all. Where a bag holds another definition it is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocols.stacks.codec import Codec
from protocols.stacks.messages import GlobalDescriptors, ros_name
from protocols.stacks.missing import needs
from protocols.stacks.transport import Incoming, Payload

NANOSECONDS = 1e-9


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message of a bag.

    Attributes:
        stamp: Seconds since 1970 at which it was recorded.
        message: What it was, or why it cannot be read.
    """

    stamp: float
    message: Incoming


class Bag:
    """A bag's descriptors, and what was seen at their keyframes, in the order of recording.

    Attributes:
        path: The bag's folder.
        topics: The topics that are read.
    """

    def __init__(self, path: Path, topic: str | None = None, payload: type | None = None) -> None:
        """Open a bag.

        Args:
            path: Its folder (or its ``.mcap`` file, or a bag of ROS 1).
            topic: The one topic of descriptors to read; None for all that there are.
            payload: The message that tells what the robot saw; None if payloads are not wanted.

        Raises:
            ValueError: if ``rosbags`` is not installed, or this is no bag, or it has no such topic, or its
                messages are defined otherwise.
        """
        with needs("rosbags"):
            from rosbags.highlevel import AnyReader, AnyReaderError
        if path.suffix == ".bag" and path.is_dir():
            raise ValueError(
                f"{path} is a folder, and a name that ends in .bag is a file of ROS 1: rename it"
            )
        self.path = path
        self._codec = Codec()
        self._kinds = {ros_name(kind): kind for kind in (GlobalDescriptors, payload) if kind is not None}
        try:
            self._reader = AnyReader([path], default_typestore=self._codec.store)
            self._reader.open()
        except (AnyReaderError, OSError, ValueError) as error:
            raise ValueError(f"{path} is no bag that can be read: {_first_line(error)}") from error
        try:
            self._connections = list(self._chosen(topic))
        except ValueError:
            self._reader.close()
            raise
        self.topics = sorted({connection.topic for connection in self._connections})

    def _chosen(self, topic: str | None) -> Iterator[Any]:
        wanted, found = ros_name(GlobalDescriptors), False
        for connection in self._reader.connections:
            kind = self._kinds.get(connection.msgtype)
            if kind is None or (kind is GlobalDescriptors and topic not in (None, connection.topic)):
                continue
            if connection.digest not in ("", None, self._codec.type_hash(kind)):
                raise ValueError(
                    f"{self.path}: the messages of {connection.topic} are defined in another way"
                )
            found = found or kind is GlobalDescriptors
            yield connection
        if not found:
            there = ", ".join(f"{one.topic} ({one.msgtype})" for one in self._reader.connections) or "nothing"
            named = f"topic {topic}" if topic else "topic"
            raise ValueError(f"{self.path} has no {named} of {wanted}; it has {there}")

    def __iter__(self) -> Iterator[Recorded]:
        """Read on to the end.

        Raises:
            ValueError: if the bag's file is damaged.
        """
        try:
            for connection, stamp, data in self._reader.messages(connections=self._connections):
                yield Recorded(stamp * NANOSECONDS, self._read(self._kinds[connection.msgtype], data))
        except Exception as error:  # of SQLite, LZ4, Zstandard or rosbags itself: they have no base in common
            raise ValueError(f"{self.path} cannot be read on: {_first_line(error)}") from error

    def _read(self, kind: type, data: bytes) -> Incoming:
        try:
            message: Any = self._codec.decode(kind, bytes(data))
        except ValueError as error:
            return error
        return message if isinstance(message, GlobalDescriptors) else Payload(message.id, bytes(data))

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def write_bag(path: Path, messages: Iterable[tuple[float, str, object]]) -> None:
    """Write a bag.

    Args:
        path: Its folder, which must not exist.
        messages: Stamp in seconds, topic and message, for each.

    Raises:
        ValueError: if ``rosbags`` is not installed, or the folder exists.
    """
    with needs("rosbags"):
        from rosbags.rosbag2 import Writer, WriterError
    codec = Codec()
    try:
        with Writer(path, version=9) as writer:
            connections: dict[tuple[str, str], Any] = {}
            for stamp, topic, message in messages:
                key = topic, ros_name(type(message))
                if key not in connections:
                    connections[key] = writer.add_connection(*key, typestore=codec.store)
                writer.write(connections[key], round(stamp / NANOSECONDS), codec.encode(message))
    except WriterError as error:
        raise ValueError(f"cannot write the bag {path}: {error}") from error
