"""Is a secret number in a public interval of F_p? Opened as a bit, whatever the number is.

A comparison assumes that its operand is as small as an honest one; here that is what is to be shown, so the
whole field is covered. Steps for ``[[S]]``, lo <= hi:

1. mask S by r uniform on F_p: open ``c = S + rho``, rho = -r; check;
2. evaluate one half-tree of 127 levels on rho at two public points (:mod:`spdz.dcf.signs`, interval);
3. open the bit and check it, as for signs (:mod:`spdz.gates.signs`).

Cost: two rounds and two checks, an element and a bit an entry; 2 KB stored. Malicious security: step 1 is
under MAC, and a wrong bit is a guess of Delta. An honest S inside gives True whatever the other party does,
or the check fails: there is no selective failure to learn from.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.field import P
from spdz.dcf import signs
from spdz.foundations.types import Block
from spdz.gates.masking import mask
from spdz.rounds.coroutine import check
from spdz.values.engine import ClearText, Engine, Evaluation, Gate, Recipe
from spdz.values.trees import TreePads, arranged, restored
from spdz.values.value import Value

KIND = "interval"


@dataclass(frozen=True, slots=True)
class Inside(Gate):
    """Operand: a value. The result is an array of booleans."""

    lo: int
    hi: int

    async def deal(self, recipe: Recipe, z: Value) -> None:
        """Deal the mask and the tree."""
        z = await _masked(z)

        def make(pads: TreePads) -> tuple[Block, Block, Block | None]:
            rho = arranged(field.neg(z.parts[0]), pads.order)
            return (*signs.deal_interval(rho, *pads.deltas, pads.first, pads.batches), None)

        recipe.tree(KIND, z, signs.INTERVAL_LEVELS, make, top=False)
        if recipe.malicious:
            await check()
        await recipe.opening_bits(prod(z.shape))
        recipe.shared_value(f"{KIND} from {self.lo} to {self.hi}", (z,), z.shape, 0, z.bound)
        if recipe.malicious:
            await check()

    async def evaluate(self, party: Evaluation, z: Value) -> Any:
        """Steps 1 to 3."""
        z = await _masked(z)
        key = party.tree(KIND, z.shape, signs.INTERVAL_LEVELS, top=False)
        c = arranged(z.parts[0], key.order)
        shares = signs.evaluate_interval(c, self.lo, self.hi, key.delta, key.first, key.words, key.batches)
        if party.malicious:
            await check()
        shares, delta = restored(shares, key.order), restored(key.spread_delta, key.order)
        opened = await party.open_bits(shares, delta, prod(z.shape))
        if party.malicious:
            await check()
        return opened.reshape(z.shape)

    async def clear(self, engine: ClearText, z: Value) -> Any:
        """Compare."""
        raw = np.asarray(z.parts[0]).astype(object)
        return np.asarray((raw >= self.lo) & (raw <= self.hi), dtype=np.bool_)


async def _masked(z: Value) -> Value:
    """Behind a mask that is uniform on the whole field."""
    everything = Bound.of_entry(P // 2, z.shape)
    (masked,) = await mask(z.engine.shared(z).bounded(everything), fresh=True)
    return masked


async def inside(z: Value, lo: int, hi: int) -> Any:
    """Open [lo <= z <= hi], for every entry, of raw integers 0 <= lo <= hi < p."""
    engine: Engine = z.engine
    return await engine.read(Inside(lo, hi), z)
