"""Output: the only way out of the engine, behind a MAC check on either side.

Steps (malicious): 1. check everything opened so far; 2. open the result; 3. check the result. Nothing is
returned before step 3 has passed, so a session that has not checked cannot output. Cost: one round, and
one more a check (the first is skipped where nothing but masked inputs has been opened). Semi-honest:
step 2 alone. Many comparisons that go straight to the output are opened as bits (:mod:`spdz.gates.signs`).
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from spdz.foundations.errors import TapeMismatch
from spdz.gates import signs
from spdz.rounds.coroutine import check
from spdz.values.engine import ClearText, Engine, Evaluation, Gate, Recipe
from spdz.values.party_ring import decoded
from spdz.values.value import Value


class Output(Gate):
    """Operand: one value. The result is what the user gets: numbers or booleans."""

    decides = False

    async def deal(self, recipe: Recipe, z: Value) -> None:
        """Nothing is dealt but the keys of signs; the meter sees the rounds, and what is opened."""
        if (compared := signs.straight(z)) is not None:
            signs.deal(recipe, compared)
        else:
            z.decide()
        if recipe.has_unchecked_openings:
            await check()
        if compared is not None:
            await recipe.opening_bits(prod(z.shape))
            recipe.shared_value("opened signs", (compared,), z.shape, z.frac, z.bound)
        else:
            await recipe.opening(prod(z.shape))
            recipe.shared_value("output", (z,), z.shape, z.frac, z.bound)
        if recipe.malicious:
            await check()

    async def evaluate(self, party: Evaluation, z: Value) -> Any:
        """Steps 1 to 3."""
        keyed = None
        if (compared := signs.straight(z)) is not None:
            keyed = signs.evaluate(party, compared)
        else:
            z.decide()
        if not party.fully_drawn:
            raise TapeMismatch("the program did not use all that was dealt for it: it is another program")
        if party.has_unchecked_openings:
            await check()
        if keyed is not None:
            bits = await party.open_bits(*keyed, prod(z.shape))
        else:
            (opened,) = await party.open(party.shared(z))
        if party.malicious:
            await check()
        if keyed is not None:
            return party.ring.opened_bits(bits, z.shape)
        return party.ring.opened(opened, z.frac, is_bit=z.is_bit)

    async def clear(self, engine: ClearText, z: Value) -> Any:
        """Decode the integers."""
        return decoded(np.asarray(z.parts[0], dtype=object), z.frac, is_bit=z.is_bit)


async def output(engine: Engine, z: Value) -> Any:
    """Open z to both parties and return it decoded: float(s), or bool(s) for bits."""
    return await engine.read(Output(), z)
