"""Elements as signed numbers in base 2^32 that are not reduced mod p: sums first, one reduction last.

Such a number is ``int64`` words (w_0 .. w_3) and means sum_i w_i 2^32i mod p. A word has room for what sums
and small factors make of it, and every function says how much it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.foundations.types import FieldArray, FloatArray, IntArray

INTEGER_BITS = 160
"""No number is longer as a Python integer."""

MOST_TERMS = (1 << 12) - 1
"""Longest row of :class:`Weights`."""

_ROOM = 1 << 60
_SMALL = 1 << 20
_EXACT = 53  # float64 represents all integers of so many bits
_CUT = 18


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


@dataclass(frozen=True, eq=False)
class Weights:
    """Rows of public weights for :func:`weigh`, split once.

    Attributes:
        rows: Integers, all rows of one length k, at most MOST_TERMS.
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


def weigh(weights: Weights, signs: IntArray, numbers: IntArray, half: IntArray, bits: int) -> IntArray:
    """The sums ``sum_i weights_i signs_i (numbers_i - half)`` over k terms, for every row of weights.

    Args:
        weights: The weights.
        signs: 1 or -1, shape (n, k).
        numbers: Words, shape (columns, n, k, 4).
        half: Words of elements, shape (columns, n, 1, 4).
        bits: Words and their differences from half are below 2^bits in size: at most 40.

    Returns:
        Words below 2^60 in size, shape (rows, columns, n, 4).
    """
    columns, n, k = numbers.shape[:3]
    if (small := weights.small) is not None:
        # Below 2^40 2^20.
        less = (numbers - half).reshape(columns, 4 * n)
        less *= signs.reshape(-1).repeat(4)
        return (less * small).reshape(len(small), columns, n, 4)
    return _weighed(weights, signs.astype(np.float64), numbers, half, _EXACT - bits - k.bit_length())


def _weighed(weights: Weights, signs: FloatArray, numbers: IntArray, half: IntArray, limb: int) -> IntArray:
    """:func:`weigh` as small floating-point products (BLAS), of weights in limbs of so many bits.

    Exact: of k terms, limbs below 2^limb times words below 2^bits add up to less than k 2^(limb + bits) <
    2^53, and so do those with half and the differences.
    """
    limbs, fold = _split(weights, limb)
    sums = (limbs * signs[:, np.newaxis]) @ numbers.astype(np.float64)
    sums -= (signs @ limbs.T)[..., np.newaxis] * half.astype(np.float64)
    columns, n = sums.shape[:2]
    parts = np.empty((columns, n, 3, *sums.shape[2:]))
    low, middle, high = (parts[:, :, part] for part in range(3))
    np.floor(sums * 2.0 ** (-2 * _CUT), out=high)
    sums -= high * 2.0 ** (2 * _CUT)
    np.floor(sums * 2.0**-_CUT, out=middle)
    np.subtract(sums, middle * 2.0**_CUT, out=low)
    # Each part is at most 2^18 in size. A digit adds up no more than one of each limb's and cut's, 3 * 127 <
    # 2^9 of them, times 2^16: below 2^43. So a word is below 2^43 + 2^59.
    joined = parts.reshape(columns, n, fold.shape[0]) @ fold
    digits = joined.astype(np.int64).reshape(columns, n, fold.shape[1] // 8, 8)
    sums_words = digits[..., 1::2] << np.int64(16)
    sums_words += digits[..., ::2]
    by_row: IntArray = sums_words.transpose(2, 0, 1, 3)
    return by_row


@lru_cache(maxsize=256)
def _split(weights: Weights, limb: int) -> tuple[FloatArray, FloatArray]:
    """Limbs of ``limb`` bits, and what becomes of their products with words.

    Returns:
        Limbs of all rows, of each the lowest first and the highest signed: shape (m, k). And a matrix
        (12 m, 8 rows) from the products of a row's limb a and word i, which weigh 2^(a limb + 32 i), all of
        them cut in three, to the row's digits in base 2^16; from 2^128 on, 2^128 = 2.
    """
    limbs: list[list[int]] = []
    places: list[tuple[int, int]] = []
    for r, row in enumerate(weights.centred):
        last = max(map(abs, row)).bit_length() // limb
        for a in range(last + 1):
            shifted = [weight >> a * limb for weight in row]
            limbs.append(shifted if a == last else [one & (1 << limb) - 1 for one in shifted])
            places.append((r, a * limb))
    fold = np.zeros((3, len(limbs), 4, len(weights.rows), 8))
    for cut, (m, (r, at)), i in product(range(3), enumerate(places), range(4)):
        place = cut * _CUT + at + 32 * i
        fold[cut, m, i, r, place // 16 % 8] = 1 << place % 16 + place // 128
    return np.array(limbs, dtype=np.float64), fold.reshape(12 * len(limbs), -1)
