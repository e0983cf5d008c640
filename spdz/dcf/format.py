"""The key format of the DCF and what dealing and evaluating have in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.prf import FixedKeyHash
from spdz.foundations.types import Block, Shape

WORD = np.dtype("<u8")
INDEX_BITS = 32
HEADER = 16
# Up to so many keys, so many bits a digit: wider digits save calls and cost bytes (decision 10).
WIDE_DIGITS = {8: 4, 64: 2}
_GROUP = 8192  # payload blocks at a time: they and their temporaries stay close to the first level
TOP = np.uint64(1 << 63)
# right_shift(int64, 63) spreads the top bit over the word. To a ufunc, a 0-d array costs less than a scalar.
SIGN = np.array(63, dtype=np.int64)
SIGN.flags.writeable = False

Words: TypeAlias = npt.NDArray[np.uint64]


def key_bytes(n: int, bits: int, w: int, digit_bits: int | None = None) -> int:
    """Length of the correction words of n keys with w payloads each: a multiple of 16."""
    digit_bits = digit_bits or digit_width(n)
    if digit_bits == 1:
        return HEADER + 16 * n * (bits + w * (bits + 1))
    levels = level_count(bits, digit_bits)
    return HEADER + 16 * n * (levels - 1 + w * levels << digit_bits)


def digit_width(n: int) -> int:
    """Bits of a digit in a batch of n keys: 4, 2 or 1; 1 is the binary tree."""
    return next((digit_bits for most, digit_bits in WIDE_DIGITS.items() if 0 < n <= most), 1)


def level_count(bits: int, digit_bits: int) -> int:
    """Digits of a number; the leading digit may have fewer bits."""
    return -(-bits // digit_bits)


def group_size(blocks: int, levels: int) -> int:
    """How many levels of so many blocks to work on at a time."""
    return min(levels, max(1, _GROUP // blocks))


def base32_sums(blocks: Block, axis: int) -> Words:
    """Sum 128-bit blocks along an axis: shape S + (2,) to sums in base 2^32, S without the axis + (4,).

    Up to 2^30 blocks: then each sum is below 2^62.
    """
    words: Words = np.add.reduce(blocks.view("<u4"), axis=axis, dtype=np.uint64)
    return words


def control_masks(seeds: Block) -> Block:
    """All ones where t = 1, else zeros, in both words."""
    masks = np.empty(seeds.shape, dtype=np.int64)
    np.right_shift(seeds.view(np.int64)[..., 1], SIGN, out=masks[..., 1])
    masks[..., 0] = masks[..., 1]
    return masks.view(np.uint64)


def hash_in_place(fixed_key_hash: FixedKeyHash, blocks: Block) -> None:
    """Hash every block of an array of any shape."""
    flat = blocks.reshape(-1, 2)
    fixed_key_hash.hash_into(flat, flat)


def chunks(n: int, most: int) -> Iterator[slice]:
    """Nearly equal parts of at most ``most``."""
    size = max(1, -(-n // max(1, -(-n // most))))
    return (slice(start, start + size) for start in range(0, n, size))


def tiles(n: int, k: int, most: int) -> Iterator[tuple[slice, slice]]:
    """Keys and points in tiles of at most ``most`` paths."""
    points = list(chunks(k, most))
    width = points[0].stop if points else 1
    return ((keys, part) for keys in chunks(n, max(1, most // width)) for part in points)


def check_width(bits: int, w: int) -> None:
    """Refuse a domain or a payload count out of range."""
    if not 1 <= bits <= 127:
        raise ValueError(f"the domain must have 1 to 127 bits, not {bits}")
    if w < 1:
        raise ValueError(f"there must be at least one payload, not {w}")


def check_blocks(name: str, blocks: Block, shape: Shape) -> None:
    """Refuse anything but 128-bit blocks of a shape."""
    shape = (*shape, 2)
    if blocks.shape != shape or blocks.dtype != np.uint64:
        raise ValueError(f"{name} must be uint64 of shape {shape}, not {blocks.dtype} of {blocks.shape}")


def check_domain(name: str, numbers: Block, shape: Shape, bits: int) -> None:
    """Refuse numbers that are not below 2^bits."""
    check_blocks(name, numbers, shape)
    # The OR of all numbers has a bit at or above 2^bits if and only if one of them has.
    low, high = (int(np.bitwise_or.reduce(numbers[..., word], axis=None)) for word in (0, 1))
    if high >> max(bits - 64, 0) or low >> bits:
        raise ValueError(f"{name} must be below 2^{bits}")
