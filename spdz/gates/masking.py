"""Masking: turn shared values ``[[z]]`` into masked ones ``<z>``, which products and comparisons need.

The dealer picks rho; the parties open ``c = z + 2^(b-1) + rho``. So ``<z> = (c, r)`` with
``r = -rho - 2^(b-1)``, and every later product, power, truncation or comparison of z is local.

For a value of b <= 86 bits rho is uniform on [0, p - 2^b): as integers c never wraps, which truncation and
comparison rely on, and c is within 2^(b-127) of uniform for *every* z in F_p, also for one that a malicious
peer has pushed out of range. A longer value can only be multiplied; its rho is uniform on F_p.

Cost: one round for any number of values, one element an entry. Secure against malicious parties: what is
opened is recorded for the MAC check.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

from spdz import field
from spdz.bound import NOTHING, Bound
from spdz.engine import ClearText, Evaluation, Gate, Recipe
from spdz.field import P
from spdz.types import FieldArray
from spdz.value import Value

FULL = 127
"""Bits of a fresh mask."""

SECURITY_BITS = 40
"""The statistical distance and the chance of a wrapped opening stay below 2^-40."""


def signed_bits(bound: int) -> int:
    """The smallest b with ``bound < 2^(b-1)``: a signed number of at most this magnitude has b bits."""
    return bound.bit_length() + 1


def integer_mask(r: FieldArray, bits: int) -> FieldArray:
    """The rho of a mask r: for ``<z> = (c, r)``, ``c = z + 2^(bits-1) + rho`` as integers.

    True for every masked value, except with probability 2^(bits - mask_bits) over the mask
    (never, where the mask was made for that many bits).
    """
    return field.neg(field.add(r, field.from_int(1 << (bits - 1))))


def local_bits(z: Value, bound: int | None = None) -> int:
    """Bits of a masked value's range, if a gate may work on the integers behind its mask.

    Raises:
        ValueError: if the value is not masked, or too long for its mask.
    """
    if not z.masked:
        raise TypeError("this gate works on a masked value: `await spdz.mask(z)` first")
    bits = signed_bits(z.bound.entry if bound is None else bound)
    if bits + SECURITY_BITS >= z.mask_bits:
        raise ValueError(
            f"a comparison or truncation over {bits} bits would leave less than 2^-{SECURITY_BITS} "
            f"statistical security under a mask of {z.mask_bits} bits: lower max_norm, truncate first, or "
            "mask the value anew"
        )
    return bits


@dataclass(frozen=True, slots=True)
class Mask(Gate):
    """Operands: shared values."""

    async def deal(self, recipe: Recipe, *values: Value) -> list[Value]:
        """Deal one [[r]] a value."""

        def make(z: Value) -> FieldArray:
            bits = signed_bits(z.bound.entry)
            if bits + SECURITY_BITS >= FULL:
                return recipe.uniform_below(P, z.shape)
            return integer_mask(recipe.uniform_below(P - (1 << bits), z.shape), bits)

        masked = [
            recipe.masked_value(
                "mask",
                (z,),
                z.shape,
                z.frac,
                z.bound,
                lambda z=z: make(z),  # type: ignore[misc]
                count=("mask", prod(z.shape)),
            )
            for z in values
        ]
        await recipe.opening(sum(prod(z.shape) for z in values))
        return masked

    async def evaluate(self, party: Evaluation, *values: Value) -> list[Value]:
        """Open z - r."""
        masks = [party.authenticated(z.shape, count=("mask", prod(z.shape))) for z in values]
        width = 2 if party.malicious else 1
        opened = await party.open(
            *(
                z - Value(party, mask[:width], z.shape, z.frac, NOTHING)
                for z, mask in zip(values, masks, strict=True)
            )
        )
        return [
            Value(party, (eps, *mask[:width]), z.shape, z.frac, z.bound, masked=True)
            for z, mask, eps in zip(values, masks, opened, strict=True)
        ]

    async def clear(self, engine: ClearText, *values: Value) -> list[Value]:
        """The values themselves."""
        return list(values)


async def mask(*values: Value) -> list[Value]:
    """Mask computed values, so that they can be multiplied, truncated and compared; one round for all.

    Values that are masked already are returned as they are, without a round if all of them are.

    Args:
        values: Values of any shape.

    Returns:
        The same numbers as masked values, in order.
    """
    shared = [z for z in values if not z.masked]
    if not shared:
        return list(values)
    fresh = iter(await shared[0].engine.read(Mask(), *shared))
    return [z if z.masked else next(fresh) for z in values]


def tightened(bound: Bound, entry: int | None, norm: int | None) -> Bound:
    """A bound that the caller knows to be smaller than the tracked one."""
    if entry is None and norm is None:
        return bound
    limit = entry if norm is None else norm if entry is None else min(entry, norm)
    assert limit is not None
    return Bound(min(bound.entry, limit), bound.norm if norm is None else min(bound.norm, norm))
