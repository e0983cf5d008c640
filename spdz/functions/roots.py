"""Square root and reciprocal square root, three rounds each."""

from __future__ import annotations

from fractions import Fraction

from spdz.functions.power import Power, power
from spdz.gates.monomial import multiply
from spdz.gates.truncation import truncate
from spdz.value import Value

RESULT_BITS = 22
"""Fractional bits that a mantissa keeps."""


async def sqrt(u: Value) -> Value:
    """The square root, elementwise; three rounds, relative error below 2^-17.

    Args:
        u: Value of any shape. For u <= 0 the result is 0.

    Returns:
        A shared value: the root as a floating-point number of 22 bits, written out.
    """
    return await _value(*await power(u, alpha=Fraction(1, 2)))


async def reciprocal_sqrt(u: Value) -> Value:
    """``1 / sqrt(u)``, elementwise; three rounds, relative error below 2^-17. For u <= 0 the result is 0."""
    return await _value(*await power(u, alpha=Fraction(-1, 2)))


async def _value(root: Power) -> Value:
    (mantissa,) = await truncate(root.mantissa, frac=RESULT_BITS)
    return multiply(mantissa, root.scale)
