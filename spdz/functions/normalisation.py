"""Normalising secret vectors, four rounds. A zero vector stays zero."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import prod

from spdz.functions.power import Power, power
from spdz.functions.roots import RESULT_BITS
from spdz.gates.comparison import absolute
from spdz.gates.monomial import multiply
from spdz.gates.product import dot
from spdz.gates.truncation import truncate
from spdz.values.refusals import expect_secret
from spdz.values.value import Value, concatenate, split

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
    expect_secret("l2_normalised", *vectors)
    rows = _rows(vectors)
    return await _scaled(vectors, rows, *await power(dot(rows, rows), alpha=Fraction(-1, 2)))


async def l1_normalised(*vectors: Value) -> list[Value]:
    """``x / sum |x|`` along the last axis; as :func:`l2_normalised`, within 2^-16."""
    expect_secret("l1_normalised", *vectors)
    rows = _rows(vectors)
    return await _scaled(vectors, rows, *await power((await absolute(rows)).sum(), alpha=Fraction(-1)))


def _rows(vectors: Sequence[Value]) -> Value:
    """All vectors below each other: one batch costs little more than one vector."""
    lengths = {x.shape[-1] if x.shape else 0 for x in vectors}
    if len(lengths) != 1 or 0 in lengths:
        raise ValueError("vectors that are normalised together must have equal length, at least 1")
    return concatenate(*(x.reshape(prod(x.shape[:-1]), x.shape[-1]) for x in vectors))


async def _scaled(vectors: Sequence[Value], rows: Value, inverse: Power) -> list[Value]:
    (mantissa,) = await truncate(inverse.mantissa, frac=RESULT_BITS)
    product = multiply(rows, inverse.scale[:, None], mantissa[:, None], norm=1.001)
    fine = product.rescaled(max(product.frac, NORMALISED_BITS))
    (result,) = await truncate(fine, frac=NORMALISED_BITS)
    return split(result, [x.shape for x in vectors])
