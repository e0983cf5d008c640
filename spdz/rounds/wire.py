"""Field elements as bytes: 16 bytes each, little-endian, canonical or refused."""

from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import Buffer, FieldArray, Shape

ELEMENT_BYTES = 16


def to_bytes(array: npt.NDArray[Any]) -> memoryview:
    """View a NumPy array as bytes without copying (it is made contiguous if need be)."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def from_bytes(raw: Buffer, shape: Shape) -> FieldArray:
    """View a peer's bytes as elements of a shape.

    Raises:
        ProtocolViolation: if one is not below p.
    """
    words = np.frombuffer(raw, dtype=np.uint64).reshape((*shape, 2))
    if not field.is_canonical(words):
        raise not_canonical()
    return words


def not_canonical() -> ProtocolViolation:
    """What to raise for a number of the peer's that is not below p."""
    return ProtocolViolation("the peer sent a number that is not a field element (not below 2^127 - 1)")


def element_bytes(shape: Shape) -> int:
    """Bytes of so many elements."""
    return ELEMENT_BYTES * prod(shape)
