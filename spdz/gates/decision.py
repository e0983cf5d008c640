"""Comparisons as shared bits that a program goes on with: counted, weighed, compared again.

The half-tree (:mod:`spdz.gates.signs`) gives a bit under Delta, which only opens. Here the dealer draws a
random bit s for every comparison, and the tree's XOR-shared block is that of ``top(rho) xor s``. Steps:

1. evaluate the tree at the public c: ``S_0 xor S_1 = (bit xor s) Delta``; check c;
2. open ``v = bit xor s``, a uniform bit, as signs are opened; check it;
3. ``[[bit]] = v + (1 - 2 v) [[s]]``: local, s being dealt in F_p as well.

No comparison is opened. What is opened is checked before anything that depends on it is sent, so that
whatever the other party does, every message of an honest one is the one that it sends in every run: a
gallery's strip that was broken off is run again (specification, section 25).

Cost: one round and two checks for any number of comparisons, a bit an entry; stored: what a sign stores, and
an element more at either party. A comparison that is used as it is costs no round, but a DCF key in F_p
(:mod:`spdz.gates.piecewise`), 48 bytes a level for 16, and all levels where a sign leaves out the lowest.

Sources: as for signs; bits in two domains as in Rotaru, Wood, "MArBled circuits: mixing arithmetic and
boolean circuits with active security", INDOCRYPT 2019. Secure against malicious parties: a wrong bit is a
guess of Delta, and v is uniform and independent of the bit, whatever c is.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.field import P
from spdz.foundations.types import FieldArray
from spdz.gates import signs
from spdz.rounds.coroutine import check
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe, Share
from spdz.values.refusals import expect_secret
from spdz.values.value import Value

KIND = "decided sign"
_LOWEST = np.array([1, 0], dtype=np.uint64)


@dataclass(frozen=True, slots=True)
class Decision(Gate):
    """Operands: the masked values whose signs are asked for."""

    async def deal(self, recipe: Recipe, *values: Value) -> list[Value]:
        """Deal s in F_p and the tree, for every entry."""
        for z in values:
            flips = recipe.uniform_below(P - 1, z.shape) & _LOWEST  # P - 1 is even
            recipe.authenticated(z.shape, lambda flips=flips: flips, of=(z,))  # type: ignore[misc]
            signs.deal(recipe, z, KIND, flips)
        if recipe.has_unchecked_openings:
            await check()
        await recipe.opening_bits(sum(prod(z.shape) for z in values))
        if recipe.malicious:
            await check()
        return [recipe.shared_value(KIND, (z,), z.shape, 0, _bit(z), is_bit=True) for z in values]

    async def evaluate(self, party: Evaluation, *values: Value) -> list[Value]:
        """Steps 1 to 3."""
        masks, keyed = [], []
        for z in values:
            masks.append(party.authenticated(z.shape))
            keyed.append(signs.evaluate(party, z, KIND))
        if party.has_unchecked_openings:
            await check()
        shares, deltas = (np.concatenate(blocks) for blocks in zip(*keyed, strict=True))
        opened = await party.open_bits(shares, deltas, len(shares))
        if party.malicious:
            await check()
        results, start = [], 0
        for z, mask in zip(values, masks, strict=True):
            stop = start + prod(z.shape)
            results.append(_unmasked(party, z, opened[start:stop].reshape(z.shape), mask))
            start = stop
        return results

    async def clear(self, engine: ClearText, *values: Value) -> list[Value]:
        """Compare."""
        signs_of = [np.asarray(z.parts[0]).astype(object) >= 0 for z in values]
        return [
            engine.value(np.asarray(bits).astype(np.int64), 0, _bit(z), is_bit=True)
            for z, bits in zip(values, signs_of, strict=True)
        ]


def _bit(z: Value) -> Bound:
    return Bound.of_entry(1, z.shape)


def _unmasked(party: Evaluation, z: Value, v: npt.NDArray[np.bool_], mask: Share) -> Value:
    """Step 3."""
    parts: tuple[FieldArray, ...] = tuple(
        np.where(v[..., None], field.neg(share), share) for share in mask if share is not None
    )
    public = np.zeros((*z.shape, 2), dtype=np.uint64)
    public[..., 0] = v
    bits = party.plus_public(Value(party, parts, z.shape, 0, _bit(z)), public)
    bits.is_bit = True
    return bits


async def decided(*comparisons: Value) -> list[Value]:
    """Comparisons as shared bits, for a program that goes on with them; one round for all.

    Where comparisons have a resolution (in a gallery) these have it too.

    Args:
        comparisons: Results of :func:`spdz.nonnegative`, such as those of a score with a threshold. Bits that
            are decided already are returned as they are.

    Returns:
        Shared bits of the same shapes, in order.

    Raises:
        TypeError: if one is no bit.
    """
    expect_secret("decided", *comparisons)
    if not all(one.is_bit for one in comparisons):
        raise TypeError("only comparisons are decided, such as `await spdz.nonnegative(z)`")
    compared = [signs.straight(one) for one in comparisons]
    waiting = [z for z in compared if z is not None]
    if not waiting:
        return list(comparisons)
    made: Any = iter(await waiting[0].engine.read(Decision(), *waiting))
    return [one if z is None else next(made) for one, z in zip(comparisons, compared, strict=True)]
