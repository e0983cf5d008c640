"""Reciprocal and division."""

from __future__ import annotations

from fractions import Fraction
from math import inf

from spdz.arithmetic.public import fraction_bits
from spdz.functions.power import power
from spdz.functions.roots import RESULT_BITS
from spdz.gates.masking import mask
from spdz.gates.monomial import multiply
from spdz.gates.truncation import truncate
from spdz.rounds.coroutine import parallel
from spdz.values.refusals import expect_secret
from spdz.values.value import Value


async def reciprocal(u: Value, *, positive: bool = False) -> Value:
    """``1 / u``, elementwise; three rounds, relative error below 2^-16.

    Args:
        u: Value of any shape. For u = 0 the result is 0.
        positive: Whether u is never negative: half the work; a negative u then counts as 0.

    Returns:
        A shared value: the reciprocal as a floating-point number of 22 bits, written out.
    """
    expect_secret("reciprocal", u)
    (result,) = await power(u, alpha=Fraction(-1), signed=not positive)
    (mantissa,) = await truncate(result.mantissa, frac=RESULT_BITS)
    return multiply(mantissa, result.scale)


async def divide(x: Value, y: Value, *, largest: float, frac: int = 24, positive: bool = False) -> Value:
    """``x / y``, elementwise with broadcasting; four rounds, error below 2^-16 of the result plus 2^-frac.

    Args:
        x: Dividend.
        y: Divisor. Where it is 0 the result is 0.
        largest: A public bound on ``|x / y|``, believed: a quotient beyond it is wrong.
        frac: Fractional bits of the result, 0 or more.
        positive: Whether y is never negative: half the work; a negative y then counts as 0.

    Returns:
        A masked value.

    Raises:
        ValueError: if ``largest`` or ``frac`` makes no sense.
    """
    expect_secret("divide", x, y)
    if not 0 < largest < inf:
        raise ValueError("largest must be above 0 and finite: a bound on the quotient's magnitude")
    frac = fraction_bits(frac)
    (inverse,), (x,) = await parallel(power(y, alpha=Fraction(-1), signed=not positive), mask(x))
    quotient = multiply(x, inverse.scale, entry=1.25 * largest)
    bits = frac + 3  # the mantissa is below 2.25: an error of less than one unit of the result
    (mantissa,), (quotient,) = await parallel(
        truncate(inverse.mantissa, frac=RESULT_BITS),
        truncate(quotient.rescaled(max(quotient.frac, bits)), frac=bits),
    )
    known = 1.01 * largest + 2.0**-frac
    (result,) = await truncate(multiply(mantissa, quotient, entry=known), frac=frac)
    return result
