"""The key format of the DCF and what dealing and evaluating have in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.prf import FixedKeyHash
from spdz.types import Block, Shape

WORD = np.dtype("<u8")
INDEX_BITS = 32
_HEADER = 16
_CHUNK = 1024  # paths at a time: their seeds on all levels stay in the second-level cache
_GROUP = 8192  # payload blocks at a time: they and their temporaries stay close to the first level
TOP = np.uint64(1 << 63)
# right_shift(int64, 63) spreads the top bit over the word. To a ufunc, a 0-d array costs less than a scalar.
SIGN = np.array(63, dtype=np.int64)
SIGN.flags.writeable = False

Words: TypeAlias = npt.NDArray[np.uint64]


def key_bytes(n: int, bits: int, w: int) -> int:
    """Length of the correction words of n keys with w payloads each: a multiple of 16."""
    return _HEADER + 16 * n * (bits + w * (bits + 1))


def control_masks(seeds: Block) -> Block:
    """All ones where t = 1, else zeros, in both words."""
    masks = np.empty(seeds.shape, dtype=np.int64)
    np.right_shift(seeds.view(np.int64)[..., 1], SIGN, out=masks[..., 1])
    masks[..., 0] = masks[..., 1]
    return masks.view(np.uint64)


def payload_tweaks(w: int, n: int) -> Block:
    """Even numbers, whereas the children's tweaks are odd; shape (w, n, 2) as inner loops of 2 are slow."""
    tweaks = np.zeros((w, n, 2), dtype=np.uint64)
    tweaks[..., 0] = np.arange(0, 2 * w, 2, dtype=np.uint64)[:, None]
    return tweaks


def group_size(blocks: int, levels: int) -> int:
    """How many levels of so many blocks to work on at a time."""
    return min(levels, max(1, _GROUP // blocks))


def hash_in_place(fixed_key_hash: FixedKeyHash, blocks: Block) -> None:
    """Hash every block of an array of any shape."""
    flat = blocks.reshape(-1, 2)
    fixed_key_hash.hash_into(flat, flat)


def set_root(party: int, roots: Block, out: Block) -> None:
    """Copy root seeds with the party's number as the control bit."""
    out[...] = roots
    high = out[..., 1]
    high &= ~TOP
    high |= TOP * np.uint64(party)


def correction_words(key: Words, n: int, bits: int, w: int) -> tuple[Block, Block]:
    """Views of shape (bits, n, 2) and (bits + 1, w, n, 2)."""
    words = key[_HEADER // 8 :]
    split = 2 * bits * n
    return words[:split].reshape(bits, n, 2), words[split:].reshape(bits + 1, w, n, 2)


def top_bits(numbers: Block, bits: int) -> Words:
    """The bits of n numbers, the most significant first, each as a word's top bit: shape (bits, n)."""
    result = np.empty((bits, len(numbers)), dtype=np.uint64)
    shifts = np.arange(64 - bits, 64, dtype=np.int64)[:, None]
    high = max(bits - 64, 0)
    np.left_shift(numbers[:, 1], (shifts[:high] + 64).view(np.uint64), out=result[:high])
    np.left_shift(numbers[:, 0], shifts[high:].view(np.uint64), out=result[high:])
    result &= TOP
    return result


def chunks(n: int, most: int = _CHUNK) -> Iterator[slice]:
    """Nearly equal parts of at most ``most``."""
    size = max(1, -(-n // max(1, -(-n // most))))
    return (slice(start, start + size) for start in range(0, n, size))


def tiles(n: int, k: int) -> Iterator[tuple[slice, slice]]:
    """Keys and points in tiles of at most ``_CHUNK`` paths."""
    points = list(chunks(k))
    width = points[0].stop if points else 1
    return ((keys, part) for keys in chunks(n, max(1, _CHUNK // width)) for part in points)


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
    low, high = (int(numbers[..., word].max(initial=0)) for word in (0, 1))
    if high >> max(bits - 64, 0) or low >> bits:
        raise ValueError(f"{name} must be below 2^{bits}")
