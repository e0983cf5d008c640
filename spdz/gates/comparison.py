"""Comparison with zero, and what follows from it: sign, absolute value, maximum.

All are piecewise linear functions (:mod:`spdz.gates.piecewise`): local on masked values, such as inputs and
their differences; one round on computed values, which are masked first. Exact. For values of b - 1 bits (the
public bound, :mod:`spdz.arithmetic.bound`) an entry costs a DCF key of b - 1 levels, so a tighter
``max_norm`` makes all of them cheaper.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy.typing as npt

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.public import limit, magnitude, rounded
from spdz.gates.masking import mask
from spdz.gates.pieces import Function, Pieces
from spdz.gates.piecewise import piecewise
from spdz.values.refusals import expect_secret, not_secret, refuse_slips
from spdz.values.value import Value, aligned

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
    expect_secret("nonnegative", z)
    if bound is not None:
        z = z.bounded(Bound.of_entry(limit(bound, 0, "bound"), z.shape))
    (z,) = await mask(z)
    frac, limit_of_bit = _AT_LEAST_0.functions[0].form(z.shape)

    def decided() -> tuple[Any, ...]:
        (bit,) = piecewise(z, _AT_LEAST_0)
        return bit.parts

    return Value(z.engine, decided, z.shape, frac, limit_of_bit, is_bit=True, sign_of=z)


async def sign(z: Value) -> Value:
    """-1, 0 or 1 for every entry: a shared integer of z's shape."""
    expect_secret("sign", z)
    (z,) = await mask(z)
    (result,) = piecewise(z, _SIGN)
    return result


async def absolute(z: Value) -> Value:
    """|z| for every entry, exact: shared, of z's shape."""
    expect_secret("absolute", z)
    (z,) = await mask(z)
    (result,) = piecewise(z, _absolute(z.frac, z.bound.entry))
    return result.bounded(z.bound)


async def maximum(x: Value | npt.ArrayLike, y: Value | npt.ArrayLike) -> Value:
    """The larger of x and y, elementwise with broadcasting, exact: y + max(x - y, 0).

    Args:
        x: Value of any shape.
        y: Value, or public numbers, which are rounded as where they are added: ``maximum(z, 0)`` is a ReLU,
            and ``-await maximum(-z, -c)`` the smaller of z and c. Either operand may be the public one.

    Returns:
        The shared maximum.

    Raises:
        TypeError: if neither is a secret value.
        ValueError: if public numbers are not real and finite, or the shapes do not broadcast.
    """
    if isinstance(x, Value) and isinstance(y, Value):
        x, y = aligned(x, y)
        excess = await _positive(x - y)
        return (y.engine.shared(y) + excess).bounded(x.bound.larger(y.bound, y.shape))
    if isinstance(x, Value):
        return await _raised(x, y)
    if isinstance(y, Value):
        return await _raised(y, x)
    raise not_secret("maximum", x)


async def _raised(x: Value, least: npt.ArrayLike) -> Value:
    """The maximum of a value and public numbers: the same formula, with the public bound of both."""
    refuse_slips("maximum", least)
    excess = await _positive(x - least)
    frac, shape = excess.frac, excess.shape
    raw = rounded(least, frac)
    bound = x.rescaled(frac).broadcast(shape).bound.larger(Bound.of_entry(magnitude(raw), shape), shape)
    return excess.plus_raw(raw).bounded(bound)


async def _positive(difference: Value) -> Value:
    """max(z, 0)."""
    (z,) = await mask(difference)
    (result,) = piecewise(z, _positive_part(z.frac, z.bound.entry))
    return result


async def largest(z: Value) -> Value:
    """The maximum over the last axis, exact: a tournament of ceil(log2 N) rounds of comparisons.

    Raises:
        ValueError: if there is no last axis, or nothing along it.
    """
    expect_secret("largest", z)
    if not z.shape or not z.shape[-1]:
        raise ValueError(f"the largest is taken along a last axis of one entry or more, got shape {z.shape}")
    while (n := z.shape[-1]) > 1:
        half = (n + 1) // 2
        z = await maximum(z[..., :half], z[..., n - half :])  # they share the middle one if n is odd
    return z[..., 0]
