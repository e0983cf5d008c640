"""Masking: turn shared values ``[[z]]`` into masked ones ``<z>``, which products and comparisons need.

The dealer picks rho; the parties open ``c = z + 2^(b-1) + rho``. So ``<z> = (c, r)`` with
``r = -rho - 2^(b-1)``, and every later product, power, truncation or comparison of z is local.

rho is uniform on F_p, so c tells nothing of z, whatever z is. Truncation and comparison of a value of b <= 86
bits rely on c not wrapping as an integer; where it has wrapped it is below 2^b. So a c below 2^b is given up
(:class:`~spdz.foundations.errors.Wrapped`), with probability 2^(b-127) an entry whatever z is, and every
other one is right. A longer value can only be multiplied.

Cost: one round for any number of values, one element an entry. Secure against malicious parties: what is
opened is recorded for the MAC check.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.bits import is_below
from spdz.arithmetic.bound import NOTHING, Bound
from spdz.arithmetic.field import P
from spdz.foundations.types import FieldArray
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.refusals import expect_secret
from spdz.values.value import Value

FULL = 127
"""Bits of a fresh mask."""

SECURITY_BITS = 40
"""The chance of a wrapped opening stays below 2^-40."""


def signed_bits(bound: int) -> int:
    """The smallest b >= 2 with ``bound < 2^(b-1)``: a signed number of at most this magnitude has b bits.

    (A number that is always 0 counts as one that may be 1: below its sign there is a bit to compare.)
    """
    return max(bound.bit_length(), 1) + 1


def integer_mask(r: FieldArray, bits: int) -> FieldArray:
    """The rho of a mask r: for ``<z> = (c, r)``, ``c = z + 2^(bits-1) + rho`` as integers, unless c wraps."""
    return field.neg(field.add(r, field.from_int(1 << (bits - 1))))


def dealt_integer_mask(r: FieldArray, bits: int) -> FieldArray:
    """:func:`integer_mask` at the dealer, who sees where c could wrap.

    A uniform mask lets c wrap with probability 2^(bits-127) an entry, which the parties notice. Where masks
    cancel (a value from which itself, or its own truncation, was subtracted; a factor of 0) c can wrap
    always. To refuse what chance may bring would tell something of the other masks, so the sign of it is that
    nothing is left of a mask, or that c could wrap at more than one entry, or at the only one.

    Raises:
        ValueError: if masks cancel.
    """
    rho = integer_mask(r, bits)
    # p - rho is the complement of 127 bits.
    room = rho ^ np.array([(1 << 64) - 1, (1 << 63) - 1], dtype=np.uint64)
    wraps = is_below(room, bits)
    if np.count_nonzero(wraps) > (wraps.size > 1) or not r.any(axis=-1).all():
        raise ValueError(
            "a comparison or truncation is asked for where masks cancel (something was subtracted from "
            "itself or multiplied by 0): mask the value anew, `await spdz.mask(z, fresh=True)`"
        )
    return rho


def in_place(z: Value, bound: int | None = None) -> tuple[Value, int]:
    """A masked value whose gate may work on the integers behind its mask.

    Where the mask is a small integer, |r| <= span, a public K above span and 2^(b-1) moves from r to eps:
    then ``rho = K - r - 2^(b-1)`` and ``c = K + eps`` are positive integers below 2^126 for every z in range,
    and c never wraps.

    Args:
        z: The masked value.
        bound: The largest magnitude to count with, where it is not z's own.

    Returns:
        The value to use, and b, the bits of its range: ``c = z + 2^(b-1) + rho`` as integers.

    Raises:
        TypeError: if the value is not masked.
        ValueError: if its range is too long for its mask.
        Wrapped: if it may have wrapped.
    """
    if not z.masked:
        raise TypeError("this gate works on a masked value: `[z] = await spdz.mask(z)` first")
    bits = signed_bits(z.bound.entry if bound is None else bound)
    if z.span:
        room = max(z.span.bit_length(), bits) + 1
        if room < FULL - 1:
            parts = z.engine.remasked(z, 1 << room)
            return Value(z.engine, parts, z.shape, z.frac, z.bound, masked=True), bits
    if bits + SECURITY_BITS >= z.mask_bits or z.span:
        raise ValueError(
            f"a comparison or truncation over {bits} bits would wrap more often than once in "
            f"2^{SECURITY_BITS} times under a mask of {z.mask_bits} bits: lower max_norm, truncate first, or "
            "mask the value anew"
        )
    if isinstance(z.engine, Evaluation):
        z.engine.ring.refuse_wrapped(z.parts[0], bits, z.mask_bits)
    return z, bits


@dataclass(frozen=True, slots=True)
class Mask(Gate):
    """Operands: shared values."""

    async def deal(self, recipe: Recipe, *values: Value) -> list[Value]:
        """Deal one [[r]] for every entry."""
        masked = [self._deal(recipe, z) for z in values]
        await recipe.opening(sum(prod(z.shape) for z in values))
        return masked

    def _deal(self, recipe: Recipe, z: Value) -> Value:
        count = ("mask", prod(z.shape))
        return recipe.masked_value(
            "mask", (z,), z.shape, z.frac, z.bound, lambda: recipe.uniform_below(P, z.shape), count=count
        )

    async def evaluate(self, party: Evaluation, *values: Value) -> list[Value]:
        """Open z - r."""
        width = 2 if party.malicious else 1
        masks = [party.authenticated(z.shape, count=("mask", prod(z.shape)))[:width] for z in values]
        hidden = [
            tuple(party.ring.sub(part, r) for part, r in zip(z.parts, mask, strict=True))
            for z, mask in zip(values, masks, strict=True)
        ]
        opened = await party.open(
            *(Value(party, parts, z.shape, 0, NOTHING) for z, parts in zip(values, hidden, strict=True))
        )
        return [
            Value(party, (eps, *mask), z.shape, z.frac, z.bound, masked=True)
            for z, eps, mask in zip(values, opened, masks, strict=True)
        ]

    async def clear(self, engine: ClearText, *values: Value) -> list[Value]:
        """The values themselves."""
        return [engine.value(z.parts[0], z.frac, z.bound, masked=True) for z in values]


async def mask(*values: Value, fresh: bool = False) -> list[Value]:
    """Mask computed values, so that they can be multiplied, truncated and compared; one round for all.

    A value that is masked already is returned as it is, unless its mask is too short for its range (a
    truncated value that was then scaled up): it is masked anew. There is no round if all are returned.

    Args:
        values: Values of any shape.
        fresh: Whether masked values are masked anew as well.

    Returns:
        The same numbers as masked values, in order.
    """
    expect_secret("mask", *values)
    waiting = [z.engine.shared(z) for z in values if fresh or not _ready(z)]
    if not waiting:
        return list(values)
    masked = iter(await waiting[0].engine.read(Mask(), *waiting))
    return [z if _ready(z) and not fresh else next(masked) for z in values]


def _ready(z: Value) -> bool:
    return z.masked and (
        z.span > 0 or z.mask_bits == FULL or signed_bits(z.bound.entry) + SECURITY_BITS < z.mask_bits
    )


def tightened(bound: Bound, entry: int | None, norm: int | None) -> Bound:
    """A bound that the caller knows to be smaller than the tracked one."""
    norm = bound.norm if norm is None else min(bound.norm, norm)
    return Bound(min(bound.entry, norm if entry is None else min(entry, norm)), norm)
