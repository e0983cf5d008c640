"""Field elements as bytes: 16 bytes each, little-endian, canonical or refused."""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import FieldArray, Shape
from spdz.rounds.coroutine import exchange

ELEMENT_BYTES = 16
NOT_CANONICAL = "the peer sent a number that is not a field element (not below 2^127 - 1)"


def to_bytes(array: npt.NDArray[Any]) -> memoryview:
    """View a NumPy array as bytes without copying (it is made contiguous if need be)."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


async def exchange_elements(own: Sequence[FieldArray], shapes: Sequence[Shape]) -> list[FieldArray]:
    """Send field arrays and receive the peer's, of the given shapes, in one round.

    Raises:
        ProtocolViolation: if an element that the peer sent is not below p.
    """
    sizes = [prod(shape) for shape in shapes]
    sent = sum(array.size // 2 for array in own)
    reply = await exchange([to_bytes(array) for array in own], sum(sizes) * ELEMENT_BYTES, sent)
    words = np.frombuffer(reply, dtype=np.uint64).reshape(-1, 2)
    if not field.is_canonical(words):
        raise ProtocolViolation(NOT_CANONICAL)
    arrays, start = [], 0
    for size, shape in zip(sizes, shapes, strict=True):
        arrays.append(words[start : start + size].reshape((*shape, 2)))
        start += size
    return arrays
