"""What compiled code calls for more than a few numbers, and for what it refuses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from struct import Struct
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.field import P
from spdz.foundations.types import Buffer, FieldArray, FloatArray, IntArray, Shape
from spdz.rounds.wire import ELEMENT_BYTES, not_canonical
from spdz.values.input_mask import outside, unsuited

WORD_LIMB, ELEMENT_LIMB = 16, 22
"""Bits of a limb of short integers, where there are several, and of elements."""
_22 = np.uint64((1 << ELEMENT_LIMB) - 1)

_EXACT = 53
"""float64 represents all integers of so many bits."""

LONGEST = 1 << 18
"""Coordinates of a dot product by limbs (:func:`product`)."""

Cut: TypeAlias = Callable[[Buffer], tuple[bytes, ...]]

_number = int.from_bytes


@lru_cache
def cut(count: int, size: int) -> Cut:
    """What cuts bytes into so many pieces of a size."""
    return Struct(f"{size}s" * count).unpack


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


def elements_of(raw: Buffer, cut: Cut) -> list[int]:
    """A peer's elements, likewise."""
    numbers = [_number(piece, "little") for piece in cut(raw)]
    if max(numbers) >= P:
        raise not_canonical()
    return numbers


def decoded_element(number: int, frac: int) -> float:
    """An opened element as a float."""
    return (number - P if number > P >> 1 else number) / (1 << frac)


# -- words -----------------------------------------------------------------------------------------------


def far_inside(r: IntArray | Sequence[int], low: int, high: int) -> bool:
    """Whether ``x - r`` is in [low, high) for every x with |x| <= low."""
    least, most = (r.min(), r.max()) if isinstance(r, np.ndarray) else (min(r), max(r))
    return bool(-most >= 2 * low and -least < high - low)


def hidden_words(x: IntArray, r: IntArray, is_inside: bool, low: int, high: int) -> IntArray:
    """``x - r``; Unsent unless all of it is in [low, high)."""
    words = x - r
    if not is_inside and (words.min() < low or words.max() >= high):
        raise unsuited()
    return words


def check_hidden(words: list[int], low: int, high: int) -> None:
    """Unsent unless all words are in [low, high)."""
    if min(words) < low or max(words) >= high:
        raise unsuited()


def packing(count: int, size: int) -> tuple[Callable[..., bytes], Cut]:
    """What turns so many words into 8 bytes each, and what cuts these down to a size."""
    return Struct(f"<{count}q").pack, Struct(f"{size}s{8 - size}x" * count).unpack


@lru_cache
def unpacking(count: int, size: int) -> tuple[Cut, bytes, Callable[[bytes], tuple[int, ...]]]:
    """What cuts bytes into words of a size, what each lacks to 8 bytes, and what reads these."""
    return cut(count, size), bytes(8 - size), Struct(f"<{count}q").unpack


def words_of(
    raw: Buffer,
    cut: Cut,
    zeros: bytes,
    numbers: Callable[[bytes], tuple[int, ...]],
    low: int,
    high: int,
) -> tuple[int, ...]:
    """A peer's words (see :func:`unpacking`); ProtocolViolation unless all are in [low, high)."""
    words = numbers(zeros.join(cut(raw)) + zeros)
    if min(words) < low or max(words) >= high:
        raise outside()
    return words


def mask_words(pad: FieldArray, bits: int) -> IntArray:
    """The masks -s that pads stand for."""
    words: IntArray = (pad[..., 0] & np.uint64((1 << bits) - 1)).view(np.int64)
    return -words


# -- dot products of two vectors ---------------------------------------------------------------------------


def one_limb(words: IntArray) -> FloatArray:
    """Short integers as their only limb, shape (1, N)."""
    return words.astype(np.float64)[np.newaxis]


def word_limbs(words: IntArray, count: int) -> FloatArray:
    """The ``count`` 16-bit limbs of integers in [0, 2^(16 count)), shape (count, N)."""
    parts: npt.NDArray[np.uint16] = np.ascontiguousarray(words).view("<u2").reshape(-1, 4)[:, :count]
    limbs: FloatArray = parts.T.astype(np.float64, order="C")
    return limbs


def signed_limbs(words: IntArray, count: int) -> FloatArray:
    """The same of integers in [-2^(16 count - 1), 2^(16 count - 1)): the last limb has the sign."""
    limbs = np.empty((count, len(words)))
    words = np.ascontiguousarray(words)
    limbs[:-1] = words.view("<u2").reshape(-1, 4)[:, : count - 1].T
    limbs[-1] = words.view("<i2")[count - 1 :: 4]
    return limbs


def element_limbs(a: FieldArray) -> FloatArray:
    """The six 22-bit limbs of elements, shape (6, N)."""
    low, high = a.reshape(-1, 2).T
    limbs = np.empty((6, len(low)))
    limbs[0], limbs[1] = low & _22, low >> np.uint64(22) & _22
    limbs[2] = (low >> np.uint64(44) | high << np.uint64(20)) & _22
    limbs[3], limbs[4], limbs[5] = (
        high >> np.uint64(2) & _22,
        high >> np.uint64(24) & _22,
        high >> np.uint64(46),
    )
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
        return _joined(_products(a, b).tolist(), left, right)
    total = np.zeros((len(a), len(b)), dtype=np.int64)
    for start in range(0, a.shape[1], length):
        piece = slice(start, start + length)
        total += (a[:, piece] @ b[:, piece].T).astype(np.int64)
    return _joined(total.tolist(), left, right)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """``a @ b.T``, shape (K, L), as BLAS is quickest at it for few rows that are long (measured)."""
    products: FloatArray
    if len(a) == 1:
        products = (b @ a[0])[np.newaxis]
    elif a is b:  # a matrix times its own transpose takes another routine, which is slow here
        products = np.concatenate([a[:-1] @ b.T, (b @ a[-1])[np.newaxis]])
    else:
        products = (b @ a.T).T if len(a) < len(b) else a @ b.T
    return products


def _joined(products: Sequence[Sequence[float]], left: int, right: int) -> int:
    """sum_ij products_ij 2^(left i + right j)."""
    total = 0
    for row in reversed(products):
        inner = 0
        for number in reversed(row):
            inner = (inner << right) + int(number)
        total = (total << left) + inner
    return total
