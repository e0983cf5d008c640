"""What compiled code calls for more than a few numbers, and for what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from spdz.arithmetic.field import P
from spdz.foundations.types import Buffer, FieldArray, FloatArray, IntArray, Shape
from spdz.rounds.wire import ELEMENT_BYTES, not_canonical
from spdz.values.input_mask import outside, unsuited

_EXACT = 53
"""float64 represents all integers of so many bits."""

LONGEST = 1 << 18
"""Coordinates of a dot product by limbs (:func:`product`)."""


def array_of(numbers: Any, shape: Shape) -> FieldArray:
    """Integers in [0, p), one or a sequence, as elements of a shape."""
    numbers = [numbers] if isinstance(numbers, int) else numbers
    packed = bytearray(b"".join([number.to_bytes(ELEMENT_BYTES, "little") for number in numbers]))
    return np.frombuffer(packed, dtype="<u8").reshape((*shape, 2))


def element_of(raw: Buffer) -> int:
    """A peer's element; ProtocolViolation if it is not below p."""
    number = int.from_bytes(raw, "little")
    if number >= P:
        raise not_canonical()
    return number


def elements_of(raw: Buffer) -> list[int]:
    """A peer's elements, likewise."""
    words = np.frombuffer(raw, dtype="<u8").tolist()
    numbers = [low | high << 64 for low, high in zip(words[::2], words[1::2], strict=True)]
    if max(numbers) >= P:
        raise not_canonical()
    return numbers


def decoded_element(number: int, frac: int) -> float:
    """An opened element as a float."""
    return (number - P if number > P >> 1 else number) / (1 << frac)


# -- words -----------------------------------------------------------------------------------------------


def hidden_words(x: IntArray, r: IntArray, low: int, high: int) -> IntArray:
    """``x - r``; Unsent unless all of it is in [low, high)."""
    words = x - r
    if words.min() < low or words.max() >= high:
        raise unsuited()
    return words


def check_hidden(words: list[int], low: int, high: int) -> None:
    """Unsent unless all words are in [low, high)."""
    if min(words) < low or max(words) >= high:
        raise unsuited()


def words_of(raw: Buffer, size: int, low: int, high: int) -> list[int]:
    """A peer's words of so many bytes; ProtocolViolation unless all are in [low, high)."""
    octets = np.frombuffer(raw, dtype=np.uint8).reshape(-1, size)
    full = np.zeros((len(octets), 8), dtype=np.uint8)
    full[:, :size] = octets
    words: list[int] = full.view("<i8").ravel().tolist()
    if min(words) < low or max(words) >= high:
        raise outside()
    return words


def mask_words(pad: FieldArray, bits: int) -> IntArray:
    """The masks -s that pads stand for."""
    words: IntArray = (pad[..., 0] & np.uint64((1 << bits) - 1)).view(np.int64)
    return -words


# -- dot products of two vectors ---------------------------------------------------------------------------


def word_limbs(words: IntArray, count: int, width: int) -> FloatArray:
    """Limbs of short integers, shape (count, N): all but the last are in [0, 2^width)."""
    limbs = np.empty((count, len(words)))
    low = np.int64((1 << width) - 1)
    for limb in limbs[:-1]:
        limb[...] = words & low
        words = words >> np.int64(width)
    limbs[-1] = words
    return limbs


def element_limbs(a: FieldArray) -> FloatArray:
    """The eight 16-bit limbs of elements, shape (8, N)."""
    limbs: FloatArray = np.ascontiguousarray(a).view("<u2").T.astype(np.float64, order="C")
    return limbs


def product(a: FloatArray, b: FloatArray, left: int, right: int) -> int:
    """The dot product of two vectors, from their limbs of so many bits: exact, not reduced.

    So many coordinates' products of limbs add up to at most 2^53, which float64 holds exactly. More are taken
    in pieces, whose sums are integers: of limbs of 22 bits 2^9 coordinates make a piece, and 2^9 pieces stay
    below 2^63.

    Args:
        a: Shape (K, N).
        b: Shape (L, N).
        left: Bits of a limb of a.
        right: Bits of a limb of b.
    """
    length = 1 << (_EXACT - left - right)
    if a.shape[1] <= length:
        return _joined((a @ b.T).tolist(), left, right)
    total = np.zeros((len(a), len(b)), dtype=np.int64)
    for start in range(0, a.shape[1], length):
        piece = slice(start, start + length)
        total += (a[:, piece] @ b[:, piece].T).astype(np.int64)
    return _joined(total.tolist(), left, right)


def _joined(products: Sequence[Sequence[float]], left: int, right: int) -> int:
    """sum_ij products_ij 2^(left i + right j)."""
    total = 0
    for row in reversed(products):
        inner = 0
        for number in reversed(row):
            inner = (inner << right) + int(number)
        total = (total << left) + inner
    return total
