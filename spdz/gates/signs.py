"""Signs that go straight to the output: opened as bits, with a MAC of their own in 16 bytes a level.

A comparison whose bit is only opened needs no share of the bit in F_p. For masked ``<z> = (c, r)`` the dealer
deals half-tree keys (:mod:`spdz.dcf.signs`); then

1. both parties evaluate theirs at the public c: ``S_0 xor S_1 = bit Delta``, where party i holds Delta_i;
2. they send the lowest bit of S_i, packed, and so open the bit;
3. ``sigma_i = S_i xor bit Delta_i``, all 128 bits, must be the same string on both sides: an entry of the
   next MAC check. Who sends a wrong bit must guess Delta.

With a *resolution* (:attr:`spdz.values.engine.Engine.resolution`) the lowest f bits of z are left out, which
saves as many levels: the bit is ``[z >= e]`` for a public e, uniform in (-2^(f-1), 2^(f-1)].

Where a program goes on with the bit, the same tree opens it masked (:mod:`spdz.gates.decision`).

Cost: one round, one bit an entry; b - 1 - f levels of 16 bytes stored, one AES call a level. c must have been
checked before step 2 (:mod:`spdz.gates.output` sees to it): a wrong c makes the bit a function of the mask.
"""

from __future__ import annotations

import numpy as np

from spdz.dcf import signs
from spdz.foundations.types import Block, FieldArray
from spdz.gates.masking import dealt_integer_mask, in_place
from spdz.values.engine import Engine, Evaluation, Recipe
from spdz.values.trees import TreeKey, TreePads, arranged, restored
from spdz.values.value import Value

KIND = "opened sign"


def straight(z: Value) -> Value | None:
    """The masked value of which z is the sign, if nothing but the output uses that."""
    return z.sign_of if z.undecided else None


def deal(recipe: Recipe, z: Value, kind: str = KIND, flips: FieldArray | None = None) -> None:
    """Deal what opens the signs of a masked value.

    Args:
        recipe: The reading.
        z: The masked value.
        kind: Of the correlation.
        flips: Where the bit is opened masked: 0 or 1 for every entry, which it is XORed with.
    """
    z, bits, drop = _in_place(recipe, z)

    def make(pads: TreePads) -> tuple[Block, Block, Block | None]:
        rho = arranged(dealt_integer_mask(z.parts[0], bits), pads.order)
        if flips is not None:
            rho = _flipped(rho, bits, arranged(flips, pads.order))
        if pads.top is None:
            raise ValueError("a sign has a block beside its tree")
        return signs.deal_sign(rho, bits, drop, *pads.deltas, pads.first, pads.top, pads.batches)

    recipe.tree(kind, z, signs.sign_levels(bits, drop), make, top=True)


def evaluate(party: Evaluation, z: Value, kind: str = KIND) -> tuple[Block, Block]:
    """Step 1: S_i and Delta_i of every entry, shape (n, 2)."""
    z, bits, drop = _in_place(party, z)
    key = party.tree(kind, z.shape, signs.sign_levels(bits, drop), top=True)
    ring = party.ring
    return ring.call(_shares, None, key, z.parts[0], bits, drop), ring.call(_deltas, None, key)


def _deltas(key: TreeKey) -> Block:
    return restored(key.spread_delta, key.order)


def _shares(key: TreeKey, c: FieldArray, bits: int, drop: int) -> Block:
    if key.top is None:
        raise ValueError("a sign has a block beside its tree")
    points = arranged(c, key.order)
    shares = signs.evaluate_sign(points, bits, drop, key.delta, key.first, key.words, key.top, key.batches)
    return restored(shares, key.order)


def _in_place(engine: Engine, z: Value) -> tuple[Value, int, int]:
    """The value to work on, its bits, and how many of the lowest are left out."""
    drop = 0 if engine.resolution is None else max(0, z.frac - engine.resolution)
    if drop:
        z = z.plus_raw(-1 << (drop - 1))
    z, bits = in_place(z)
    return z, bits, min(drop, bits - 2)


def _flipped(rho: FieldArray, bits: int, flips: FieldArray) -> Block:
    """Rho with the top of its lowest ``bits`` bits turned over where ``flips`` is 1, and with it the sign."""
    word, offset = divmod(bits - 1, 64)
    result: Block = rho.copy()
    result[:, word] ^= flips[:, 0] << np.uint64(offset)
    return result
