"""Sums of rows under full-field weights: what a check of all products of two sets of vectors at once takes.

A matrix of errors that is not zero gives u E v = 0 with probability 2/p for random u and v (Freivalds,
"Probabilistic machines can use less running time", IFIP 1977), so that instead of R C dot products a check
needs sum_j u_j x_j over the words and over the MAC shares of each set, and one form u M v.

Weights are split into 8 balanced limbs of 16 bits, rows into limbs of 32 bits less 2^31, which are signed
32-bit integers (NumPy converts those fastest). Sums of 128 products of such limbs are exact in float64. What
the limbs lack is a constant times the sum of the weights, added in the end.

Cost: 32 multiplications an element, 16 a word, 8 a word of at most 31 bits. Conversion takes a third of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.inner_product import dot
from spdz.foundations.types import FieldArray, FloatArray, IntArray

_ROWS = 128
"""Rows in one product: 2^7 limbs of weights (2^15) and of rows (2^31) are at most 2^53."""

_COLUMNS = 256
"""Columns of limbs in one product: 256 KB, which stay in the cache."""

_TILE = 2048
"""Coordinates whose sums are held at once: at most 512 KB."""

_MOST_ROWS = 1 << 13
"""Rows whose products are added up before they are reduced, see _fold."""

_BOTH, _LOWER, _NEITHER = np.uint64(0x8000_0000_8000_0000), np.uint64(0x8000_0000), np.uint64(0)
"""Upper bits of the 32-bit limbs of a word. A limb with this bit flipped is a signed number, 2^31 less."""

_BALANCE = np.array([0x8000_8000_8000_8000, 0x0000_8000_8000_8000], dtype=np.uint64)
_BALANCE.flags.writeable = False
_SHIFT16, _LOW16 = np.int64(16), np.int64((1 << 16) - 1)


def weigh_words(u: FieldArray, x: IntArray, bits: int) -> FieldArray:
    """The sum of rows of short integers under weights: sum_j u_j x_jn mod p.

    Args:
        u: Elements of shape (R,).
        x: ``int64`` of shape (R, N) with |x| < 2^bits. This is not checked.
        bits: Up to 31, half the work; beyond, x may be any ``int64``.

    Returns:
        Elements of shape (N,).

    Raises:
        ValueError: if the numbers of rows differ.
    """
    # The upper limb is signed as it is, and so is the lower one of a number of 31 bits and a sign.
    limbs, flip = (1, _NEITHER) if bits <= 31 else (2, _LOWER)
    _check_rows(u, x)
    if len(x) == 1:
        return field.scale(field.from_int64(x[0]), field.to_int(u))
    return _weigh(u, x.view(np.uint64)[..., np.newaxis], limbs, flip)


def weigh_elements(u: FieldArray, m: FieldArray) -> FieldArray:
    """The sum of rows of elements under weights: sum_j u_j m_jn mod p.

    Args:
        u: Elements of shape (R,).
        m: Elements of shape (R, N).

    Returns:
        Elements of shape (N,).

    Raises:
        ValueError: if the numbers of rows differ.
    """
    _check_rows(u, m)
    if len(m) == 1:
        return field.scale(m[0], field.to_int(u))
    return _weigh(u, m, 4, _BOTH)


def bilinear(u: FieldArray, m: FieldArray, v: FieldArray) -> int:
    """The form sum_jk u_j m_jk v_k mod p.

    Args:
        u: Elements of shape (R,).
        m: Elements of shape (R, C).
        v: Elements of shape (C,).

    Returns:
        An integer in [0, p), 0 if there is no m.

    Raises:
        ValueError: if the shapes do not fit.
    """
    if m.shape[1] != len(v):
        raise ValueError(f"{m.shape[1]} columns and {len(v)} weights")
    row = weigh_elements(u, m)
    return field.to_int(dot(row, v)) if len(v) else 0


def _check_rows(u: FieldArray, rows: npt.NDArray[Any]) -> None:
    if len(u) != len(rows):
        raise ValueError(f"{len(rows)} rows and {len(u)} weights")


def _weigh(u: FieldArray, words: npt.NDArray[np.uint64], limbs: int, flip: np.uint64) -> FieldArray:
    """Weigh numbers of so many 32-bit limbs, in words of shape (R, N, W) with bits to be flipped."""
    rows, length, width = words.shape
    result = field.zeros(length)
    for start in range(0, rows, _MOST_ROWS):
        some = slice(start, start + _MOST_ROWS)
        weights = _balanced(u[some])
        for column in range(0, length, _TILE):
            tile = slice(column, column + _TILE)
            result[tile] = field.add(result[tile], _fold(_sums(weights, words[some, tile], limbs, flip)))
    # Flipped bits took this number from every coordinate.
    less = sum(int(flip) << 64 * i for i in range(width)) * field.to_int(field.sum(u, 0))
    return field.add(result, field.from_int(less))


def _balanced(u: FieldArray) -> FloatArray:
    """Weights, shape (R,), as limbs of 16 bits and at most 2^15 in size, shape (R, 8)."""
    # Each limb but the top one, which is below 2^15, is raised by 2^15; the top one gets a carry at most.
    raised = u + _BALANCE
    raised[:, 1] += raised[:, 0] < _BALANCE[0]
    result = raised.view("<u2").astype(np.float64)
    result[:, :7] -= 1 << 15
    return result


def _sums(weights: FloatArray, words: npt.NDArray[np.uint64], limbs: int, flip: np.uint64) -> IntArray:
    """Sums of limb products over at most 2^13 rows, shape (8, limbs, N): below 2^13 2^46 in size."""
    rows, length, width = words.shape
    sums = np.zeros((length * limbs, 8), dtype=np.int64)
    step = _COLUMNS // limbs
    flipped = np.empty((_ROWS, step, width), dtype=np.uint64)
    numbers = np.empty(_ROWS * _COLUMNS)
    for row in range(0, rows, _ROWS):
        for column in range(0, length, step):
            piece = words[row : row + _ROWS, column : column + step]
            r, n = piece.shape[:2]
            signed = np.bitwise_xor(piece, flip, out=flipped[:r, :n]).view("<i4")[..., :limbs]
            matrix = numbers[: r * n * limbs].reshape((r, n, limbs))
            matrix[...] = signed
            products = matrix.reshape((r, n * limbs)).T @ weights[row : row + r]
            sums[column * limbs : (column + n) * limbs] += products.astype(np.int64)
    return np.ascontiguousarray(sums.reshape((length, limbs, 8)).transpose(2, 1, 0))


def _fold(sums: IntArray) -> FieldArray:
    """Sums (8, limbs, N) with the weights 2^(16 i + 32 j) to elements."""
    columns = sums[:, 0].copy()
    for j in range(1, sums.shape[1]):
        columns[2 * j :] += sums[: 8 - 2 * j, j]
        columns[: 2 * j] += sums[8 - 2 * j :, j] << np.int64(1)  # 2^128 = 2
    # At most 4 sums, weighed twice: below 2^62. A carry adds 2^46.
    digits = np.empty((columns.shape[1], 8), dtype="<u2")
    carry = np.zeros(columns.shape[1], dtype=np.int64)
    for i, column in enumerate(columns):
        column += carry
        digits[:, i] = column & _LOW16
        carry = column >> _SHIFT16
    # The number is digits + 2^128 carry; from_blocks drops bit 127, which weighs 1.
    carry <<= np.int64(1)
    carry += digits[:, 7] >> 15
    return field.add(field.from_blocks(digits.view("<u8")), field.from_int64(carry))
