"""What one side holds of a batch of half-tree keys (:mod:`spdz.dcf.half_tree`), one key an entry of an array.

The keys may lie in another order than the entries: those of a gallery lie tile by tile, since every tile has
a Delta and a public hash key of its own. ``order`` says which entry a key belongs to; None is the entries'
order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.prf import Batches
from spdz.foundations.types import Block

Order = npt.NDArray[np.intp] | None
"""For every key in turn, the flat index of its entry."""


@dataclass(frozen=True, slots=True)
class TreePads:
    """What the dealer derives from both parties' pads.

    Attributes:
        deltas: Delta_0 and Delta_1, each broadcasting to (n, 2).
        first: Party 1's left nodes, shape (n, 2).
        top: Party 0's blocks T_0, shape (n, 2); None where the key has none.
        batches: The n keys' public hash keys.
        order: Of the keys.
    """

    deltas: tuple[Block, Block] = field(repr=False)
    first: Block = field(repr=False)
    top: Block | None = field(repr=False)
    batches: Batches
    order: Order


@dataclass(frozen=True, slots=True)
class TreeKey:
    """What a party holds.

    Attributes:
        delta: Delta_i, broadcasting to (n, 2).
        first: Its left nodes, shape (n, 2).
        words: The correction words, shape (n, levels - 1, 2).
        top: Its blocks T_i, shape (n, 2), or None.
        batches: The n keys' public hash keys.
        order: Of the keys.
    """

    delta: Block = field(repr=False)
    first: Block = field(repr=False)
    words: Block = field(repr=False)
    top: Block | None = field(repr=False)
    batches: Batches
    order: Order

    @property
    def spread_delta(self) -> Block:
        """Delta_i of every key, shape (n, 2)."""
        spread: Block = np.broadcast_to(self.delta, self.first.shape)
        return spread


def arranged(blocks: Block, order: Order) -> Block:
    """Entries of shape S + (2,) as (n, 2), in the order of the keys."""
    flat = blocks.reshape(-1, 2)
    return flat if order is None else flat[order]


def restored(blocks: Block, order: Order) -> Block:
    """What belongs to the keys, shape (n, ...), in the order of the entries."""
    if order is None:
        return blocks
    result = np.empty_like(blocks)
    result[order] = blocks
    return result


def of_party(blocks: Block, party: int) -> Block:
    """Pad blocks as Delta_i: the lowest bit is the party's number."""
    delta: Block = blocks & np.array([(1 << 64) - 2, (1 << 64) - 1], dtype=np.uint64)
    delta[..., 0] |= np.uint64(party)
    return delta
