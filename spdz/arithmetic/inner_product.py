"""Dot products over F_p as small floating-point matrix products (BLAS).

Elements are split into 16-bit limbs, x = sum_i x_i 2^16i, i < 8. All 64 sums of limb products of a dot
product are one (8 x N) by (N x 8) product in float64, exact because every partial sum is an integer of at
most 53 bits. Many against many is a single (8m x N) by (N x 8k) product.

Cost: 128 N floating-point operations a dot product, local, no communication. Limb products in floating
point are the standard technique for exact linear algebra (Dumas, Gautier, Pernet, "Finite field linear
algebra subroutines", ISSAC 2002).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from operator import mul
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.foundations.types import FieldArray, FloatArray, IntArray, Shape

_CHUNK = 1 << 17
"""Longest contraction in one go. 15 * _CHUNK * 2^32 < 2^53 bounds a folded column of 16-bit limb products
(see _fold), and _CHUNK * 2^36 = 2^53 a product of 20-bit by 16-bit limbs."""

_BLOCK = 2000
"""Coordinates of one vector pair that are split at a time: 125 KB of limbs each, which stay in the cache and
below the size (128 KB) from which malloc maps fresh pages for every array."""

_FEW = 64
"""Up to so many coordinates, Python integers are faster for a single product than BLAS (measured)."""

_TILE = 1 << 19
"""Limb products (float64) of a many-against-many product that are held at once: 4 MB."""

_BITS16, _BITS20 = np.uint64(16), np.int64(20)
_LOW16, _LOW20 = np.uint64((1 << 16) - 1), np.int64((1 << 20) - 1)


def _fold_matrix() -> FloatArray:
    """Limb product (i, j), flat index 8 i + j, to column i + j mod 8; twice beyond 8, since 2^128 = 2."""
    matrix = np.zeros((64, 8))
    for i in range(8):
        for j in range(8):
            matrix[8 * i + j, (i + j) % 8] = 1 + (i + j) // 8
    return matrix


_FOLD = _fold_matrix()
_FOLD.flags.writeable = False


def _signed_offset() -> IntArray:
    """Columns in base 2^16, each in [2^59, 2^59 + 2^16), that add up to a multiple of p."""
    multiple = sum(1 << (59 + 16 * j) for j in range(8))
    offset: IntArray = field.from_int(-multiple).view("<u2").astype(np.int64) + np.int64(1 << 59)
    return offset


_OFFSET = _signed_offset()
_OFFSET.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False)
class Limbs:
    """Elements split for :func:`dot`, so that a vector in several products is split once.

    Attributes:
        values: 16-bit limbs as ``float64``, shape S + (N, 8).
    """

    values: FloatArray = dataclasses.field(repr=False)


Operand: TypeAlias = FieldArray | Limbs | list[int]
"""A vector, or what :func:`prepare` made of one."""


def limbs(a: FieldArray) -> Limbs:
    """Split elements of shape S + (N,)."""
    return Limbs(np.ascontiguousarray(a, dtype="<u8").view("<u2").astype(np.float64))


def prepare(a: FieldArray) -> Operand:
    """Convert a vector that goes into several products once: to limbs, or to integers if it is short."""
    return field.to_list(a) if a.ndim == 2 and len(a) <= _FEW else limbs(a)


def _integers(a: Operand) -> list[int] | None:
    """A single short vector as Python integers."""
    if isinstance(a, list):
        return a
    short = not isinstance(a, Limbs) and a.ndim == 2 and 0 < len(a) <= _FEW
    return field.to_list(a) if short else None  # type: ignore[arg-type]


def dot(a: Operand, b: Operand) -> FieldArray:
    """Dot products over the last axis of S, mod p.

    Args:
        a: Elements of shape S + (N,), whole or split by :func:`limbs`.
        b: Elements of shape T + (N,), likewise.

    Returns:
        Elements of the broadcast shape of S and T: (m, 1, N) and (1, k, N) give all m k products.

    Raises:
        ValueError: if the last axes differ or are empty, or S and T do not broadcast.
    """
    if (left := _integers(a)) is not None and (right := _integers(b)) is not None and len(left) == len(right):
        return field.from_int(sum(map(mul, left, right)))
    return _contract(_splitter(a), _splitter(b), _fold, _CHUNK)


def small_dot(x: IntArray, b: Operand) -> FieldArray:
    """Dot products of short signed integers with elements, over the last axis, mod p.

    A quarter of the work of :func:`dot`.

    Args:
        x: ``int64`` of shape S + (N,) with |x| < 2^40. This is not checked: encoded inputs satisfy it
            (:func:`spdz.arithmetic.fixed_point.encode`), and beyond it the result is wrong.
        b: Elements of shape T + (N,), whole or split by :func:`limbs`.

    Returns:
        Elements of the broadcast shape of S and T.

    Raises:
        ValueError: as :func:`dot`.
    """
    if x.ndim == 1 and (integers := _integers(b)) is not None and len(x) == len(integers):
        return field.from_int(sum(map(mul, x.tolist(), integers)))

    def split(piece: slice) -> FloatArray:
        short = x[..., piece]
        both = np.empty((*short.shape[:-1], 2, short.shape[-1]))
        both[..., 0, :] = short & _LOW20
        both[..., 1, :] = short >> _BITS20
        return np.swapaxes(both, -1, -2)

    vectors = _Splitter(x.shape[:-1], x.shape[-1], _CHUNK, split)
    return _contract(vectors, _splitter(b), _fold_small, _CHUNK)


@dataclass(frozen=True, slots=True)
class _Splitter:
    """Vectors of shape S + (N,) whose limbs, of shape S + (n, L), are made n <= block at a time."""

    leading: Shape
    length: int
    block: int
    split: Callable[[slice], FloatArray] = dataclasses.field(repr=False)


def _splitter(a: Operand) -> _Splitter:
    if isinstance(a, list):
        a = field.from_ints(a)
    if isinstance(a, Limbs):
        values = a.values
        return _Splitter(values.shape[:-2], values.shape[-2], _CHUNK, lambda piece: values[..., piece, :])
    return _Splitter(a.shape[:-2], a.shape[-2], _BLOCK, lambda piece: limbs(a[..., piece, :]).values)


def _contract(
    left: _Splitter, right: _Splitter, fold: Callable[[FloatArray], FieldArray], chunk: int
) -> FieldArray:
    """Sum over N, in chunks for which the products are exact."""
    n = left.length
    if n != right.length or n == 0:
        raise ValueError(f"a dot product needs vectors of one length above 0, got {n} and {right.length}")
    block = min(left.block, right.block)

    def part(start: int) -> FieldArray:
        stop = min(start + chunk, n)
        if left.leading or right.leading:
            piece = slice(start, stop)
            return _matrix_product(left.split(piece), right.split(piece), fold)
        first, *rest = (slice(at, min(at + block, stop)) for at in range(start, stop, block))
        products = left.split(first).T @ right.split(first)
        for piece in rest:
            products += left.split(piece).T @ right.split(piece)
        return fold(products)

    total = part(0)
    for start in range(chunk, n, chunk):
        total = field.add(total, part(start))
    return total


def _matrix_product(
    left: FloatArray, right: FloatArray, fold: Callable[[FloatArray], FieldArray]
) -> FieldArray:
    """Products of (..., N, L) and (..., N, 8) over N, folded."""
    shape = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    rows, columns = _padded(left, len(shape)), _padded(right, len(shape))
    if all(1 in sizes for sizes in zip(rows, columns, strict=True)):
        last_row = max((axis for axis, size in enumerate(rows) if size != 1), default=-1)
        if all(size == 1 for size in columns[: last_row + 1]):
            return _outer(left, right, fold).reshape((*shape, 2))
    return fold(np.matmul(np.swapaxes(left, -1, -2), right))


def _padded(a: FloatArray, dimensions: int) -> Shape:
    leading = a.shape[:-2]
    return (1,) * (dimensions - len(leading)) + leading


def _outer(left: FloatArray, right: FloatArray, fold: Callable[[FloatArray], FieldArray]) -> FieldArray:
    """Every vector of ``left`` with every vector of ``right``: shape (m, k, 2)."""
    m, k = prod(left.shape[:-2]), prod(right.shape[:-2])
    n, width = left.shape[-2:]
    columns = _side_by_side(right.reshape((k, n, 8)))
    result = np.empty((m, k, 2), dtype=np.uint64)
    step = max(1, _TILE // (8 * width * max(1, k)))
    vectors = left.reshape((m, n, width))
    for start in range(0, m, step):
        rows = _side_by_side(vectors[start : start + step])
        products = (rows.T @ columns).reshape((rows.shape[1] // width, width, k, 8))
        result[start : start + step] = fold(products.transpose(0, 2, 1, 3))
    return result


def _side_by_side(vectors: FloatArray) -> FloatArray:
    """Shape (m, N, L) to an (N, m L) matrix."""
    m, n, width = vectors.shape
    matrix: FloatArray = vectors.transpose(1, 0, 2).reshape((n, m * width))
    return matrix


def _fold(products: FloatArray) -> FieldArray:
    """16-bit limb products (..., 8, 8) to elements."""
    shape = products.shape[:-2]
    # At most 15 _CHUNK 2^32 < 2^53: column c holds c + 1 products once and 7 - c twice.
    columns = products.reshape((*shape, 64)) @ _FOLD
    if not shape:
        return field.from_int(_from_digits(columns))
    return _reduce(columns.astype(np.uint64))


def _fold_small(products: FloatArray) -> FieldArray:
    """20-bit by 16-bit limb products (..., 2, 8), signed and at most 2^53 in size, to elements."""
    if products.ndim == 2:
        return field.from_int(_from_digits(products[0]) + (_from_digits(products[1]) << 20))
    exact = products.astype(np.int64)
    # The upper limb weighs 2^20 = 2^16 * 2^4, and at the top 2^128 * 2^4 = 2^5 (mod p).
    columns = exact[..., 0, :] + _OFFSET
    columns[..., 1:] += exact[..., 1, :-1] << np.int64(4)
    columns[..., 0] += exact[..., 1, -1] << np.int64(5)
    # The products add at most 2^53 + 2^57 < 2^58 in size (limb 7 of an element is below 2^15), so what
    # is left is positive and below 2^59 + 2^16 + 2^58 < 2^60.
    return _reduce(columns.view(np.uint64))


def _from_digits(columns: FloatArray) -> int:
    """Sum of columns[j] 2^16j, each an integer."""
    total = 0
    for column in reversed(columns.tolist()):
        total = (total << 16) + int(column)
    return total


def _reduce(columns: npt.NDArray[np.uint64]) -> FieldArray:
    """Columns in base 2^16, shape S + (8,), each below 2^60, to elements."""
    carries = columns >> _BITS16
    columns &= _LOW16
    columns[..., 1:] += carries[..., :-1]
    columns[..., 0] += carries[..., -1] << np.uint64(1)
    # Now below 2^45 + 2^16, so a word is below 2^61 + 2^46 < 2^62.
    words = columns[..., 1::2] << _BITS16
    words += columns[..., ::2]
    return field.from_words32(words)
