"""Normalising secret vectors, four rounds. A zero vector stays zero."""

from __future__ import annotations

from fractions import Fraction

from spdz.functions.power import Power, power
from spdz.functions.roots import RESULT_BITS
from spdz.gates.comparison import absolute
from spdz.gates.monomial import multiply
from spdz.gates.product import dot
from spdz.gates.truncation import truncate
from spdz.value import Value

NORMALISED_BITS = 24
"""Fractional bits of a normalised vector's coordinates."""


async def l2_normalised(x: Value) -> Value:
    """``x / sqrt(x . x)`` along the last axis.

    Args:
        x: Masked value of shape S + (N,).

    Returns:
        A masked value of the same shape with 24 fractional bits; its norm is 1 within 2^-17 and the rounding
        of its coordinates.
    """
    return await _scaled(x, await power(dot(x, x), Fraction(-1, 2)))


async def l1_normalised(x: Value) -> Value:
    """``x / sum |x|`` along the last axis; as :func:`l2_normalised`, within 2^-16."""
    return await _scaled(x, await power((await absolute(x)).sum(), Fraction(-1)))


async def _scaled(x: Value, inverse: Power) -> Value:
    (mantissa,) = await truncate(inverse.mantissa, frac=RESULT_BITS)
    product = multiply(x, inverse.scale[..., None], mantissa[..., None], norm=1.001)
    (result,) = await truncate(product, frac=NORMALISED_BITS)
    return result
