"""Elements as signed numbers in base 2^32 that are not reduced mod p: sums first, one reduction last.

Such a number is ``int64`` words (w_0 .. w_3) and means sum_i w_i 2^32i mod p. A word has room for what sums
and small factors make of it, and every function says how much it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from functools import cached_property

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.foundations.types import FieldArray, FloatArray, IntArray

INTEGER_BITS = 160
"""No number is longer as a Python integer."""

_ROOM = 1 << 60
_SMALL = 1 << 20
_MOST_TERMS = 1 << 9  # weighed at a time: see _products
_16, _LOW16 = np.int64(16), np.int64((1 << 16) - 1)


def _offset() -> IntArray:
    """Four words in [2^60, 2^60 + 2^32) that add up to a multiple of p."""
    multiple = sum(_ROOM << 32 * i for i in range(4))
    words: IntArray = field.from_int(-multiple).view("<u4").astype(np.int64) + np.int64(_ROOM)
    return words


_OFFSET = _offset()
_OFFSET.flags.writeable = False


def words(a: FieldArray) -> IntArray:
    """Elements of shape S as words, shape S + (4,)."""
    return np.ascontiguousarray(a, dtype="<u8").view("<u4").astype(np.int64)


def elements(numbers: IntArray) -> FieldArray:
    """Words of shape S + (4,), below 2^60 in size, as elements of shape S."""
    # Raised, a word is between 0 and 2^61 + 2^32 < 2^62.
    return field.from_words32((numbers + _OFFSET).view(np.uint64))


def integers(numbers: IntArray) -> list[int]:
    """All numbers as Python integers that are right mod p, in C order."""
    rows = numbers.reshape(-1, 4).tolist()
    return [w0 + (w1 << 32) + (w2 << 64) + (w3 << 96) for w0, w1, w2, w3 in rows]


@dataclass(frozen=True)
class Weights:
    """Rows of public weights for :func:`weigh`, split once.

    Attributes:
        rows: Integers, all rows of one length k.
    """

    rows: Sequence[Sequence[int]] = attribute(repr=False)

    @cached_property
    def centred(self) -> list[list[int]]:
        """The weights mod p, in (-p/2, p/2)."""
        return [[(weight + P // 2) % P - P // 2 for weight in row] for row in self.rows]

    @cached_property
    def small(self) -> IntArray | None:
        """The weights of a single term, shape (rows, 1, 1); None if there are more, or one is larger."""
        column = [row[0] for row in self.centred if len(row) == 1 and abs(row[0]) < _SMALL]
        return np.array(column).reshape(-1, 1, 1) if len(column) == len(self.rows) else None

    @cached_property
    def limbs(self) -> FloatArray:
        """Limbs in base 2^16, the lowest first, the highest signed: shape (rows m, k)."""
        most = max(abs(weight) for row in self.centred for weight in row)
        count = most.bit_length() // 16 + 1
        split = [
            [weight >> 16 * a & 0xFFFF if a < count - 1 else weight >> 16 * a for weight in row]
            for row in self.centred
            for a in range(count)
        ]
        return np.array(split, dtype=np.float64)

    @cached_property
    def fold(self) -> FloatArray:
        """Limb a of a weight times part q of a word i, row 8 a + 4 q + i, to column a + 2 i + q mod 8.

        A column from 8 on counts twice, since 2^128 = 2.
        """
        count = len(self.limbs) // len(self.rows)
        matrix = np.zeros((8 * count, 8))
        for a in range(count):
            for q in range(2):
                for i in range(4):
                    place = a + 2 * i + q
                    matrix[8 * a + 4 * q + i, place % 8] = 1 << place // 8
        return matrix


def weigh(weights: Weights, signs: IntArray, numbers: IntArray, half: IntArray) -> IntArray:
    """The sums ``sum_i weights_i signs_i (numbers_i - half)`` over k terms, for every row of weights.

    Args:
        weights: The weights.
        signs: 1 or -1, shape (n, k).
        numbers: Words below 2^39 in size, shape (columns, n, k, 4).
        half: Words of elements, shape (columns, n, 1, 4).

    Returns:
        Words below 2^60 in size, shape (rows, columns, n, 4).
    """
    columns, n, k = numbers.shape[:3]
    if (small := weights.small) is not None:
        # Below (2^39 + 2^32) 2^20 < 2^60.
        sides = signs.reshape(-1).repeat(4)
        less = (numbers - half).reshape(columns, 4 * n)
        less *= sides
        return (less * small).reshape(len(small), columns, n, 4)
    total = np.zeros((len(weights.rows), columns, n, 4), dtype=np.int64)
    for start in range(0, k, _MOST_TERMS):
        part = slice(start, start + _MOST_TERMS)
        total += _products(weights, signs[:, part], numbers[:, :, part], half, part)
    return total


def _products(weights: Weights, signs: IntArray, numbers: IntArray, half: IntArray, part: slice) -> IntArray:
    """:func:`weigh` for some of the terms, as one small floating-point product a column and key (BLAS).

    Exact: a limb is at most 2^16 and half a word 2^23 in size. So 2^9 terms are below 2^48, their halves no
    more than another 2^48, and a column takes at most 8 of such sums, twice: 2^53.
    """
    signed = weights.limbs[:, part] * signs[:, np.newaxis]
    products = signed @ _split(numbers)
    products -= signed.sum(axis=-1)[..., np.newaxis] * _split(half)
    columns, n = products.shape[:2]
    folded = products.reshape(columns, n, len(weights.rows), -1) @ weights.fold
    digits = folded.astype(np.int64)
    carries = digits >> _16
    digits &= _LOW16
    digits[..., 1:] += carries[..., :-1]
    digits[..., 0] += carries[..., -1] << np.int64(1)
    # Below 2^38 + 2^16, so a word is below 2^55.
    result = digits[..., 1::2] << _16
    result += digits[..., ::2]
    return np.moveaxis(result, 2, 0)


def _split(numbers: IntArray) -> FloatArray:
    """The lowest 16 bits of the words, then what is above them: shape S + (4,) to S + (8,)."""
    parts = np.empty((*numbers.shape[:-1], 8))
    np.bitwise_and(numbers, _LOW16, out=parts[..., :4], casting="unsafe")
    np.right_shift(numbers, _16, out=parts[..., 4:], casting="unsafe")
    return parts
