"""Dealing DCF keys; the construction is in the package's docstring."""

from __future__ import annotations

import secrets

import numpy as np

from spdz import field
from spdz.dcf.format import (
    INDEX_BITS,
    SIGN,
    TOP,
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
from spdz.types import Block, FieldArray

_ONE, _63 = np.uint64(1), np.uint64(63)


def generate(roots0: Block, roots1: Block, threshold: Block, payload: FieldArray, bits: int) -> bytes:
    """Deal n keys.

    Args:
        roots0: Party 0's pseudo-random root seeds, shape (n, 2). Their top bits are not used.
        roots1: Party 1's.
        threshold: The secret a, shape (n, 2), below 2^bits.
        payload: The secret beta, shape (n, w, 2).
        bits: Width of the domain, 1 to 127.

    Returns:
        The correction words, ``key_bytes(n, bits, w)`` bytes, for both parties.

    Raises:
        ValueError: for shapes that do not fit, a threshold out of range or a payload that is not canonical.
    """
    if payload.ndim != 3 or payload.shape[2] != 2:
        raise ValueError(f"the payload must have shape (n, w, 2), not {payload.shape}")
    n, w = payload.shape[:2]
    check_width(bits, w)
    for name, seeds in (("roots0", roots0), ("roots1", roots1)):
        check_blocks(name, seeds, (n,))
    check_domain("threshold", threshold, (n,), bits)
    if not field.is_canonical(payload):
        raise ValueError("the payload must be below p")
    index = secrets.randbits(INDEX_BITS)
    fixed_key_hash = FixedKeyHash(index)
    key = np.zeros(key_bytes(n, bits, w) // 8, dtype=WORD)
    key[0] = index
    seed_words, payload_words = correction_words(key, n, bits, w)
    for part in chunks(n):
        path = top_bits(threshold[part], bits)
        seeds = np.empty((bits + 1, 2, path.shape[1], 2), dtype=np.uint64)
        for party, roots in enumerate((roots0, roots1)):
            set_root(party, roots[part], seeds[0, party])
        flips = _deal_path(fixed_key_hash, seeds, path, seed_words[:, part])
        _deal_payload(fixed_key_hash, seeds, path, flips, payload[part], payload_words[:, :, part])
    return key.tobytes()


def _deal_path(fixed_key_hash: FixedKeyHash, seeds: Block, path: Words, seed_words: Block) -> Words:
    """Fill both parties' seeds (bits + 1, 2, n, 2) along the path from the first row, and the seed CWs.

    Returns:
        left ^ right control-bit correction as the top bit, shape (bits + 1, n); 0 at the leaf.
    """
    bits, n = path.shape
    # Children are (kept, lost): the kept one is in the direction of the path.
    tweaks = np.zeros((bits, 2, 2, n, 2), dtype=np.uint64)
    tweaks[:, 0, :, :, 0] = (path | _ONE)[:, None]
    tweaks[:, 1, :, :, 0] = (path ^ TOP | _ONE)[:, None]
    flips = np.zeros((bits + 1, n), dtype=np.uint64)
    blocks, children = (np.empty((2, 2, n, 2), dtype=np.uint64) for _ in range(2))
    both, correction = (np.empty((2, n, 2), dtype=np.uint64) for _ in range(2))
    kept, lost = both
    kept_high, lost_low, lost_high = kept[:, 1], lost[:, 0], lost[:, 1]
    low, high = correction[..., 0], correction[..., 1]
    kept_children, of_0, of_1 = children[0], children[:, 0], children[:, 1]
    control = np.empty((2, n), dtype=np.int64)
    mask = control.view(np.uint64)
    xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
    hash_blocks = fixed_key_hash.bind(blocks, children)
    signed = seeds.view(np.int64)[..., 1]
    node = seeds[0]
    levels = zip(seeds[1:], signed[:-1], tweaks, flips[:-1], seed_words, strict=True)
    for child, sign, tweak, flip, words in levels:
        xor(node, tweak, blocks)
        hash_blocks()
        xor(of_0, of_1, both)
        # t_0 ^ t_1 must be 1 in the kept child and 0 in the lost one.
        xor(kept_high, lost_high, flip)
        bitwise_and(np.invert(flip, flip), TOP, flip)
        xor(lost_high, flip, lost_high)
        words[...] = lost
        right_shift(sign, SIGN, control)
        bitwise_and(lost_low, mask, low)
        bitwise_and(lost_high, mask, high)
        xor(kept_children, correction, child)
        node = child
    # So far the words hold the kept child's control-bit correction; the format wants the left child's.
    seed_words[..., 1] ^= flips[:-1] & path
    return flips


def _deal_payload(
    fixed_key_hash: FixedKeyHash, seeds: Block, path: Words, flips: Words, payload: FieldArray, words: Block
) -> None:
    """Write the payload CWs, ``words`` of shape (bits + 1, w, n, 2)."""
    levels, w, n = words.shape[:3]
    beta = payload.swapaxes(0, 1)
    # CW's top bit is the flip, so r's top bit is given, and it weighs 1 (mod p), as does that of y_O. What is
    # added to y_O is therefore (-1, 0 or 1) beta + (-1, 0 or 1): nine choices for each payload.
    signed = np.stack([field.neg(beta), field.zeros((w, n)), beta])
    choices = field.add(signed[:, None], field.from_ints([-1, 0, 1])[:, None, None]).reshape(-1, 2)
    own = np.arange(w * n).reshape(w, n)
    # All ones where T is party 1: then -g_i is added, else g_i.
    holder = control_masks(seeds[:, None, 1])
    negate = holder[..., 0].view(np.int64)
    digits = (path >> _63).view(np.int64)[:, None]
    steps = (np.diff(digits, axis=0, prepend=0, append=0) ^ negate) - negate
    tweaks = payload_tweaks(w, n)[:, None]
    group = group_size(2 * n * w, levels)
    for part in (slice(start, start + group) for start in range(0, levels, group)):
        blocks = seeds[part, None] ^ tweaks
        hash_in_place(fixed_key_hash, blocks)
        y_0, y_1 = blocks[:, :, 0], blocks[:, :, 1]
        swap = (y_0 ^ y_1) & holder[part]
        y_t, y_o = y_0 ^ swap, y_1 ^ swap
        top = (y_t[..., 1] ^ flips[part, None]) >> _63
        balance = ((y_o[..., 1] >> _63) - top).view(np.int64)
        added = choices.take((3 * steps[part] + balance + 4) * (w * n) + own, axis=0)
        r = field.add(field.from_blocks(y_o), added)
        r[..., 1] |= top << _63
        np.bitwise_xor(r, y_t, out=words[part])
