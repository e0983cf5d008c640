"""Tables for u^alpha on integers u >= 1: segments, their exact scales, and one polynomial for all of them.

The range is cut at ``T_i = ceil(2^(i/4))``, four segments an octave. On segment i

- ``V_i`` is an integer with ``u V_i = 2^L (1 + t)``, |t| <= d, where d is about 2^(1/8) - 1 = 0.09;
- ``(2^L / V_i)^alpha = mu_i 2^(e_i)`` with 1 <= mu_i < 2,

so that ``u^alpha = mu_i (1 + t)^alpha 2^(e_i)``. One polynomial of degree 3 approximates (1 + t)^alpha on
[-d, d] for every segment. Interpolation at the Chebyshev points has a relative error below 2^-16.7 for
alpha = -1, 2^-18.6 for -1/2 and 2^-21 for 1/2 (tests measure it).

All arithmetic is gmpy2's with 200 bits, correctly rounded: every machine computes the same tables, which is
what lets two robots agree on a program.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import gmpy2

_PRECISION = 200
_PER_OCTAVE = 4
DEGREE = 3
EXTRA = 8
"""V has at least so many significant bits: a segment's middle is off by at most 2^-9 of u."""

SHORTEST = 20
"""The smallest L."""


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment.

    Attributes:
        start: Its first integer.
        reciprocal: V.
        mantissa: mu, with MANTISSA_BITS fractional bits.
        exponent: e.
    """

    start: int
    reciprocal: int
    mantissa: int
    exponent: int


MANTISSA_BITS = 19
"""Fractional bits of mu."""


@dataclass(frozen=True, slots=True)
class Table:
    """u^alpha for 1 <= u <= largest.

    Attributes:
        length: L.
        segments: In ascending order; the first starts at 1.
        deviation: d, rounded up.
        coefficients: Of the polynomial in t, exact.
    """

    length: int
    segments: tuple[Segment, ...]
    deviation: Fraction
    coefficients: tuple[Fraction, ...]

    @property
    def exponents(self) -> tuple[int, int]:
        """Smallest and largest e."""
        ends = (self.segments[0].exponent, self.segments[-1].exponent)
        return min(ends), max(ends)


@lru_cache(maxsize=64)
def table(alpha: Fraction, largest: int) -> Table:
    """Make the table.

    Args:
        alpha: 1/2, -1/2, 1, -1: anything whose power of a rational gmpy2 can take.
        largest: The largest u, at least 1.
    """
    with gmpy2.context(precision=_PRECISION):
        length = max(largest.bit_length() + EXTRA, SHORTEST)
        starts = sorted(
            {_start(i) for i in range(_PER_OCTAVE * largest.bit_length()) if _start(i) <= largest}
        )
        ends = [
            *(start - 1 for start in starts[1:]),
            min(largest, _start(_PER_OCTAVE * largest.bit_length())),
        ]
        segments, deviation = [], Fraction(0)
        for start, end in zip(starts, ends, strict=True):
            reciprocal = ((2 << length) + (start + end) // 2) // (start + end)
            for u in (start, end):
                deviation = max(deviation, abs(Fraction(u * reciprocal, 1 << length) - 1))
            value = gmpy2.mpfr(gmpy2.mpq(1 << length, reciprocal)) ** gmpy2.mpfr(gmpy2.mpq(alpha))
            exponent = int(gmpy2.floor(gmpy2.log2(value)))
            mantissa = int(gmpy2.rint(gmpy2.mul_2exp(value, MANTISSA_BITS - exponent)))
            segments.append(Segment(start, reciprocal, mantissa, exponent))
        return Table(length, tuple(segments), deviation, _interpolated(alpha, deviation))


def _start(i: int) -> int:
    """``ceil(2^(i/4))``."""
    root, exact = gmpy2.iroot(gmpy2.mpz(1) << i, _PER_OCTAVE)
    return int(root) + (not exact)


def _interpolated(alpha: Fraction, deviation: Fraction) -> tuple[Fraction, ...]:
    """Coefficients of the polynomial through (1 + t)^alpha at the Chebyshev points of [-d, d].

    With a deviation of 0 (u = 1 alone) the points are those of d = 2^-8.
    """
    d = gmpy2.mpfr(gmpy2.mpq(max(deviation, Fraction(1, 256))))
    count = DEGREE + 1
    points = [d * gmpy2.cos((2 * k + 1) * gmpy2.const_pi() / (2 * count)) for k in range(count)]
    values = [(1 + t) ** gmpy2.mpfr(gmpy2.mpq(alpha)) for t in points]
    # Newton's divided differences, then multiplied out.
    differences = list(values)
    for order in range(1, count):
        for k in range(count - 1, order - 1, -1):
            differences[k] = (differences[k] - differences[k - 1]) / (points[k] - points[k - order])
    coefficients = [gmpy2.mpfr(0)] * count
    for difference, point in zip(reversed(differences), reversed(points), strict=True):
        shifted = [gmpy2.mpfr(0), *coefficients[:-1]]
        coefficients = [a - point * b for a, b in zip(shifted, coefficients, strict=True)]
        coefficients[0] += difference
    return tuple(Fraction(*map(int, c.as_integer_ratio())) for c in coefficients)
