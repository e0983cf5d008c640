"""Truncation: drop fractional bits, by a dealt shift of the mask.

For masked ``<z> = (c, r)`` with ``c = u + rho``, ``u = z + 2^(b-1)`` (:mod:`spdz.gates.masking`):

- **Probabilistic**: ``y = (c >> f) - (rho >> f) - 2^(b-1-f)`` is floor(z / 2^f) or one more, and z / 2^f in
  the mean. The result is masked again, by ``-(rho >> f) - 2^(b-1-f)``, so it can be multiplied at once.
- **Exact**: the carry that makes the difference is ``[c mod 2^f < rho mod 2^f]``, one DCF key of f bits. With
  half a unit added first the result is z / 2^f rounded to the nearest, ties up: the same in every run.

Cost: nothing beyond masking z (one round) if it is not masked yet; one dealt element an entry, or one and a
key. The ideal functionality of the probabilistic form is rounding with a public random dither: c is public,
so z's lowest bits shift the result by what the parties cannot predict. Sources: Catrina, Saxena, "Secure
computation with fixed-point numbers", FC 2010; Escudero et al., "Improved primitives for MPC over mixed
arithmetic-binary circuits", CRYPTO 2020 (section on truncation). Secure against malicious parties: local
and under MAC.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.bits import low_bits, shifted
from spdz.arithmetic.bound import Bound, root
from spdz.arithmetic.public import fraction_bits
from spdz.dcf import Keys
from spdz.foundations.types import FieldArray, IntArray
from spdz.gates.masking import FULL, dealt_integer_mask, in_place, integer_mask, mask, signed_bits
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.refusals import expect_secret
from spdz.values.value import Value

KIND, EXACT = "truncation", "exact truncation"


def _in_place(z: Value, drop: int) -> tuple[Value, int]:
    """The integer to cut has more bits than those that go: its mask must hold them."""
    return in_place(z, max(z.bound.entry, (1 << drop) - 1))


def _mask_form(z: Value, drop: int) -> dict[str, Any]:
    """What is left of the mask: fewer bits; in place of a small integer, one that was raised above it."""
    span = z.span and 1 << max(z.span.bit_length(), signed_bits(z.bound.entry), drop + 1) + 2 - drop
    return {"span": span, "mask_bits": FULL if span else z.mask_bits - drop}


def _bound(z: Value, drop: int) -> Bound:
    """Of a result that is off by less than one."""
    entry, last = (z.bound.entry >> drop) + 1, z.shape[-1] if z.shape else 1
    return Bound(entry, min(entry * root(last), (z.bound.norm >> drop) + 1 + root(last)))


@dataclass(frozen=True, slots=True)
class Truncate(Gate):
    """Operand: one masked value; ``drop`` fractional bits go."""

    drop: int

    def deal(self, recipe: Recipe, z: Value) -> Value:
        """Deal the shifted mask."""
        form, drop = _mask_form(z, self.drop), self.drop
        z, bits = _in_place(z, drop)

        def make() -> FieldArray:
            return integer_mask(shifted(dealt_integer_mask(z.parts[0], bits), drop), bits - drop)

        return recipe.masked_value(
            f"{KIND} by {drop} of {bits} bits",
            (z,),
            z.shape,
            z.frac - drop,
            _bound(z, drop),
            make,
            **form,
            count=(KIND, prod(z.shape)),
        )

    def evaluate(self, party: Evaluation, z: Value) -> Value:
        """Shift what is public."""
        form, width = _mask_form(z, self.drop), len(z.parts) - 1
        z, _ = _in_place(z, self.drop)
        share = party.authenticated(z.shape, count=(KIND, prod(z.shape)))[:width]
        parts, frac = (party.ring.shifted(z.parts[0], self.drop), *share), z.frac - self.drop
        return Value(party, parts, z.shape, frac, _bound(z, self.drop), masked=True, **form)

    def clear(self, engine: ClearText, z: Value) -> Value:
        """Round to the nearest, ties up."""
        return engine.value(_rounded(z, self.drop), z.frac - self.drop, _bound(z, self.drop), masked=True)


@dataclass(frozen=True, slots=True)
class TruncateExactly(Gate):
    """Operand: one masked value; the result is shared."""

    drop: int

    def _raised(self, z: Value) -> tuple[Value, int]:
        """Half a unit more, and its bits."""
        return _in_place(z.plus_raw(1 << (self.drop - 1)), self.drop)

    def deal(self, recipe: Recipe, z: Value) -> Value:
        """Deal [[rho >> f]] and a key for the carry."""
        (half, bits), drop = self._raised(z), self.drop
        shape = z.shape

        def rho() -> FieldArray:
            return dealt_integer_mask(half.parts[0], bits)

        recipe.authenticated(shape, lambda: shifted(rho(), drop), of=(half,), count=(EXACT, prod(shape)))
        recipe.comparison_key(shape, drop, 1, lambda: (low_bits(rho(), drop), _ones(shape)))
        return recipe.shared_value(
            f"{EXACT} by {drop} of {bits} bits", (half,), shape, z.frac - drop, _bound(z, drop)
        )

    def evaluate(self, party: Evaluation, z: Value) -> Value:
        """``(c >> f) - (rho >> f) - [c mod 2^f < rho mod 2^f] - 2^(b-1-f)``."""
        (half, bits), drop = self._raised(z), self.drop
        shape, width = z.shape, len(z.parts) - 1
        shift = party.authenticated(shape, count=(EXACT, prod(shape)))
        keys = party.comparison_key(shape, drop, 1)
        ring, c = party.ring, half.parts[0]
        borrow = ring.unreduced(_borrow, (width, *shape), keys, c)
        parts = tuple(ring.neg(ring.add(shift[j], ring.index(borrow, (j,)))) for j in range(width))
        result = Value(party, parts, shape, z.frac - drop, _bound(z, drop))
        public = ring.sub(ring.shifted(c, drop), ring.constant(1 << (bits - 1 - drop)))
        return party.plus_public(result, public)

    def clear(self, engine: ClearText, z: Value) -> Value:
        """Round to the nearest, ties up."""
        return engine.value(_rounded(z, self.drop), z.frac - self.drop, _bound(z, self.drop))


def _borrow(keys: Keys, c: FieldArray) -> IntArray:
    """Shares of ``[c mod 2^f < rho mod 2^f]`` and of its MAC, as words (width, n, 1, 4)."""
    return keys.sums(c.reshape(-1, 1, 2))


def _ones(shape: tuple[int, ...]) -> FieldArray:
    return np.broadcast_to(field.from_int(1), (*shape, 1, 2))


def _rounded(z: Value, drop: int) -> object:
    return (np.asarray(z.parts[0]).astype(object) + (1 << (drop - 1))) >> drop


async def truncate(*values: Value, frac: int) -> list[Value]:
    """Drop fractional bits; at most one round for all, and none where the values are masked.

    Each result is the exact number rounded up or down, at random, by less than 2^-frac and right in the
    mean. It is masked: it can be multiplied at once.

    Args:
        values: Values of any shape with at least ``frac`` fractional bits.
        frac: Fractional bits that remain, 0 or more.

    Returns:
        The truncated values, in order.

    Raises:
        ValueError: if a value has fewer fractional bits, or frac is negative or no integer.
    """
    expect_secret("truncate", *values)
    frac = fraction_bits(frac)
    masked = await mask(*values)
    return [z if z.frac == frac else z.engine.read(Truncate(_drop(z, frac)), z) for z in masked]


async def round_exactly(*values: Value, frac: int) -> list[Value]:
    """Round to ``frac`` fractional bits, to the nearest with ties up: the same result in every run.

    As :func:`truncate`, for one DCF key of as many bits as are dropped; the results are shared.
    """
    expect_secret("round_exactly", *values)
    frac = fraction_bits(frac)
    masked = await mask(*values)
    return [z if z.frac == frac else z.engine.read(TruncateExactly(_drop(z, frac)), z) for z in masked]


def _drop(z: Value, frac: int) -> int:
    """Bits that go; the meter sees what is wrong before a job is used."""
    if z.frac < frac:
        raise ValueError(f"a value with {z.frac} fractional bits cannot be cut to {frac}")
    return z.frac - frac
