"""Evaluating DCF keys; the construction is in the package's docstring."""

from __future__ import annotations

import numpy as np

from spdz import field
from spdz.dcf.format import (
    INDEX_BITS,
    SIGN,
    WORD,
    Words,
    check_blocks,
    check_domain,
    check_width,
    control_masks,
    correction_words,
    group_size,
    hash_in_place,
    key_bytes,
    payload_tweaks,
    set_root,
    tiles,
    top_bits,
)
from spdz.prf import FixedKeyHash
from spdz.types import Block, Buffer, FieldArray

_ONE, _32 = np.uint64(1), np.uint64(32)


def evaluate(party: int, roots: Block, key: Buffer, points: Block, bits: int, w: int) -> FieldArray:
    """One party's additive shares of beta [x < a] for n keys, each at its own point or at k points.

    Args:
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words of :func:`generate`.
        points: The public x below 2^bits, shape (n, 2) or (n, k, 2).
        bits: Width of the domain, 1 to 127.
        w: Payloads a key.

    Returns:
        Shares of shape (n, w, 2) or (n, k, w, 2).

    Raises:
        ValueError: for shapes or a length that do not fit, or a point out of range.
    """
    n = len(roots)
    check_width(bits, w)
    if party not in (0, 1):
        raise ValueError(f"the party must be 0 or 1, not {party}")
    check_blocks("roots", roots, (n,))
    k = points.shape[1] if points.ndim == 3 else 1
    check_domain("points", points, (n, k) if points.ndim == 3 else (n,), bits)
    if memoryview(key).nbytes != key_bytes(n, bits, w):
        size = key_bytes(n, bits, w)
        raise ValueError(f"{n} keys of {bits} bits have {size} bytes, not {memoryview(key).nbytes}")
    words = np.frombuffer(key, dtype=WORD)
    index = int(words[0]) | int(words[1]) << 64
    if index >> INDEX_BITS:
        raise ValueError("the key does not begin with a hash index: it is damaged or not a key")
    fixed_key_hash = FixedKeyHash(index)
    seed_words, payload_words = correction_words(words, n, bits, w)
    grid = points.reshape(n, k, 2)
    sums = np.empty((n, k, w, 4), dtype=np.uint64)
    for keys, part in tiles(n, k):
        directions = top_bits(grid[keys, part].reshape(-1, 2), bits)
        seeds = np.empty((bits + 1, directions.shape[1], 2), dtype=np.uint64)
        tile = sums[keys, part]
        set_root(party, roots[keys, None], seeds[0].reshape(*tile.shape[:2], 2))
        _walk(fixed_key_hash, seeds, directions, seed_words[:, keys], payload_words[:-1, 0, keys])
        tile[...] = _payload_sums(fixed_key_hash, seeds, payload_words[:, :, keys]).reshape(tile.shape)
    shares = field.from_words32(sums.reshape(*points.shape[:-1], w, 4))
    return field.neg(shares) if party else shares


def _each(words: Words, paths: int) -> Words:
    """Words of shape (..., n) for n keys at k points: shape (..., n k), a copy only if n > 1 and k > 1."""
    n = words.shape[-1]
    return np.broadcast_to(words[..., None], (*words.shape, paths // n)).reshape(*words.shape[:-1], paths)


def _walk(
    fixed_key_hash: FixedKeyHash, seeds: Block, directions: Words, seed_words: Block, flip_words: Block
) -> None:
    """Fill ``seeds`` (bits + 1, n k, 2) from its first row along the path of ``directions``."""
    bits, paths = directions.shape
    tweaks = np.zeros((bits, paths, 2), dtype=np.uint64)
    np.bitwise_or(directions, _ONE, out=tweaks[..., 0])
    # The chosen child's control-bit correction goes on top: right = left ^ flip.
    low_words = _each(seed_words[..., 0], paths)
    high_words = directions & _each(flip_words[..., 1], paths)
    high_words ^= _each(seed_words[..., 1], paths)
    block, hashed, correction = (np.empty((paths, 2), dtype=np.uint64) for _ in range(3))
    low, high = correction[:, 0], correction[:, 1]
    control = np.empty(paths, dtype=np.int64)
    mask = control.view(np.uint64)
    signed = seeds.view(np.int64)[..., 1]
    xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
    hash_block = fixed_key_hash.bind(block, hashed)
    node = seeds[0]
    levels = zip(seeds[1:], signed[:-1], tweaks, low_words, high_words, strict=True)
    for child, sign, tweak, low_word, high_word in levels:
        xor(node, tweak, block)
        hash_block()
        right_shift(sign, SIGN, control)
        bitwise_and(low_word, mask, low)
        bitwise_and(high_word, mask, high)
        xor(hashed, correction, child)
        node = child


def _payload_sums(fixed_key_hash: FixedKeyHash, seeds: Block, words: Block) -> Words:
    """Sum the payload of all nodes, in base 2^32: shape (n k, w, 4)."""
    levels, paths = seeds.shape[:2]
    w, n = words.shape[1:3]
    group = group_size(paths * w, levels)
    tweaks = payload_tweaks(w, paths)
    total, upper = (np.zeros((w, paths, 2), dtype=np.uint64) for _ in range(2))
    workspace = np.empty((2, group, w, paths, 2), dtype=np.uint64)
    for start in range(0, levels, group):
        part = slice(start, start + group)
        nodes = seeds[part, None]
        blocks, corrections = workspace[:, : len(nodes)]
        np.bitwise_xor(nodes, tweaks, out=blocks)
        hash_in_place(fixed_key_hash, blocks)
        masks = control_masks(nodes)
        if n == paths:
            np.bitwise_and(words[part], masks, out=corrections)
        else:
            for half in (0, 1):
                each = _each(words[part, ..., half], paths)
                np.bitwise_and(each, masks[..., half], out=corrections[..., half])
        blocks ^= corrections
        total += np.add.reduce(blocks, axis=0)
        blocks >>= _32
        upper += np.add.reduce(blocks, axis=0)
    # At most 128 terms: upper < 2^39, and total (mod 2^64) - 2^32 upper is the sum of the lower halves.
    sums = np.empty((paths, w, 2, 2), dtype=np.uint64)
    sums[..., 1] = upper.swapaxes(0, 1)
    sums[..., 0] = (total - (upper << _32)).swapaxes(0, 1)
    return sums.reshape(paths, w, 4)
