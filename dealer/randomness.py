"""The dealer's own randomness, all of it from the operating system's generator."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from math import prod

import numpy as np

from spdz.arithmetic.field import P
from spdz.arithmetic.prf import expand
from spdz.foundations.types import FieldArray, Shape

_KEY_BYTES = 32


@dataclass(frozen=True, slots=True)
class MacKey:
    """The MAC key alpha as the two parties' shares; only the dealer ever knows both."""

    shares: tuple[int, int] = field(repr=False)

    @property
    def alpha(self) -> int:
        """The key itself."""
        return (self.shares[0] + self.shares[1]) % P


def random_mac_key() -> MacKey:
    """A fresh uniform key; every tape has its own."""
    return MacKey((secrets.randbelow(P), secrets.randbelow(P)))


def uniform_below(limit: int, shape: Shape) -> FieldArray:
    """Uniform elements of [0, limit) by rejection, exact; ``limit`` is at least p / 2.

    Raises:
        ValueError: if the limit is so low that rejection would be wasteful, or above p.
    """
    if not P // 2 <= limit <= P:
        raise ValueError("the limit must lie between p / 2 and p")
    size = prod(shape)
    words = np.empty((0, 2), dtype=np.uint64)
    low, high = np.uint64(limit & (1 << 64) - 1), np.uint64(limit >> 64)
    while len(words) < size:
        fresh = expand(secrets.token_bytes(_KEY_BYTES), 16 * (size - len(words)))
        fresh[:, 1] &= np.uint64((1 << 63) - 1)
        below = (fresh[:, 1] < high) | ((fresh[:, 1] == high) & (fresh[:, 0] < low))
        words = np.concatenate([words, fresh[below]])
    return words.reshape((*shape, 2))
