"""The binary tree for large batches; the construction is in the package's docstring."""

from __future__ import annotations

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.prf import FixedKeyHash
from spdz.dcf.format import (
    SIGN,
    TOP,
    Words,
    chunks,
    control_masks,
    group_size,
    hash_in_place,
    tiles,
)
from spdz.foundations.types import Block, FieldArray

_CHUNK = 2048  # paths at a time: their seeds on all levels stay near the second-level cache (measured)
_ONE, _32, _63 = np.uint64(1), np.uint64(32), np.uint64(63)


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
    seed_words, payload_words = _correction_words(key, n, bits, w)
    for part in chunks(n, _CHUNK):
        path = _top_bits(threshold[part], bits)
        seeds = np.empty((bits + 1, 2, path.shape[1], 2), dtype=np.uint64)
        for party in (0, 1):
            _set_root(party, roots[party][part], seeds[0, party])
        flips = _deal_path(fixed_key_hash, seeds, path, seed_words[:, part])
        _deal_payload(fixed_key_hash, seeds, path, flips, payload[part], payload_words[:, :, part])


class BinaryKey:
    """The keys of a batch, for one party: as :class:`spdz.dcf.radix_key.RadixKey`."""

    __slots__ = ("_bits", "_hash", "_party", "_payload_words", "_roots", "_seed_words")

    def __init__(
        self, fixed_key_hash: FixedKeyHash, party: int, roots: Block, key: Words, bits: int, w: int
    ) -> None:
        self._hash, self._party, self._roots, self._bits = fixed_key_hash, party, roots, bits
        self._seed_words, self._payload_words = _correction_words(key, len(roots), bits, w)

    @property
    def levels(self) -> int:
        """How many blocks a payload's sum has."""
        return self._bits + 1

    def sums(self, points: Block) -> Words:
        """Sum the payload on the paths of points (n, k, 2), in base 2^32: shape (w, n, k, 4)."""
        n, k = points.shape[:2]
        sums = np.empty((self._payload_words.shape[1], n, k, 4), dtype=np.uint64)
        for keys, part in tiles(n, k, _CHUNK):
            directions = _top_bits(points[keys, part].reshape(-1, points.shape[2]), self._bits)
            seeds = np.empty((self._bits + 1, directions.shape[1], 2), dtype=np.uint64)
            tile = sums[:, keys, part]
            _set_root(self._party, self._roots[keys, None], seeds[0].reshape(*tile.shape[1:3], 2))
            payload_words = self._payload_words[:, :, keys]
            _walk(self._hash, seeds, directions, self._seed_words[:, keys], payload_words[:-1, 0])
            tile[...] = _payload_sums(self._hash, seeds, payload_words).reshape(tile.shape)
        return sums


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
    """Sum the payload of all nodes, in base 2^32: shape (w, n k, 4)."""
    levels, paths = seeds.shape[:2]
    w, n = words.shape[1:3]
    group = group_size(paths * w, levels)
    tweaks = _payload_tweaks(w, paths)
    # Whole words wrap; less the upper halves, what is left of their sum is below 2^64.
    whole, upper = np.zeros((2, w, paths, 2), dtype=np.uint64)
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
        whole += _total(blocks)
        np.right_shift(blocks, _32, out=blocks)
        upper += _total(blocks)
    sums = np.empty((w, paths, 2, 2), dtype=np.uint64)
    sums[..., 1] = upper
    np.subtract(whole, np.left_shift(upper, _32, out=upper), out=sums[..., 0])
    return sums.reshape(w, paths, 4)


def _total(blocks: Block) -> Words:
    """The sum over the first axis; a single level, as of large batches, need not be copied."""
    total: Words = blocks[0] if len(blocks) == 1 else np.add.reduce(blocks, axis=0)
    return total


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
    tweaks = _payload_tweaks(w, n)[:, None]
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


def _payload_tweaks(w: int, n: int) -> Block:
    """Even numbers, whereas the children's tweaks are odd; shape (w, n, 2) as inner loops of 2 are slow."""
    tweaks = np.zeros((w, n, 2), dtype=np.uint64)
    tweaks[..., 0] = np.arange(0, 2 * w, 2, dtype=np.uint64)[:, None]
    return tweaks


def _set_root(party: int, roots: Block, out: Block) -> None:
    """Copy root seeds with the party's number as the control bit."""
    out[...] = roots
    high = out[..., 1]
    high &= ~TOP
    high |= TOP * np.uint64(party)


def _correction_words(key: Words, n: int, bits: int, w: int) -> tuple[Block, Block]:
    """Views of shape (bits, n, 2) and (bits + 1, w, n, 2)."""
    split = 2 * bits * n
    return key[:split].reshape(bits, n, 2), key[split:].reshape(bits + 1, w, n, 2)


def _top_bits(numbers: Block, bits: int) -> Words:
    """The bits of n numbers, the most significant first, each as a word's top bit: shape (bits, n)."""
    result = np.empty((bits, len(numbers)), dtype=np.uint64)
    shifts = np.arange(64 - bits, 64, dtype=np.int64)[:, None]
    high = max(bits - 64, 0)
    if high:
        np.left_shift(numbers[:, 1], (shifts[:high] + 64).view(np.uint64), out=result[:high])
    np.left_shift(numbers[:, 0], shifts[high:].view(np.uint64), out=result[high:])
    result &= TOP
    return result
