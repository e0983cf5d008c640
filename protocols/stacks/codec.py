"""The bytes of messages, as bags and Zenoh carry them: CDR, version 1, by ``rosbags``.

The same bytes as Cyclone's (a test holds one against the other), and readable on any machine: rosbags is pure
Python. Whatever a damaged or foreign message is, it ends as one :class:`ValueError`.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from protocols.stacks.messages import PACKAGES, definition, ros_name, wire_fields
from protocols.stacks.missing import needs

M = TypeVar("M")

LONGEST = 1 << 26
"""Most items of a sequence that are read: a picture or a cloud of 64 MB."""


class Codec:
    """Messages to bytes and back.

    Attributes:
        store: The types as rosbags has them, for bags.

    Raises:
        ValueError: if ``rosbags`` is not installed.
    """

    def __init__(self) -> None:
        with needs("rosbags"):
            from rosbags.typesys import get_types_from_msg
            from rosbags.typesys.store import Typestore
        self.store = Typestore(max_sequence_length=LONGEST)
        for kinds in PACKAGES.values():
            for kind in kinds:
                self.store.register(get_types_from_msg(definition(kind), ros_name(kind)))

    def encode(self, message: object) -> bytes:
        """The CDR bytes of a message, with their four bytes of encapsulation, little endian."""
        made = self._to_store(message)
        return bytes(self.store.serialize_cdr(made, ros_name(type(message)), little_endian=True))

    def decode(self, kind: type[M], data: bytes) -> M:
        """Read a message.

        Raises:
            ValueError: if the bytes are no such message.
        """
        from rosbags.serde import SerdeError

        try:
            return from_foreign(kind, self.store.deserialize_cdr(data, ros_name(kind)))
        except (SerdeError, IndexError, OverflowError) as error:
            raise ValueError(f"{len(data)} bytes are no {kind.__name__}: {error}") from error

    def type_hash(self, kind: type) -> str:
        """The hash of the type's description (REP 2016), as ROS 2 has it from Iron on."""
        return str(self.store.hash_rihs01(ros_name(kind)))

    def _to_store(self, message: Any) -> Any:
        made = {}
        for field in wire_fields(type(message)):
            value = getattr(message, field.name)
            if isinstance(field.base, type):
                value = [self._to_store(one) for one in value] if field.many else self._to_store(value)
            made[field.name] = value
        return self.store.types[ros_name(type(message))](**made)


def from_foreign(kind: type[M], foreign: Any) -> M:
    """One of our messages from an object with the same fields: rosbags', Cyclone's or rclpy's."""
    made: dict[str, Any] = {}
    for field in wire_fields(kind):
        value = getattr(foreign, field.name)
        if isinstance(field.base, type):
            base = field.base
            value = (
                tuple(from_foreign(base, one) for one in value) if field.many else from_foreign(base, value)
            )
        elif field.many:
            value = np.asarray(value, dtype=field.base)
        made[field.name] = value
    return kind(**made)
