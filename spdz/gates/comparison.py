"""Comparison with zero: one opening of a masked value and one evaluation of a dealt DCF key.

For a shared z with |z| <= bound < 2^(b-1) the dealer picks rho uniform on [0, p - 2^b). Steps:

1. Open ``c = z + 2^(b-1) + rho``. An in-range z never wraps, and c is within 2^b / p of uniform for
   *every* z in F_p, also for one that a malicious peer pushed out of range.
2. With ``u = z + 2^(b-1)``, the sign of z is u's top bit: ``s = c_top xor rho_top xor borrow`` where
   ``borrow = [c_low < rho_low]`` on b - 1 bits. The DCF key has threshold rho_low and payload
   ``sigma = 1 - 2 rho_top`` (and alpha sigma), so its output is [[borrow sigma]], already under MAC.
3. ``[[s]] = 1/2 - sc [[sigma / 2]] + sc [[borrow sigma]]`` with ``sc = 1 - 2 c_top``: s = [z >= 0].

Cost: one round, one element; a DCF key of b - 1 levels. Source: Boyle, Gilboa, Ishai, "Secure
computation with preprocessing via function secret sharing", TCC 2019; Boyle et al., EUROCRYPT 2021.
Secure against malicious parties: a wrong opening or evaluation is an additive error that the MAC catches.
For z out of range (which only a cheating peer's input can cause) the bit is some function of z.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np
import numpy.typing as npt

from spdz import dcf, field
from spdz.bound import NOTHING, Bound
from spdz.engine import ClearText, Evaluation, Gate, Recipe
from spdz.field import P
from spdz.types import Block, FieldArray
from spdz.value import Value

HALF = (P + 1) // 2
"""The inverse of 2 in F_p."""

KIND = "comparison"


def domain_bits(bound: int) -> int:
    """The smallest b with ``bound < 2^(b-1)``; statistical distance 2^(b-127) from a uniform opening."""
    bits = bound.bit_length() + 1
    if bits > 86:
        raise ValueError(
            f"a comparison over {bits} bits would leave less than 2^-40 statistical security; "
            "lower max_norm so that the compared value stays below 2^85 raw units"
        )
    return bits


def _top_bit(words: FieldArray, bits: int) -> npt.NDArray[np.bool_]:
    """Bit ``bits - 1`` of each element, as booleans."""
    word, offset = divmod(bits - 1, 64)
    return np.asarray(words[..., word] >> np.uint64(offset) & np.uint64(1), dtype=np.bool_)


def _low_bits(words: FieldArray, bits: int) -> Block:
    """The lowest ``bits`` bits of each element."""
    masks = [(1 << min(64, max(0, bits - 64 * word))) - 1 for word in (0, 1)]
    return words & np.array(masks, dtype=np.uint64)


def _signed(negative: npt.NDArray[np.bool_], a: FieldArray) -> FieldArray:
    """``-a`` where ``negative``, else ``a``."""
    return np.where(negative[..., None], field.neg(a), a)


@dataclass(frozen=True, slots=True)
class NonNegative(Gate):
    """Operand: one value; ``bound`` is what b is chosen by."""

    bound: int

    async def deal(self, recipe: Recipe, z: Value) -> Value:
        """Deal [[rho]], [[sigma / 2]] and the DCF key."""
        bits, shape = domain_bits(self.bound), z.shape
        rho = recipe.uniform_below(P - (1 << bits), shape)

        def sigma(scale: int) -> FieldArray:
            return _signed(_top_bit(rho, bits), np.broadcast_to(field.from_int(scale), rho.shape))

        recipe.authenticated(shape, lambda: rho, of=(z,), count=(KIND, prod(shape)))
        recipe.authenticated(shape, lambda: sigma(HALF))
        recipe.comparison_key(shape, bits - 1, lambda: (_low_bits(rho, bits - 1), sigma(1)))
        await recipe.opening(prod(shape))
        return recipe.shared_value(
            f"{KIND} of {bits} bits", (z,), shape, 0, Bound.of_entry(1, shape), is_bit=True
        )

    async def evaluate(self, party: Evaluation, z: Value) -> Value:
        """Steps 1 to 3."""
        bits, shape = domain_bits(self.bound), z.shape
        rho = party.authenticated(shape, count=(KIND, prod(shape)))
        half = party.authenticated(shape)
        roots, key = party.comparison_key(shape, bits - 1)
        z = party.shared(z)
        mask = Value(party, rho if party.malicious else rho[:1], shape, z.frac, NOTHING)
        (c,) = await party.open((z + mask).plus_raw(1 << (bits - 1)))
        payload = dcf.evaluate(
            party.index,
            roots,
            key,
            _low_bits(c, bits - 1).reshape(-1, 2),
            bits - 1,
            len(z.parts),
        )
        negative = _top_bit(c, bits)
        parts = []
        for j in range(len(z.parts)):
            half_j = half[j]
            if half_j is not None:
                borrow = np.ascontiguousarray(payload[:, j]).reshape((*shape, 2))
                parts.append(_signed(negative, field.sub(borrow, half_j)))
        bit = Value(party, tuple(parts), shape, 0, Bound.of_entry(1, shape), is_bit=True)
        return party.plus(bit, HALF)

    async def clear(self, engine: ClearText, z: Value) -> Value:
        """[z >= 0]."""
        return engine.value(
            (np.asarray(z.parts[0]) >= 0).astype(np.int64), 0, Bound.of_entry(1, z.shape), is_bit=True
        )


async def nonnegative(z: Value, bound: int | None = None) -> Value:
    """The bit [z >= 0] of every entry; one round.

    Args:
        z: Shared or masked value.
        bound: A public bound on |z| in raw units, where the caller knows one that is tighter than
            ``z.bound.entry`` or independent of public constants added to z.

    Returns:
        Shared bits of z's shape.
    """
    result: Value = await z.engine.read(NonNegative(z.bound.entry if bound is None else bound), z)
    return result
