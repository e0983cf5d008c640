"""Normalising secret vectors, four rounds. A zero vector stays zero."""

from __future__ import annotations

from collections.abc import Sequence
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


async def l2_normalised(*vectors: Value) -> list[Value]:
    """``x / sqrt(x . x)`` along the last axis, for any number of values at once.

    Args:
        vectors: Masked values of shape S + (N,).

    Returns:
        Masked values of the same shapes with 24 fractional bits; each norm is 1 within 2^-17 and the
        rounding of the coordinates.
    """
    return await _scaled(vectors, await power(*(dot(x, x) for x in vectors), alpha=Fraction(-1, 2)))


async def l1_normalised(*vectors: Value) -> list[Value]:
    """``x / sum |x|`` along the last axis; as :func:`l2_normalised`, within 2^-16."""
    norms = [(await absolute(x)).sum() for x in vectors]
    return await _scaled(vectors, await power(*norms, alpha=Fraction(-1)))


async def _scaled(vectors: Sequence[Value], inverses: Sequence[Power]) -> list[Value]:
    mantissas = await truncate(*(inverse.mantissa for inverse in inverses), frac=RESULT_BITS)
    products = [
        multiply(x, inverse.scale[..., None], mantissa[..., None], norm=1.001)
        for x, inverse, mantissa in zip(vectors, inverses, mantissas, strict=True)
    ]
    return await truncate(*products, frac=NORMALISED_BITS)
