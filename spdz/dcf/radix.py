"""The trees of radix 4 and 16 for small batches; the construction is in the package's docstring."""

from __future__ import annotations

import secrets

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.prf import FixedKeyHash, expand
from spdz.dcf.format import (
    SIGN,
    TOP,
    Words,
    base32_sums,
    control_masks,
    digit_width,
    group_size,
    hash_in_place,
    level_count,
    tiles,
)
from spdz.foundations.types import Block, FieldArray

_KIND = np.uint64(8)
_TILE = 16384  # payload blocks at a time (measured)


def deal(
    fixed_key_hash: FixedKeyHash,
    roots: tuple[Block, Block],
    threshold: Block,
    payload: FieldArray,
    bits: int,
    key: Words,
) -> None:
    """Write the correction words of n keys to ``key``."""
    n, w = payload.shape[:2]
    digit_bits = digit_width(n)
    child_words, payload_words = _correction_words(key, n, bits, w)
    digits = _digits(threshold, bits, digit_bits)
    states = _deal_path(fixed_key_hash, roots, digits, child_words)
    _deal_payload(fixed_key_hash, states, digits, payload, payload_words)


def evaluate(
    fixed_key_hash: FixedKeyHash, party: int, roots: Block, key: Words, points: Block, bits: int, w: int
) -> Words:
    """Sum the payload on the paths of points (n, k, 2), in base 2^32: shape (n, k, w, 4)."""
    n, k = points.shape[:2]
    digit_bits = digit_width(n)
    child_words, payload_words = _correction_words(key, n, bits, w)
    levels, radix = payload_words.shape[1], 1 << digit_bits
    start = _root(party, roots)[:, None]
    first_row = np.arange(0, radix * levels * n, radix).reshape(levels, n, 1)
    sums = np.empty((n, k, w, 4), dtype=np.uint64)
    for keys, part in tiles(n, k, max(1, _TILE // (levels * w))):
        tile = sums[keys, part]
        digits = _digits(points[keys, part].reshape(-1, 2), bits, digit_bits)
        rows = digits.view(np.int64).reshape(levels, *tile.shape[:2]) + first_row[:, keys]
        rows = rows.reshape(digits.shape)
        nodes = np.zeros((*digits.shape, 2), dtype=np.uint64)
        nodes[..., 0] = digits
        nodes[0].reshape(*tile.shape[:2], 2)[...] ^= start[keys]
        _walk(fixed_key_hash, nodes, child_words.reshape(-1, 2).take(rows[:-1], axis=0))
        words = payload_words.reshape(w, -1, 2).take(rows, axis=1)
        tile[...] = _payload_sums(fixed_key_hash, nodes, words).reshape(tile.shape)
    return sums


def _walk(fixed_key_hash: FixedKeyHash, nodes: Block, corrections: Block) -> None:
    """Turn digits ``nodes`` (levels, paths, 2), the first with the root seed XORed, into seeds ^ digits."""
    block = nodes[0].copy()
    hashed, corrected = np.empty_like(block), np.empty_like(block)
    signed, control = block.view(np.int64), corrected.view(np.int64)
    xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
    hash_block = fixed_key_hash.bind(block, hashed)
    for child, correction in zip(nodes[1:], corrections, strict=True):
        hash_block()
        right_shift(signed, SIGN, control)
        bitwise_and(corrected, correction, corrected)
        xor(hashed, corrected, hashed)
        xor(hashed, child, child)
        block[...] = child


def _payload_sums(fixed_key_hash: FixedKeyHash, nodes: Block, words: Block) -> Words:
    """Sum the payload of nodes (levels, paths, 2) with corrections (w, levels, paths, 2): (paths, w, 4)."""
    blocks = np.empty_like(words)
    blocks[...] = nodes
    low = blocks[..., 0]
    np.bitwise_xor(low, _kinds(len(words))[:, None, None], out=low)
    hash_in_place(fixed_key_hash, blocks)
    np.bitwise_and(words, control_masks(nodes), out=words)
    blocks ^= words
    return np.asarray(base32_sums(blocks, axis=1).swapaxes(0, 1))


def _deal_path(
    fixed_key_hash: FixedKeyHash, roots: tuple[Block, Block], digits: Words, child_words: Block
) -> Block:
    """Write the child CWs.

    Returns:
        Both parties' states along the path, shape (levels, 2, n, 2).
    """
    levels, n = digits.shape
    radix = child_words.shape[2]
    states = np.empty((levels, 2, n, 2), dtype=np.uint64)
    for party in (0, 1):
        states[0, party] = _root(party, roots[party])
    # Once XORed to the kept child's CW, they make its seeds independent and both its control bits differ.
    coins = expand(secrets.token_bytes(16), 16 * (levels - 1) * n).reshape(levels - 1, n, 2) | TOP
    tweaks = np.zeros((2, n, radix, 2), dtype=np.uint64)
    tweaks[..., 0] = np.arange(radix)
    own = np.arange(n)
    for state, child, digit, coin, words in zip(
        states[:-1], states[1:], digits[:-1].view(np.int64), coins, child_words, strict=True
    ):
        children = state[:, :, None] ^ tweaks
        hash_in_place(fixed_key_hash, children)
        np.bitwise_xor(children[0], children[1], out=words)
        words[own, digit] ^= coin
        masks = (state.view(np.int64) >> SIGN).view(np.uint64)
        np.bitwise_xor(children[:, own, digit], words[own, digit] & masks, out=child)
    return states


def _deal_payload(
    fixed_key_hash: FixedKeyHash, states: Block, digits: Words, payload: FieldArray, payload_words: Block
) -> None:
    """Write the payload CWs, ``payload_words`` of shape (w, levels, n, radix, 2)."""
    w, levels, n, radix = payload_words.shape[:4]
    every = np.arange(radix, dtype=np.uint64)
    beta = payload.swapaxes(0, 1)
    # T adds g_id = beta [d < a_i] to O's payload if it is party 0, and takes it away if it is party 1.
    choices = np.stack([field.zeros((w, n)), beta, field.neg(beta)]).reshape(-1, 2)
    own = np.arange(w * n).reshape(w, 1, n, 1)
    # -1 where T is party 1.
    holder = states.view(np.int64)[:, 1, :, 1, None] >> SIGN
    chosen = (every < digits[..., None]) * (1 - holder) * (w * n)
    swaps = holder.view(np.uint64)[..., None]
    tweaks = np.zeros((w, 1, 1, radix, 2), dtype=np.uint64)
    tweaks[..., 0] = every ^ _kinds(w)[:, None, None, None]
    group = group_size(2 * n * w * radix, levels)
    for part in (slice(start, start + group) for start in range(0, levels, group)):
        hashed = [states[part, party, :, None] ^ tweaks for party in (0, 1)]
        for blocks in hashed:
            hash_in_place(fixed_key_hash, blocks)
        y_0, y_1 = hashed
        swap = (y_0 ^ y_1) & swaps[part]
        y_t, y_o = y_0 ^ swap, y_1 ^ swap
        r = field.add(field.from_blocks(y_o), choices.take(chosen[part] + own, axis=0))
        r[..., 1] |= y_o[..., 1] & TOP  # weighs 1 (mod p) on both sides
        np.bitwise_xor(r, y_t, out=payload_words[:, part])


def _correction_words(key: Words, n: int, bits: int, w: int) -> tuple[Block, Block]:
    """Views of shape (levels - 1, n, radix, 2) and (w, levels, n, radix, 2)."""
    digit_bits = digit_width(n)
    levels, radix = level_count(bits, digit_bits), 1 << digit_bits
    split = 2 * radix * n * (levels - 1)
    return key[:split].reshape(levels - 1, n, radix, 2), key[split:].reshape(w, levels, n, radix, 2)


def _root(party: int, roots: Block) -> Block:
    """Root seeds with the party's number as both control bits."""
    root: Block = roots & ~TOP | TOP * np.uint64(party)
    return root


def _kinds(w: int) -> Words:
    """What tells the payloads' hash inputs from the child's (seed ^ digit): above all digits."""
    kinds: Words = np.arange(1, w + 1, dtype=np.uint64) << _KIND
    return kinds


def _digits(numbers: Block, bits: int, digit_bits: int) -> Words:
    """The digits of n numbers, the most significant first: shape (levels, n). None crosses a word."""
    levels, in_word = level_count(bits, digit_bits), 64 // digit_bits
    shifts = np.arange(64 - digit_bits, -1, -digit_bits).astype(np.uint64)[:, None]
    high = max(levels - in_word, 0)
    result = np.empty((levels, len(numbers)), dtype=np.uint64)
    if high:
        np.right_shift(numbers[:, 1], shifts[in_word - high :], out=result[:high])
    np.right_shift(numbers[:, 0], shifts[in_word - levels + high :], out=result[high:])
    result &= np.uint64((1 << digit_bits) - 1)
    return result
