"""The prime field F_p, p = 2^127 - 1, on NumPy arrays of 64-bit words.

An array of elements is a ``uint64`` array of shape S + (2,): little-endian words (low, high), always the
canonical representative below p. Every function broadcasts over S and returns a new, canonical array.
p is a Mersenne prime, so reduction is a shift and an add: 2^127 = 1 and 2^128 = 2 (mod p).

The kernels are not constant-time.
"""

from __future__ import annotations

import builtins
from math import prod
from operator import index
from typing import Any

import gmpy2
import numpy as np
import numpy.typing as npt

from spdz.foundations.types import BigIntArray, Block, FieldArray, IntArray, Shape

P = (1 << 127) - 1
"""The modulus, the Mersenne prime M127."""

_LOW63 = np.uint64((1 << 63) - 1)
_LOW32 = np.uint64((1 << 32) - 1)
_LOW26 = np.uint64((1 << 26) - 1)
_ONES = np.uint64((1 << 64) - 1)
_SHIFT26, _SHIFT32, _SHIFT63 = np.uint64(26), np.uint64(32), np.uint64(63)

# Up to so many elements, Python integers are faster than the array kernels (measured).
_FEW_SUMS, _FEW_WORDS, _FEW_PRODUCTS, _FEW_SCALED, _FEW_ADDENDS = 6, 16, 64, 32, 128
_TILE = 1024  # elements at a time in kernels with wide temporaries, which then stay in the cache


def zeros(shape: Shape | int) -> FieldArray:
    """Zero elements of shape S, as an array of shape S + (2,)."""
    return np.zeros((*(shape if isinstance(shape, tuple) else (shape,)), 2), dtype=np.uint64)


def _from_canonical(values: list[int], shape: Shape) -> FieldArray:
    """Pack integers in [0, p)."""
    if len(values) == 1:
        return np.frombuffer(bytearray(values[0].to_bytes(16, "little")), dtype="<u8").reshape((*shape, 2))
    packed = bytearray().join([value.to_bytes(16, "little") for value in values])
    return np.frombuffer(packed, dtype="<u8").reshape((*shape, 2))


def to_list(a: FieldArray) -> list[int]:
    """All elements, flattened, as Python integers in [0, p)."""
    if a.size == 2:
        return [int.from_bytes(a.tobytes(), "little")]
    words = a.ravel().tolist()
    return [low | high << 64 for low, high in zip(words[::2], words[1::2], strict=True)]


def from_int(k: int) -> FieldArray:
    """The element k mod p, an array of shape (2,)."""
    return _from_canonical([k % P], ())


def to_int(a: FieldArray) -> int:
    """The one element of an array as an integer in [0, p); ValueError if there is not exactly one."""
    (value,) = to_list(a)
    return value


def from_ints(values: Any) -> FieldArray:
    """Python integers, nested in sequences or in an object array of shape S, mod p.

    Raises:
        TypeError: if an entry is not an integer.
    """
    array = np.asarray(values, dtype=object)
    return _from_canonical([index(value) % P for value in array.ravel().tolist()], array.shape)


def to_ints(a: FieldArray) -> BigIntArray:
    """Python integers in [0, p), as an object array of shape S."""
    result = np.empty(prod(a.shape[:-1]), dtype=object)
    result[:] = to_list(a)
    return result.reshape(a.shape[:-1])


def centered(a: FieldArray) -> BigIntArray:
    """The representatives in (-p/2, p/2), as an object array of shape S."""
    result = np.empty(prod(a.shape[:-1]), dtype=object)
    result[:] = [value - P if value > P // 2 else value for value in to_list(a)]
    return result.reshape(a.shape[:-1])


def from_int64(x: IntArray) -> FieldArray:
    """Signed 64-bit integers of shape S: x for x >= 0, p + x for x < 0.

    Raises:
        TypeError: if the dtype does not fit ``int64`` (floats, ``uint64``, objects).
    """
    x = np.asarray(x).astype(np.int64, casting="safe", copy=False)
    sign = np.asarray(x >> np.int64(63)).view(np.uint64)
    result = np.empty((*x.shape, 2), dtype=np.uint64)
    # For x < 0, p + x = 2^127 + (x - 1): the low word is x - 1 mod 2^64 and borrows once from 2^63.
    np.add(x.view(np.uint64), sign, out=result[..., 0])
    np.right_shift(sign, np.uint64(1), out=result[..., 1])
    return result


def from_blocks(blocks: Block) -> FieldArray:
    """Uniform 128-bit blocks of shape S + (2,) to elements: the top bit is cleared and p becomes 0.

    The result is within statistical distance 2^-127 of uniform.
    """
    result = np.array(blocks, dtype=np.uint64)
    high = result[..., 1]
    np.bitwise_and(high, _LOW63, out=high)
    return _canonical(result)


def from_words32(w: npt.NDArray[np.uint64]) -> FieldArray:
    """Reduce accumulators in base 2^32, little-endian, of shape S + (4,), each below 2^62."""
    if w.size <= 4 * _FEW_WORDS:
        words = w.ravel().tolist()
        numbers = zip(words[::4], words[1::4], words[2::4], words[3::4], strict=True)
        return _from_canonical(
            [(w0 + (w1 << 32) + (w2 << 64) + (w3 << 96)) % P for w0, w1, w2, w3 in numbers], w.shape[:-1]
        )
    result = np.empty((*w.shape[:-1], 2), dtype=np.uint64)
    _reduce_words32(w, result)
    return result


def _reduce_words32(w: npt.NDArray[np.uint64], out: FieldArray) -> None:
    halves = out.view("<u4")
    halves[..., 0] = w[..., 0]
    carry = w[..., 0] >> _SHIFT32
    for k in (1, 2, 3):
        carry += w[..., k]  # below 2^62 + 2^31
        halves[..., k] = carry
        carry >>= np.uint64(31) if k == 3 else _SHIFT32
    # What is left is floor(number / 2^127), below 2^32, and weighs 1.
    low, high = out[..., 0], out[..., 1]
    np.bitwise_and(high, _LOW63, out=high)
    np.add(low, carry, out=low)
    np.add(high, low < carry, out=high)
    _canonical(out)


def _canonical(a: FieldArray) -> FieldArray:
    """Subtract p in place from the elements that are not below it, all being at most 2p."""
    if a[..., 1].max(initial=0) >= _LOW63:
        too_large = (a[..., 1] > _LOW63) | ((a[..., 1] == _LOW63) & (a[..., 0] == _ONES))
        # x - p is (x + 1) mod 2^127.
        rest = a[too_large]
        rest[..., 0] += np.uint64(1)
        rest[..., 1] += rest[..., 0] == 0
        rest[..., 1] &= _LOW63
        a[too_large] = rest
    return a


def is_canonical(words: npt.NDArray[np.uint64]) -> bool:
    """Whether all 128-bit numbers of an array of shape S + (2,) are below p."""
    high = words[..., 1]
    if high.max(initial=0) < _LOW63:
        return True
    return not bool(((high > _LOW63) | ((high == _LOW63) & (words[..., 0] == _ONES))).any())


def add(a: FieldArray, b: FieldArray) -> FieldArray:
    """Elementwise a + b."""
    if a.shape == b.shape and a.size <= 2 * _FEW_SUMS:
        return _from_canonical(
            [(x + y) % P for x, y in zip(to_list(a), to_list(b), strict=True)], a.shape[:-1]
        )
    result = np.asarray(a + b)
    low, high = result[..., 0], result[..., 1]
    np.add(high, low < b[..., 0], out=high)
    # The sum s <= 2p - 2 is at least p if and only if bit 127 of s + 1 is set; then s - p = s + 1 - 2^127.
    top = np.asarray(high + (low == _ONES))
    np.right_shift(top, _SHIFT63, out=top)
    np.add(low, top, out=low)
    np.add(high, low < top, out=high)
    np.bitwise_and(high, _LOW63, out=high)
    return result


def sub(a: FieldArray, b: FieldArray) -> FieldArray:
    """Elementwise a - b."""
    if a.shape == b.shape and a.size <= 2 * _FEW_SUMS:
        return _from_canonical(
            [(x - y) % P for x, y in zip(to_list(a), to_list(b), strict=True)], a.shape[:-1]
        )
    a_low, b_low = a[..., 0], b[..., 0]
    low = np.asarray(a_low - b_low)
    high = np.asarray(a[..., 1] - b[..., 1])
    np.subtract(high, a_low < b_low, out=high)
    # The difference mod 2^128 has bit 127 set if and only if it is negative. There p = 2^127 - 1 is added:
    # the bit is cleared, and 1 subtracted with borrow.
    negative = np.asarray(high >> _SHIFT63)
    np.bitwise_and(high, _LOW63, out=high)
    result = np.empty((*low.shape, 2), dtype=np.uint64)
    np.subtract(low, negative, out=result[..., 0])
    np.subtract(high, low < negative, out=result[..., 1])
    return result


def sub_from_int64(x: IntArray, a: FieldArray) -> FieldArray:
    """Elementwise x - a for signed integers x of a's shape S: what masks an input, in one pass."""
    result = np.empty(a.shape, dtype=np.uint64)
    low, high = result[..., 0], result[..., 1]
    np.bitwise_xor(a[..., 0], _ONES, out=low)  # p - a is the complement of a's 127 bits
    np.bitwise_xor(a[..., 1], _LOW63, out=high)
    words = x.view(np.uint64)
    np.add(low, words, out=low)
    np.add(high, low < words, out=high)
    np.add(high, (x >> np.int64(63)).view(np.uint64), out=high)
    # The sum lies in (-2^63, p + 2^63); one that left [0, p) has a high word of at least 2^63 - 1.
    if high.max(initial=0) >= _LOW63:
        left = high >= _LOW63
        result[left] = sub(from_int64(x[left]), a[left])
    return result


def neg(a: FieldArray) -> FieldArray:
    """Elementwise -a."""
    # p - a has the complement of a's 127 bits; only 0 becomes p.
    result = np.empty(a.shape, dtype=np.uint64)
    np.bitwise_xor(a[..., 0], _ONES, out=result[..., 0])
    np.bitwise_xor(a[..., 1], _LOW63, out=result[..., 1])
    return _canonical(result)


def sum(a: FieldArray, axis: int) -> FieldArray:
    """Sum over one axis of S; a negative axis counts from the end of S.

    Exact for fewer than 2^30 elements (base-2^32 accumulators below 2^62).
    """
    dimensions = a.ndim - 1
    if not -dimensions <= axis < dimensions:
        raise ValueError(f"axis {axis} is out of range for {dimensions} dimensions")
    if dimensions == 1 and a.size <= 2 * _FEW_ADDENDS:
        return from_int(builtins.sum(to_list(a)))
    halves = [half for word in (a[..., 0], a[..., 1]) for half in (word & _LOW32, word >> _SHIFT32)]
    return from_words32(np.stack([half.sum(axis=axis) for half in halves], axis=-1))


def mul(a: FieldArray, b: FieldArray) -> FieldArray:
    """Elementwise a * b."""
    if a.shape != b.shape:
        shape = np.broadcast_shapes(a.shape, b.shape)
        a, b = np.broadcast_to(a, shape), np.broadcast_to(b, shape)
    if a.size <= 2 * _FEW_PRODUCTS:
        return _from_canonical([x * y % P for x, y in zip(to_list(a), to_list(b), strict=True)], a.shape[:-1])
    left, right = a.reshape((-1, 2)), b.reshape((-1, 2))
    result = np.empty(left.shape, dtype=np.uint64)
    for start in range(0, len(result), _TILE):
        tile = slice(start, start + _TILE)
        _multiply_tile(left[tile], right[tile], result[tile])
    return result.reshape(a.shape)


def _multiply_tile(a: FieldArray, b: FieldArray, out: FieldArray) -> None:
    """Five limbs of 26 bits: 130 bits, and 2^130 = 8 (mod p)."""
    a_limbs, b_limbs = _limbs26(a), _limbs26(b)
    # Column k is the sum of a_i b_(k-i), with weight 8 where k < i: rotated = (8 b_1 .. 8 b_4, b_0 .. b_4).
    rotated = np.concatenate([b_limbs[1:] << np.uint64(3), b_limbs])
    columns = a_limbs[0] * rotated[4:9]
    for i in range(1, 5):
        columns += a_limbs[i] * rotated[4 - i : 9 - i]
    # Each is below 5 * 2^26 * 2^29 < 2^58; after one carry pass column 0 is below 2^36.
    carries = columns >> _SHIFT26
    columns &= _LOW26
    columns[1:] += carries[:-1]
    columns[0] += carries[4] << np.uint64(3)
    # Bit offsets 0, 26 | 52 = 32 + 20 | 78 = 64 + 14 | 104 = 96 + 8. Columns 1 to 4 are below 2^33, so
    # that every word is below 2^60.
    words = np.empty((4, len(a)), dtype=np.uint64)
    np.left_shift(columns[1], _SHIFT26, out=words[0])
    words[0] += columns[0]
    np.left_shift(columns[2:], np.array([[20], [14], [8]], dtype=np.uint64), out=words[1:])
    _reduce_words32(words.T, out)


def _limbs26(a: FieldArray) -> npt.NDArray[np.uint64]:
    """Shape (n, 2) to limbs of shape (5, n)."""
    low, high = a[:, 0], a[:, 1]
    result = np.empty((5, len(a)), dtype=np.uint64)
    result[0] = low
    np.right_shift(low, _SHIFT26, out=result[1])
    np.right_shift(low, np.uint64(52), out=result[2])
    result[2] |= high << np.uint64(12)
    np.right_shift(high, np.uint64(14), out=result[3])
    np.right_shift(high, np.uint64(40), out=result[4])
    result &= _LOW26
    return result


def scale(a: FieldArray, k: int) -> FieldArray:
    """Elementwise k * a for one integer k of either sign, taken mod p."""
    if a.size <= 2 * _FEW_SCALED:
        return _from_canonical([k * x % P for x in to_list(a)], a.shape[:-1])
    # k a = sum_i a_i (2^16i k mod p) over the 16-bit limbs a_i, in base 2^32: a float64 matrix product
    # whose entries are below 8 * 2^16 * 2^32 = 2^51 < 2^53, hence exact.
    rows = _from_canonical([(k << 16 * i) % P for i in range(8)], (8,)).view("<u4").astype(np.float64)
    limbs = np.ascontiguousarray(a).view("<u2").reshape((-1, 8))
    result = np.empty((len(limbs), 2), dtype=np.uint64)
    for start in range(0, len(limbs), _TILE):
        tile = slice(start, start + _TILE)
        _reduce_words32((limbs[tile].astype(np.float64) @ rows).astype(np.uint64), result[tile])
    return result.reshape(a.shape)


def inverse(k: int) -> int:
    """1 / k mod p, in [1, p).

    Raises:
        ZeroDivisionError: if k is 0 mod p.
    """
    return int(gmpy2.invert(k, P))
