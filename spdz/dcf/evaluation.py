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
    chunks,
    control_masks,
    correction_words,
    group_size,
    hash_in_place,
    key_bytes,
    payload_tweaks,
    set_root,
    top_bits,
)
from spdz.prf import FixedKeyHash
from spdz.types import Block, Buffer, FieldArray

_ONE, _32 = np.uint64(1), np.uint64(32)


def evaluate(party: int, roots: Block, key: Buffer, points: Block, bits: int, w: int) -> FieldArray:
    """One party's additive shares of beta [x < a] for n keys, each at its own point.

    Args:
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words of :func:`generate`.
        points: The public x, shape (n, 2), below 2^bits.
        bits: Width of the domain, 1 to 127.
        w: Payloads a key.

    Returns:
        Shares of shape (n, w, 2).

    Raises:
        ValueError: for shapes or a length that do not fit, or a point out of range.
    """
    n = len(roots)
    check_width(bits, w)
    if party not in (0, 1):
        raise ValueError(f"the party must be 0 or 1, not {party}")
    check_blocks("roots", roots, n)
    check_domain("points", points, n, bits)
    if memoryview(key).nbytes != key_bytes(n, bits, w):
        size = key_bytes(n, bits, w)
        raise ValueError(f"{n} keys of {bits} bits have {size} bytes, not {memoryview(key).nbytes}")
    words = np.frombuffer(key, dtype=WORD)
    index = int(words[0]) | int(words[1]) << 64
    if index >> INDEX_BITS:
        raise ValueError("the key does not begin with a hash index: it is damaged or not a key")
    fixed_key_hash = FixedKeyHash(index)
    seed_words, payload_words = correction_words(words, n, bits, w)
    sums = np.empty((n, w, 4), dtype=np.uint64)
    for part in chunks(n):
        directions = top_bits(points[part], bits)
        seeds = np.empty((bits + 1, directions.shape[1], 2), dtype=np.uint64)
        set_root(party, roots[part], seeds[0])
        _walk(fixed_key_hash, seeds, directions, seed_words[:, part], payload_words[:-1, 0, part])
        sums[part] = _payload_sums(fixed_key_hash, seeds, payload_words[:, :, part])
    shares = field.from_words32(sums)
    return field.neg(shares) if party else shares


def _walk(
    fixed_key_hash: FixedKeyHash, seeds: Block, directions: Words, seed_words: Block, flip_words: Block
) -> None:
    """Fill ``seeds`` (bits + 1, n, 2) from its first row along the path of ``directions``."""
    bits, n = directions.shape
    tweaks = np.zeros((bits, n, 2), dtype=np.uint64)
    np.bitwise_or(directions, _ONE, out=tweaks[..., 0])
    # The chosen child's control-bit correction goes on top: right = left ^ flip.
    low_words = seed_words[..., 0]
    high_words = directions & flip_words[..., 1]
    high_words ^= seed_words[..., 1]
    block, hashed, correction = (np.empty((n, 2), dtype=np.uint64) for _ in range(3))
    low, high = correction[:, 0], correction[:, 1]
    control = np.empty(n, dtype=np.int64)
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
    """Sum the payload of all nodes, in base 2^32: shape (n, w, 4)."""
    levels, w, n = words.shape[:3]
    group = group_size(n * w, levels)
    tweaks = payload_tweaks(w, n)
    total, upper = (np.zeros((w, n, 2), dtype=np.uint64) for _ in range(2))
    workspace = np.empty((2, group, w, n, 2), dtype=np.uint64)
    for start in range(0, levels, group):
        nodes = seeds[start : start + group, None]
        blocks, corrections = workspace[:, : len(nodes)]
        np.bitwise_xor(nodes, tweaks, out=blocks)
        hash_in_place(fixed_key_hash, blocks)
        np.bitwise_and(words[start : start + group], control_masks(nodes), out=corrections)
        blocks ^= corrections
        total += np.add.reduce(blocks, axis=0)
        blocks >>= _32
        upper += np.add.reduce(blocks, axis=0)
    # At most 128 terms: upper < 2^39, and total (mod 2^64) - 2^32 upper is the sum of the lower halves.
    sums = np.empty((n, w, 2, 2), dtype=np.uint64)
    sums[..., 1] = upper.swapaxes(0, 1)
    sums[..., 0] = (total - (upper << _32)).swapaxes(0, 1)
    return sums.reshape(n, w, 4)
