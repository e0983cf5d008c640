"""Seeded randomness of both parties for half-trees, and 128-bit numbers as Python integers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from spdz.arithmetic.prf import Batches
from spdz.foundations.types import Block


def words(numbers: Sequence[int]) -> Block:
    """Integers mod 2^128 as blocks (n, 2)."""
    packed = b"".join((number % (1 << 128)).to_bytes(16, "little") for number in numbers)
    return np.frombuffer(packed, dtype=np.uint64).reshape(-1, 2)


def integers(blocks: Block) -> list[int]:
    return [low | high << 64 for low, high in blocks.reshape(-1, 2).tolist()]


def cut(n: int, *sizes: int, seed: int = 0) -> Batches:
    """Batches of these sizes in turn, each with a key of its own."""
    batches, start = [], 0
    while start < n:
        stop = min(n, start + sizes[len(batches) % len(sizes)])
        batches.append((slice(start, stop), bytes([seed, len(batches) % 256] * 8)))
        start = stop
    return batches


@dataclass
class Pads:
    """Delta_0, Delta_1 and the random blocks that go with n keys."""

    n: int
    seed: int = 0
    delta: tuple[Block, Block] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        deltas = rng.integers(0, 1 << 64, (2, self.n, 2), dtype=np.uint64)
        deltas[..., 0] &= ~np.uint64(1)
        deltas[1, :, 0] |= np.uint64(1)
        self.delta = deltas[0], deltas[1]
        self.first1 = rng.integers(0, 1 << 64, (self.n, 2), dtype=np.uint64)
        self.top0 = rng.integers(0, 1 << 64, (self.n, 2), dtype=np.uint64)

    def check(self, shares: Sequence[Block], expected: Sequence[bool]) -> None:
        """The parties' shares differ by the whole of Delta where the bit is 1, and are equal elsewhere."""
        times_delta = np.where(np.array(expected)[:, None], self.delta[0] ^ self.delta[1], np.uint64(0))
        np.testing.assert_array_equal(shares[0] ^ shares[1], times_delta)
