"""The cosine of the angle between masked vectors: ``x . y / (sqrt(x . x) sqrt(y . y))``.

The two roots are taken side by side: the square root of a product is the product of the square roots, and
(x . x) (y . y) would need 154 bits of the field's 127. Each is a mantissa and a scale
(:mod:`spdz.functions.power`). A zero vector gives 0.
"""

from __future__ import annotations

from fractions import Fraction

from spdz import Value, dot, mask, multiply, parallel, power, truncate

_BITS = 22
_POWER = Fraction(-1, 2)


async def cosine(x: Value, y: Value) -> Value:
    """The cosine over the last axis; leading axes broadcast. Three rounds."""
    cross = dot(x, y)
    (of_x, of_y), (product,) = await parallel(power(dot(x, x), dot(y, y), alpha=_POWER), mask(cross))
    scaled = _scaled(product, of_x.scale, of_y.scale)
    m_x, m_y, scaled = await truncate(of_x.mantissa, of_y.mantissa, scaled, frac=_BITS)
    return multiply(scaled, m_x, m_y, entry=1.01)


async def inverse_norm(x: Value) -> tuple[Value, Value]:
    """Mantissa and scale of ``1 / sqrt(x . x)``, both masked. Three rounds."""
    (root,) = await power(dot(x, x), alpha=_POWER)
    (mantissa,) = await truncate(root.mantissa, frac=_BITS)
    return mantissa, root.scale


async def cosine_of(x: tuple[Value, ...], y: tuple[Value, ...]) -> Value:
    """:func:`cosine` of vectors with their :func:`inverse_norm`. Two rounds."""
    (vectors_x, m_x, scale_x), (vectors_y, m_y, scale_y) = x, y
    (product,) = await mask(dot(vectors_x, vectors_y))
    (scaled,) = await truncate(_scaled(product, scale_x, scale_y), frac=_BITS)
    return multiply(scaled, m_x, m_y, entry=1.01)


def _scaled(product: Value, scale_x: Value, scale_y: Value) -> Value:
    """The dot product times both scales, in enough fractional bits to be cut."""
    scaled = multiply(product, scale_x, scale_y, entry=1.25)
    return scaled.rescaled(max(scaled.frac, _BITS))
