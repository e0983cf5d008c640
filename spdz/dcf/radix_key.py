"""Evaluating trees of radix 4 and 16; the construction is in the package's docstring.

With few keys NumPy's calls are what costs. So all that depends on the key alone is done once, and a level is
six calls: one of AES and five on all paths. (Half of the nodes of 124 geometric thresholds are shared by
neighbours; to find them costs about what they cost.)
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from spdz.arithmetic.prf import FixedKeyHash
from spdz.dcf.format import (
    SIGN,
    Words,
    base32_sums,
    digit_width,
    hash_in_place,
    tiles,
)
from spdz.dcf.radix import correction_words, digits_of, kinds, root
from spdz.foundations.types import Block, IntArray

_TILE = 16384  # payload blocks at a time (measured)


class RadixKey:
    """The keys of a batch, for one party.

    Args:
        fixed_key_hash: The batch's.
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words.
        bits: Width of the domain.
        w: Payloads a key.
    """

    __slots__ = ("_bits", "_children", "_digit_bits", "_first_row", "_hash", "_payload", "_start")

    def __init__(
        self, fixed_key_hash: FixedKeyHash, party: int, roots: Block, key: Words, bits: int, w: int
    ) -> None:
        n = len(roots)
        children, payload = correction_words(key, n, bits, w)
        self._hash, self._bits, self._digit_bits = fixed_key_hash, bits, digit_width(n)
        self._start = root(party, roots)[:, None]
        self._children, self._payload = children.reshape(-1, 2), payload.reshape(w, -1, 2)
        self._first_row = _first_rows(*payload.shape[1:4])

    @property
    def levels(self) -> int:
        """How many blocks a payload's sum has."""
        return len(self._first_row)

    def sums(self, points: Block) -> Words:
        """Sum the payload on the paths of points (n, k, 2), in base 2^32: shape (w, n, k, 4)."""
        n, k = points.shape[:2]
        w, levels = len(self._payload), len(self._first_row)
        if 0 < n * k * levels * w <= _TILE:
            return self._tile(points, slice(0, n))
        sums = np.empty((w, n, k, 4), dtype=np.uint64)
        for keys, part in tiles(n, k, max(1, _TILE // (levels * w))):
            sums[:, keys, part] = self._tile(points[keys, part], keys)
        return sums

    def _tile(self, points: Block, keys: slice) -> Words:
        n, k = points.shape[:2]
        levels, paths = len(self._first_row), n * k
        digits = digits_of(points.reshape(paths, -1), self._bits, self._digit_bits)
        each = digits.view(np.int64).reshape(levels, n, k)
        rows = (each + self._first_row[:, keys]).reshape(levels, paths)
        nodes = np.zeros((levels, paths, 2), dtype=np.uint64)
        nodes[..., 0] = digits
        first = nodes[0].reshape(n, k, 2)
        first ^= self._start[keys]
        controls = self._walk(nodes, self._children.take(rows[:-1], axis=0))
        return self._payload_sums(nodes, controls, self._payload.take(rows, axis=1)).reshape(-1, n, k, 4)

    def _walk(self, nodes: Block, corrections: Block) -> Block:
        """Turn digits (levels, paths, 2), the first with the root seed XORed, into seeds ^ digits.

        Returns:
            The control bits as masks of the halves, of the same shape.
        """
        size = nodes[0].nbytes
        source, permute = nodes.reshape(-1).view(np.uint8).data, self._hash.permute
        scratch = np.empty(size + 16, dtype=np.uint8)
        signed = nodes.view(np.int64)
        controls, node = np.empty_like(signed), signed[0]
        corrected, permuted, room = np.empty_like(node), scratch[:size].view(np.int64), scratch.data
        permuted = permuted.reshape(node.shape)
        xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
        at = 0
        for control, correction, child in zip(controls, corrections.view(np.int64), signed[1:], strict=False):
            permute(source[at : at + size], room)
            at += size
            right_shift(node, SIGN, control)
            bitwise_and(control, correction, corrected)
            xor(corrected, node, corrected)
            xor(corrected, permuted, corrected)
            xor(corrected, child, child)
            node = child
        right_shift(node, SIGN, controls[-1])
        return controls.view(np.uint64)

    def _payload_sums(self, nodes: Block, controls: Block, words: Block) -> Words:
        """Sum the payload of nodes (levels, paths, 2), corrected by ``words``: shape (w, paths, 4)."""
        blocks = np.bitwise_xor(nodes, _tweaks(len(words), *nodes.shape[:2]))
        hash_in_place(self._hash, blocks)
        controls[..., 0] = controls[..., 1]
        np.bitwise_and(words, controls, out=words)
        np.bitwise_xor(blocks, words, out=blocks)
        return base32_sums(blocks, axis=1)


@lru_cache(maxsize=64)
def _first_rows(levels: int, n: int, radix: int) -> IntArray:
    """Where the correction words of a level and a key begin: shape (levels, n, 1)."""
    rows = np.arange(0, radix * levels * n, radix).reshape(levels, n, 1)
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=8)
def _tweaks(w: int, levels: int, paths: int) -> Block:
    """What tells the payloads apart, spread over (w, levels, paths, 2): to broadcast costs twice as much."""
    tweaks = np.zeros((w, levels, paths, 2), dtype=np.uint64)
    tweaks[..., 0] = kinds(w)[:, None, None]
    tweaks.flags.writeable = False
    return tweaks
