"""The cosine of the angle between masked vectors."""

from __future__ import annotations

from fractions import Fraction

from spdz import Value, dot, mask, multiply, parallel, power, truncate

_BITS = 22


async def cosine(x: Value, y: Value) -> Value:
    """``x . y / (sqrt(x . x) sqrt(y . y))`` over the last axis; leading axes broadcast. Three rounds.

    The two roots are taken side by side: the square root of a product is the product of the square roots, and
    (x . x) (y . y) would need 154 bits of the field's 127. A zero vector gives 0.
    """
    cross = dot(x, y)
    (of_x, of_y), (product,) = await parallel(power(dot(x, x), dot(y, y), alpha=Fraction(-1, 2)), mask(cross))
    scaled = multiply(product, of_x.scale, of_y.scale, entry=1.25)
    scaled = scaled.rescaled(max(scaled.frac, _BITS))
    m_x, m_y, scaled = await truncate(of_x.mantissa, of_y.mantissa, scaled, frac=_BITS)
    return multiply(scaled, m_x, m_y, entry=1.01)
