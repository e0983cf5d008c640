"""Dealing trees of radix 4 and 16 for small batches; the construction is in the package's docstring."""

from __future__ import annotations

import secrets
from functools import lru_cache

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.prf import FixedKeyHash, expand
from spdz.dcf.format import (
    SIGN,
    TOP,
    Words,
    digit_width,
    group_size,
    hash_in_place,
    level_count,
)
from spdz.foundations.types import Block, FieldArray

_KIND = np.uint64(8)


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
    child_words, payload_words = correction_words(key, n, bits, w)
    digits = digits_of(threshold, bits, digit_bits)
    states = _deal_path(fixed_key_hash, roots, digits, child_words)
    _deal_payload(fixed_key_hash, states, digits, payload, payload_words)


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
        states[0, party] = root(party, roots[party])
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
    tweaks[..., 0] = every ^ kinds(w)[:, None, None, None]
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


def correction_words(key: Words, n: int, bits: int, w: int) -> tuple[Block, Block]:
    """Views of shape (levels - 1, n, radix, 2) and (w, levels, n, radix, 2)."""
    digit_bits = digit_width(n)
    levels, radix = level_count(bits, digit_bits), 1 << digit_bits
    split = 2 * radix * n * (levels - 1)
    return key[:split].reshape(levels - 1, n, radix, 2), key[split:].reshape(w, levels, n, radix, 2)


def root(party: int, roots: Block) -> Block:
    """Root seeds with the party's number as both control bits."""
    root: Block = roots & ~TOP | TOP * np.uint64(party)
    return root


def kinds(w: int) -> Words:
    """What tells the payloads' hash inputs from the child's (seed ^ digit): above all digits."""
    kinds: Words = np.arange(1, w + 1, dtype=np.uint64) << _KIND
    return kinds


def digits_of(numbers: Block, bits: int, digit_bits: int) -> Words:
    """The digits of the lowest ``bits`` bits of n numbers, the most significant first: shape (levels, n)."""
    high_shifts, low_shifts, masks = _places(bits, digit_bits)
    result = np.empty((len(masks), len(numbers)), dtype=np.uint64)
    high = len(high_shifts)
    if high:
        np.right_shift(numbers[:, 1], high_shifts, out=result[:high])
    np.right_shift(numbers[:, 0], low_shifts, out=result[high:])
    result &= masks
    return result


@lru_cache(maxsize=256)
def _places(bits: int, digit_bits: int) -> tuple[Words, Words, Words]:
    """Shifts in the high and in the low word, and masks, of all digits; none crosses a word."""
    levels, in_word = level_count(bits, digit_bits), 64 // digit_bits
    low = min(levels, in_word)
    shifts = np.arange(64 - digit_bits, -1, -digit_bits).astype(np.uint64)[:, None]
    masks = np.full((levels, 1), (1 << digit_bits) - 1, dtype=np.uint64)
    masks[0] >>= np.uint64(levels * digit_bits - bits)
    return shifts[in_word - (levels - low) :], shifts[in_word - low :], masks
