"""Square root and reciprocal square root.

Both are mantissa times scale (:mod:`spdz.functions.power`), three rounds. A square root that may exceed 4 is
refined once, so that large ones are precise in absolute terms too: with ``u^(-1/2) = m s`` up to 2^-17,
``h = u s^2`` and ``q = h m^2`` (close to 1), Newton's step is ``sqrt(u) = h m (3 - q) / (2 s)``.
"""

from __future__ import annotations

from fractions import Fraction

from spdz.functions.power import Power, power
from spdz.gates.masking import mask
from spdz.gates.monomial import multiply
from spdz.gates.truncation import truncate
from spdz.rounds.coroutine import parallel
from spdz.values.refusals import expect_secret
from spdz.values.value import Value

RESULT_BITS = 22
"""Fractional bits that a mantissa keeps."""

_H_BITS, _Q_BITS, _REFINED_BITS = 36, 38, 32
"""Of h, so that h m^2 has 80; of h m and q, so that their product has 76; of the refined mantissa."""


async def sqrt(u: Value) -> Value:
    """The square root, elementwise.

    Args:
        u: Value of any shape. For u <= 0 the result is 0.

    Returns:
        A shared value, a floating-point number written out. Where u's bound is at most 16: of 22 bits, in
        three rounds, relative error below 2^-18. Else of 32 bits, in five rounds, below 2^-30.
    """
    expect_secret("sqrt", u)
    if u.bound.entry > 16 << u.frac:
        return await _refined_sqrt(u)
    return await _value(*await power(u, alpha=Fraction(1, 2)))


async def _refined_sqrt(u: Value) -> Value:
    (u,) = await mask(u)
    (root,) = await power(u, alpha=Fraction(-1, 2), unscale=True)
    unscale = root.reciprocal_scale
    normalised = multiply(u, root.scale, root.scale, entry=1.3)
    (m,), (h,) = await parallel(
        truncate(root.mantissa, frac=RESULT_BITS),
        truncate(normalised.rescaled(max(normalised.frac, _H_BITS)), frac=_H_BITS),
    )
    product, q = await truncate(multiply(h, m, entry=1.2), multiply(h, m, m, entry=1.1), frac=_Q_BITS)
    doubled = multiply(product, 3 - q, entry=2.5)
    doubled.frac += 1  # and so halved
    (mantissa,) = await truncate(doubled, frac=_REFINED_BITS)
    return multiply(mantissa, unscale)


async def reciprocal_sqrt(u: Value) -> Value:
    """``1 / sqrt(u)``, elementwise; three rounds, relative error below 2^-17. For u <= 0 the result is 0."""
    expect_secret("reciprocal_sqrt", u)
    return await _value(*await power(u, alpha=Fraction(-1, 2)))


async def _value(root: Power) -> Value:
    (mantissa,) = await truncate(root.mantissa, frac=RESULT_BITS)
    return multiply(mantissa, root.scale)
