"""Comparison with zero, and what follows from it: sign, absolute value, maximum.

All are piecewise linear functions (:mod:`spdz.gates.piecewise`): local on masked values, such as inputs and
their differences; one round on computed values, which are masked first. Exact. For values of b - 1 bits (the
public bound, :mod:`spdz.bound`) an entry costs a DCF key of b - 1 levels, so a tighter ``max_norm`` makes all
of them cheaper.
"""

from __future__ import annotations

from functools import lru_cache

from spdz.bound import Bound
from spdz.gates.masking import mask
from spdz.gates.pieces import Function, Pieces
from spdz.gates.piecewise import piecewise
from spdz.public import limit
from spdz.value import Value, aligned

_AT_LEAST_0 = Pieces([0], Function((0, 1), (0, 0), 0, 1, is_bit=True))
_SIGN = Pieces([0, 1], Function((-1, 1, 1), (0, 0, 0), 0, 1))


@lru_cache(maxsize=64)
def _absolute(frac: int, entry: int) -> Pieces:
    return Pieces([0], Function((0, 0), (-1, 2), frac, entry))


@lru_cache(maxsize=64)
def _positive_part(frac: int, entry: int) -> Pieces:
    return Pieces([0], Function((0, 0), (0, 1), frac, entry))


async def nonnegative(z: Value, bound: int | None = None) -> Value:
    """The bit [z >= 0] of every entry.

    Args:
        z: Value of any shape.
        bound: A public bound on |z| in raw units, where the caller knows one that is tighter than
            ``z.bound.entry`` or independent of public constants added to z. It is believed.

    Returns:
        Shared bits of z's shape.

    Raises:
        ValueError: if the bound is negative or not finite.
    """
    if bound is not None:
        z = z.bounded(Bound.of_entry(limit(bound, 0, "bound"), z.shape))
    (z,) = await mask(z)
    (bit,) = piecewise(z, _AT_LEAST_0)
    return bit


async def sign(z: Value) -> Value:
    """-1, 0 or 1 for every entry: a shared integer of z's shape."""
    (z,) = await mask(z)
    (result,) = piecewise(z, _SIGN)
    return result


async def absolute(z: Value) -> Value:
    """|z| for every entry, exact: shared, of z's shape."""
    (z,) = await mask(z)
    (result,) = piecewise(z, _absolute(z.frac, z.bound.entry))
    return result.bounded(z.bound)


async def maximum(x: Value, y: Value) -> Value:
    """The larger of x and y, elementwise with broadcasting, exact: y + max(x - y, 0)."""
    x, y = aligned(x, y)
    (difference,) = await mask(x - y)
    (excess,) = piecewise(difference, _positive_part(difference.frac, difference.bound.entry))
    return (y.engine.shared(y) + excess).bounded(x.bound.larger(y.bound, y.shape))


async def largest(z: Value) -> Value:
    """The maximum over the last axis, exact: a tournament of ceil(log2 N) rounds of comparisons.

    Raises:
        ValueError: if there is no last axis, or nothing along it.
    """
    if not z.shape or not z.shape[-1]:
        raise ValueError(f"the largest is taken along a last axis of one entry or more, got shape {z.shape}")
    while (n := z.shape[-1]) > 1:
        half = (n + 1) // 2
        z = await maximum(z[..., :half], z[..., n - half :])  # they share the middle one if n is odd
    return z[..., 0]
