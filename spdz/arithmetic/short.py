"""All products of two sets of short vectors, as a few floating-point matrix products.

A standing input is a vector of words of some 44 bits. Its products with others stay far below p, so they
need few limbs: two by two for 44 by 44 bits, one by two for 17 by 44 bits. Limbs are signed and balanced, and
float64 sums of their products are exact up to 2^53 (Dumas, Gautier, Pernet, "Finite field linear algebra
subroutines", ISSAC 2002). These sums are added up as 64-bit integers and joined as 128-bit ones.

Cost: N multiplications for each pair and pair of limbs. (Three products for four, as in Karatsuba, need sums
of limbs, hence chunks of a quarter the length: measured, they are slower.)
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from spdz.arithmetic import field
from spdz.foundations.types import FieldArray, FloatArray, IntArray

MOST_BITS = 58
"""The longest operand."""

_EXACT = 53
"""float64 represents all integers of so many bits, and 2^53."""

_MOST_LIMBS = 4
_CHUNK_COST = 12
"""Adding up an exact sum costs what so many coordinates do (measured: 0.4 ns and 0.033 ns)."""

_CHUNKS = 1 << 7
"""Exact sums that are added up as integers: at most 4 of one weight a chunk, 2^7 * 4 * 2^53 = 2^62."""

_ROWS, _COLUMNS = 256, 256
"""Pairs of a tile: 512 KB for its sums of one weight."""

_SPLIT = 1 << 13
"""Numbers that are split at a time: temporaries of 64 KB stay in the cache."""

_LOW63, _SHIFT63, _WORD = np.uint64((1 << 63) - 1), np.uint64(63), 64


@dataclass(frozen=True, slots=True, eq=False)
class Limbs:
    """Short vectors split for :func:`outer`, so that those in several products are split once.

    Attributes:
        values: Integers as ``float64``, shape (L, R, N): x = sum_i values[i] 2^(i width).
        bits: |x| < 2^bits.
        width: |values| <= 2^(width - 1).
    """

    values: FloatArray = dataclasses.field(repr=False)
    bits: int
    width: int


Vectors: TypeAlias = IntArray | Limbs
"""Short vectors, shape (R, N), or what :func:`split` made of them."""


def split(x: IntArray, bits: int, width: int) -> Limbs:
    """Split signed integers into balanced limbs.

    Args:
        x: ``int64`` of shape (R, N) with |x| < 2^bits. This is not checked; beyond it products are wrong.
        bits: From 1 to 58.
        width: Bits of a limb with its sign, for at most 4 limbs. :func:`widths` tells the best ones.

    Raises:
        ValueError: if bits or width are out of range.
    """
    if not (1 <= bits <= MOST_BITS and bits < _MOST_LIMBS * width and width <= _EXACT):
        raise ValueError(f"cannot split {bits} bits (1 to {MOST_BITS}) into limbs of {width} bits, 4 at most")
    values = np.empty((-(-(bits + 1) // width), *x.shape))
    half, low, shift = np.int64(1 << (width - 1)), np.int64((1 << width) - 1), np.int64(width)
    step = max(1, _SPLIT // max(1, x.shape[1]))
    for start in range(0, len(x), step):
        rest = x[start : start + step]
        for limb in values[:-1, start : start + step]:
            # The digit in [-half, half); L limbs have room for bits + 1 bits, so the last rest fits one.
            rest = rest + half
            digit = rest & low
            digit -= half
            limb[...] = digit
            rest >>= shift
        values[-1, start : start + step] = rest
    return Limbs(values, bits, width)


def widths(x_bits: int, y_bits: int) -> tuple[int, int]:
    """The limb widths, in bits with the sign, at which :func:`outer` is fastest."""
    return _cheapest(_choices(x_bits), _choices(y_bits))


def _choices(vectors: int | Limbs) -> list[tuple[int, int]]:
    """Limb counts, and the smallest width of each for a number of bits; limbs have no choice."""
    if isinstance(vectors, Limbs):
        return [(len(vectors.values), vectors.width)]
    return [(count, -(-(vectors + 1) // count)) for count in range(1, _MOST_LIMBS + 1)]


def _chunk(x_width: int, y_width: int) -> int:
    """Coordinates in one exact sum: no product is larger than 2^(x_width - 1) 2^(y_width - 1)."""
    return 1 << _EXACT >> (x_width + y_width - 2)


def _cheapest(x: list[tuple[int, int]], y: list[tuple[int, int]]) -> tuple[int, int]:
    costs = [
        (left * right * (1 + _CHUNK_COST / chunk), x_width, y_width)
        for left, x_width in x
        for right, y_width in y
        if (chunk := _chunk(x_width, y_width))
    ]
    if not costs:
        raise ValueError("these limbs are too wide: a product of two is not exact")
    return min(costs)[1:]


def outer(x: Vectors, y: Vectors, x_bits: int, y_bits: int) -> FieldArray:
    """All dot products of two sets of short vectors: sum_n x_jn y_kn mod p.

    What comes whole is split a tile at a time: again for every 256 vectors of the other set.

    Args:
        x: ``int64`` of shape (R, N) with |x| < 2^x_bits (not checked), whole or :func:`split`.
        y: ``int64`` of shape (C, N) with |y| < 2^y_bits, likewise.
        x_bits: From 1 to 58.
        y_bits: From 1 to 58.

    Returns:
        Elements of shape (R, C).

    Raises:
        ValueError: if the lengths differ, bits are out of range or not those of limbs, or limbs too wide.
    """
    for vectors, bits in ((x, x_bits), (y, y_bits)):
        if not 1 <= bits <= MOST_BITS or (isinstance(vectors, Limbs) and vectors.bits != bits):
            raise ValueError(f"{bits} bits: limbs have others, or it is not 1 to {MOST_BITS}")
    (r, n), (c, columns) = _shape(x), _shape(y)
    if n != columns:
        raise ValueError(f"products need vectors of one length, got {n} and {columns}")
    x_width, y_width = _cheapest(
        _choices(x if isinstance(x, Limbs) else x_bits), _choices(y if isinstance(y, Limbs) else y_bits)
    )
    chunk = _chunk(x_width, y_width)
    # A sum over so many coordinates is at most 2^126 in size, as _fold needs.
    most = min(1 << (126 - x_bits - y_bits), _CHUNKS * chunk)
    result = field.zeros((r, c))
    for row in range(0, r, _ROWS):
        for column in range(0, c, _COLUMNS):
            tile = (slice(row, row + _ROWS), slice(column, column + _COLUMNS))
            for start in range(0, n, most):
                sums: dict[int, IntArray] = {}
                for at in range(start, min(start + most, n), chunk):
                    piece = slice(at, min(at + chunk, start + most))
                    left = _piece(x, x_bits, x_width, tile[0], piece)
                    _accumulate(sums, left, _piece(y, y_bits, y_width, tile[1], piece))
                part = _fold(sums)
                result[tile] = field.add(result[tile], part) if start else part
    return result


def _shape(vectors: Vectors) -> tuple[int, int]:
    rows, length = (vectors.values if isinstance(vectors, Limbs) else vectors).shape[-2:]
    return rows, length


def _piece(vectors: Vectors, bits: int, width: int, rows: slice, coordinates: slice) -> Limbs:
    if isinstance(vectors, Limbs):
        return Limbs(vectors.values[:, rows, coordinates], bits, width)
    return split(vectors[rows, coordinates], bits, width)


def _accumulate(sums: dict[int, IntArray], left: Limbs, right: Limbs) -> None:
    """Add the limb products of a chunk to the sums, by their weights' exponents."""
    shape = (left.values.shape[1], right.values.shape[1])
    products, integers = np.empty(shape), np.empty(shape, dtype=np.int64)
    for i, x in enumerate(left.values):
        for j, y in enumerate(right.values):
            np.matmul(x, y.T, out=products)  # at most 2^53 in size
            weight = i * left.width + j * right.width
            if weight in sums:
                np.copyto(integers, products, casting="unsafe")
                sums[weight] += integers
            else:
                sums[weight] = products.astype(np.int64)


def _fold(sums: dict[int, IntArray]) -> FieldArray:
    """Integers by the exponent of their weight, at most 2^126 in size when joined, to elements."""
    low = sums[0].view(np.uint64)
    high = sums[0] >> np.int64(63)
    # Modulo 2^128: what is shifted out of the high word, or carried, comes back with the sign.
    for weight, summand in sums.items():
        if weight >= _WORD:
            high += summand << np.int64(weight - _WORD)
        elif weight:
            shifted = (summand << np.int64(weight)).view(np.uint64)
            low += shifted
            high += summand >> np.int64(_WORD - weight)
            high += low < shifted
    # Below 0, add p = 2^127 - 1: clear the two sign bits 2^127, subtract 1.
    words = high.view(np.uint64)
    negative = words >> _SHIFT63
    words &= _LOW63
    result = np.empty((*low.shape, 2), dtype=np.uint64)
    np.subtract(low, negative, out=result[..., 0])
    np.subtract(words, low < negative, out=result[..., 1])
    return result
