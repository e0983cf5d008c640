"""A party's DCF keys for the entries of an array, in one batch or in several.

The keys of a gallery belong to records, one for each pair of slots, which lie tile by tile; every tile is a
batch with a hash index of its own. In a record the words of a binary tree lie key by key instead of level by
level: ``(k, bits, 2)`` words of seed CWs, then ``(k, bits + 1, w, 2)`` of payload CWs, for its k keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spdz.dcf.evaluation import Key, opened
from spdz.dcf.format import HEADER, WORD
from spdz.foundations.types import Block, Buffer, IntArray

BINARY = 1
"""Bits of a digit of the trees in records."""


@dataclass(frozen=True, slots=True)
class Keys:
    """Keys of one party, ready to be evaluated: what depends on them alone is done when they are made.

    Attributes:
        party: 0 or 1.
        bits: Width of the domain.
        payloads: Payloads a key.
        roots: Root seeds, shape (n, 2), in the keys' order.
        batches: Slices that cover the keys, each with its correction words.
        digit_bits: Of the trees; None for what n keys have.
        order: The entry that each key belongs to; None where they follow each other.

    Raises:
        ValueError: as :func:`spdz.dcf.evaluation.opened`.
    """

    party: int
    bits: int
    payloads: int
    roots: Block = field(repr=False)
    batches: Sequence[tuple[slice, Buffer]] = field(repr=False)
    digit_bits: int | None = None
    order: npt.NDArray[np.intp] | None = field(default=None, repr=False)
    _opened: list[Key] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ready = [
            opened(self.party, self.roots[keys], words, self.bits, self.payloads, self.digit_bits)
            for keys, words in self.batches
        ]
        object.__setattr__(self, "_opened", ready)

    @property
    def sum_bits(self) -> int:
        """Words of sums, and their differences from those of elements, are below 2^sum_bits in size."""
        return 32 + max(key.levels for key in self._opened).bit_length()

    def sums(self, points: Block) -> IntArray:
        """This party's shares of beta [x < a] at k points an entry, as numbers that are not reduced.

        Args:
            points: The public x, ``uint64`` of shape (n, k, 2), or (n, k, 1) if one word holds ``bits`` bits.
                Higher bits are not looked at.

        Returns:
            Signed numbers in base 2^32 (:mod:`spdz.arithmetic.unreduced`), below 2^39 in size: shape
            (payloads, n, k, 4).

        Raises:
            ValueError: for points of another shape.
        """
        if points.ndim != 3 or len(points) != len(self.roots) or 64 * points.shape[2] < self.bits:
            raise ValueError(f"{len(self.roots)} keys of {self.bits} bits cannot take {points.shape}")
        order = self.order
        points = points if order is None else points[order]
        parts = [key.sums(points[keys]) for (keys, _), key in zip(self.batches, self._opened, strict=True)]
        words = (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)).view(np.int64)
        if self.party:
            np.negative(words, out=words)
        if order is None:
            return words
        result = np.empty_like(words)
        result[:, order] = words
        return result


def record_bytes(keys: int, bits: int, payloads: int) -> int:
    """Bytes of so many keys in a record."""
    return 16 * keys * (bits + payloads * (bits + 1))


def hash_index(public: bytes) -> int:
    """The hash index of a batch of records, from its public hash key."""
    return int.from_bytes(public[:4], "little")


def from_records(rows: npt.NDArray[np.uint8], index: int, keys: int, bits: int, payloads: int) -> Buffer:
    """The correction words of m records as :func:`spdz.dcf.evaluate` takes them.

    Args:
        rows: Shape (m, record_bytes(keys, bits, payloads)).
        index: The batch's hash index.
        keys: Keys a record.
        bits: Width of the domain.
        payloads: Payloads a key.
    """
    words = np.ascontiguousarray(rows).view(WORD)
    n, split = len(words) * keys, 2 * keys * bits
    seeds = words[:, :split].reshape(n, bits, 2).transpose(1, 0, 2)
    payload = words[:, split:].reshape(n, bits + 1, payloads, 2).transpose(1, 2, 0, 3)
    header = np.zeros(HEADER // 8, dtype=WORD)
    header[0] = index
    return np.concatenate([header, seeds.reshape(-1), payload.reshape(-1)]).view(np.uint8).data


def to_records(key: Buffer, records: int, keys: int, bits: int, payloads: int) -> npt.NDArray[np.uint8]:
    """The inverse of :func:`from_records`."""
    words = np.frombuffer(key, dtype=WORD)[HEADER // 8 :]
    n, split = records * keys, 2 * records * keys * bits
    seeds = words[:split].reshape(bits, n, 2).transpose(1, 0, 2).reshape(records, -1)
    payload = words[split:].reshape(bits + 1, payloads, n, 2).transpose(2, 0, 1, 3).reshape(records, -1)
    return np.concatenate([seeds, payload], axis=1).view(np.uint8)
