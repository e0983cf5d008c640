"""u^alpha of a secret u as mantissa times scale, in three rounds: what roots and reciprocals are made of.

With the tables of :mod:`spdz.functions.segments`:

1. Mask u. One DCF key at all thresholds gives, locally, ``M = u V - 2^L`` (t in units of 2^-L), mu and the
   scale ``2^e`` of u's segment: each is piecewise linear in u.
2. Mask these three. M cut to 18 fractional bits is t, a masked value; ``mu p(t)`` is then local.
3. Mask that and cut it to the mantissa's bits (:func:`spdz.truncate`), which the caller does together with
   what else waits for a round.

u^alpha = mantissa * scale, the scale an exact power of two: a product with several of them stays short, and
loses nothing. For u <= 0 both are 0: the reciprocal and the square root of zero *are* zero here, so that a
zero vector is normalised to the zero vector.

Cost: a DCF key of about log2(bound of u) + 2 levels, evaluated at four points an octave; 2 rounds and 4
elements an entry, and a round and an element for step 3. Error: below 2^-16.4 of the result for alpha = -1,
2^-17.4 for -1/2, 2^-18 for 1/2. Everything that is opened is below 2^86, so it is given up (`Wrapped`) once
in 2^41 times at most. Source: normalisation as in Catrina, Saxena, FC 2010, by function secret sharing.
Secure against malicious parties: composed of gates that are.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import ceil

import gmpy2
import numpy as np

from spdz.arithmetic.bound import Bound
from spdz.functions.segments import DEGREE, MANTISSA_BITS, Segment, Table, table
from spdz.gates.masking import mask
from spdz.gates.pieces import Function, Pieces
from spdz.gates.piecewise import piecewise
from spdz.gates.polynomial import polynomial
from spdz.gates.truncation import truncate
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.refusals import expect_secret
from spdz.values.value import Value, concatenate, split

POWERS = (Fraction(1, 2), Fraction(-1, 2), Fraction(-1))

T_BITS = 18
"""Fractional bits of t: an error of one unit moves the result by at most 2^-18 of itself."""

FINE_BITS = 62
"""Fractional bits of p(t): a coefficient of t^3 is rounded by 2^-63, and (d 2^18)^3 < 2^44."""

_LARGEST_MANTISSA = 9 << (MANTISSA_BITS + FINE_BITS - 2)
"""2.25, in raw units of mu p(t)."""


@dataclass(frozen=True, slots=True)
class Power:
    """``u^alpha = mantissa * scale``.

    Attributes:
        mantissa: Shared; between 0.9 and 2.2, or 0. Cut it with :func:`spdz.truncate` before multiplying.
        scale: Masked; a power of two (its negative where u is negative), or 0.
        unscale: Masked; 1 / scale, or 0. Only where it was asked for.
    """

    mantissa: Value
    scale: Value
    unscale: Value | None = None

    @property
    def reciprocal_scale(self) -> Value:
        """``unscale``; ValueError where it was not asked for."""
        if self.unscale is None:
            raise ValueError("the reciprocal scale was not asked for: power(..., unscale=True)")
        return self.unscale


@dataclass(frozen=True, slots=True)
class _Power(Gate):
    """Operand: u, masked or shared. Both secure readings run the same text; the clear one is exact."""

    alpha: Fraction
    signed: bool
    unscale: bool

    async def deal(self, recipe: Recipe, u: Value) -> Power:
        """Steps 1 and 2."""
        return await self._compose(u)

    async def evaluate(self, party: Evaluation, u: Value) -> Power:
        """Steps 1 and 2."""
        return await self._compose(u)

    async def _compose(self, u: Value) -> Power:
        pieces, coefficients = _tables(self, u.bound.entry, u.frac)
        (u,) = await mask(u)
        deviation, mantissa, *scales = await mask(*piecewise(u, pieces))
        (t,) = await truncate(deviation, frac=T_BITS)
        return Power(polynomial(mantissa, t, coefficients, FINE_BITS, _LARGEST_MANTISSA), *scales)

    async def clear(self, engine: ClearText, u: Value) -> Power:
        """The scale of the segment, and the mantissa that makes the product right."""
        pieces, _ = _tables(self, u.bound.entry, u.frac)
        _, _, scale, *unscale = await mask(*piecewise(u, pieces))
        bits = MANTISSA_BITS + FINE_BITS
        raw = [int(one) for one in np.asarray(u.parts[0]).flat]
        scales = [int(one) for one in np.asarray(scale.parts[0]).flat]
        exact = [
            _mantissa(self.alpha, one, u.frac, power, scale.frac + bits) if power else 0
            for one, power in zip(raw, scales, strict=True)
        ]
        result = np.array(exact, dtype=object).reshape(u.shape)
        return Power(engine.value(result, bits, Bound.of_entry(_LARGEST_MANTISSA, u.shape)), scale, *unscale)


def _mantissa(alpha: Fraction, u: int, frac: int, scale: int, scale_frac: int) -> int:
    """``|u 2^-frac|^alpha / |scale 2^-scale_frac|``, rounded."""
    with gmpy2.context(precision=200):
        value = gmpy2.mpfr(gmpy2.mpq(abs(u), 1 << frac)) ** gmpy2.mpfr(gmpy2.mpq(alpha))
        return int(gmpy2.rint(value / gmpy2.mpfr(gmpy2.mpq(abs(scale)) / gmpy2.mpq(2) ** scale_frac)))


@lru_cache(maxsize=64)
def _tables(what: _Power, largest: int, frac: int) -> tuple[Pieces, tuple[int, ...]]:
    """The functions of step 1 on a raw integer u with so many fractional bits, and p of step 2."""
    known = table(what.alpha, max(largest, 1))
    low, high = known.exponents
    # scale = 2^(e - alpha frac), and unscale = 2^(alpha frac - e), with as many fractional bits as they need.
    shift = int(what.alpha * frac)
    bits, unbits = max(shift - low, 0), max(high - shift, 0)
    starts, constants, slopes, mantissas, exponents, signs = zip(*_pieces(known, what.signed), strict=True)
    scales = tuple(sign << (e - shift + bits) for e, sign in zip(exponents, signs, strict=True))
    unscales = tuple(sign << (shift - e + unbits) for e, sign in zip(exponents, signs, strict=True))
    flat = (0,) * len(starts)
    length = known.length
    largest_deviation = ceil(known.deviation * (1 << length))
    pieces = Pieces(
        starts[1:],
        Function(_jumps(constants), _jumps(slopes), length, largest_deviation),
        Function(_jumps(mantissas), flat, MANTISSA_BITS, 2 << MANTISSA_BITS),
        Function(_jumps(scales), flat, bits, 1 << (high - shift + bits)),
        *([Function(_jumps(unscales), flat, unbits, 1 << (shift - low + unbits))] if what.unscale else []),
    )
    coefficients = tuple(
        round(known.coefficients[k] * (1 << FINE_BITS) / (1 << (T_BITS * k))) for k in range(DEGREE + 1)
    )
    return pieces, coefficients


def _jumps(column: tuple[int, ...]) -> tuple[int, ...]:
    """The first entry, and the differences."""
    return column[0], *(b - a for a, b in pairwise(column))


def _pieces(known: Table, signed: bool) -> list[tuple[int, int, int, int, int, int]]:
    """(start, constant and slope of M, mu, e, sign) of every piece; the first reaches down without end."""

    def piece(start: int, segment: Segment, sign: int) -> tuple[int, int, int, int, int, int]:
        slope = sign * segment.reciprocal
        return start, -1 << known.length, slope, segment.mantissa, segment.exponent, sign

    upward = [piece(segment.start, segment, 1) for segment in known.segments]
    downward = []
    if signed:
        ends = [segment.start - 1 for segment in known.segments[1:]] + [known.segments[-1].start]
        downward = [piece(-end, segment, -1) for end, segment in zip(ends, known.segments, strict=True)][::-1]
    return [*downward, (0, 0, 0, 0, known.segments[0].exponent, 0), *upward]


async def power(
    *values: Value, alpha: Fraction | float, signed: bool = False, unscale: bool = False
) -> list[Power]:
    """u^alpha, elementwise, as mantissa times scale; two rounds for all values.

    Args:
        values: Values u of any shapes. A tighter bound makes keys and tables smaller.
        alpha: 1/2, -1/2 or -1, as a number of any type.
        signed: Whether negative u count (for alpha = -1); else the result is 0 for them.
        unscale: Whether the reciprocals of the scales are wanted as well.

    Returns:
        Mantissa and scale of each; both 0 where u is 0.
    """
    expect_secret("power", *values)
    if (exact := next((known for known in POWERS if known == alpha), None)) is None:
        raise ValueError(f"a power must be 1/2, -1/2 or -1, not {alpha}")
    flat = concatenate(*(u.reshape(-1) for u in values)) if len(values) > 1 else values[0]
    if (exact * flat.frac).denominator != 1:
        flat = flat.rescaled(flat.frac + 1)
    powers: Power = await flat.engine.read(_Power(exact, signed, unscale), flat)
    if len(values) == 1:
        return [powers]
    known = [part for part in (powers.mantissa, powers.scale, powers.unscale) if part is not None]
    pieces = zip(*(split(part, [u.shape for u in values]) for part in known), strict=True)
    return [Power(*piece) for piece in pieces]
