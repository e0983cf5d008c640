"""Consecutive coordinates of vectors, as vectors of their own.

A place of several descriptors is one vector, and each comparison looks at its own coordinates. The cut of a
standing vector (:mod:`spdz.values.standing`) stands as well: words, masks and MAC shares are views, so that
products of cuts are those of short integers, and nothing is made of field elements unless a gate asks for it.

Cost: none. Secure against malicious parties: a cut is a linear map, done by either side on its own.
"""

from __future__ import annotations

from typing import Any

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.fixed_point import norm_bound
from spdz.values.refusals import expect_secret
from spdz.values.value import Value


def columns(vectors: Value, start: int, stop: int, *, max_norm: float | None = None) -> Value:
    """Coordinates ``start`` to ``stop`` of vectors.

    Args:
        vectors: Value of shape S + (N,).
        start: The first coordinate.
        stop: The one after the last.
        max_norm: The largest L2 norm of an input's cut before it was quantised, where the caller knows one
            that is below the whole's. It is believed.

    Returns:
        Value of shape S + (stop - start,).

    Raises:
        ValueError: unless 0 <= start < stop <= N, or for a norm out of range.
    """
    expect_secret("columns", vectors)
    if not vectors.shape or not 0 <= start < stop <= vectors.shape[-1]:
        raise ValueError(f"there are no coordinates {start} to {stop} in vectors of shape {vectors.shape}")
    norm, which = vectors.bound.norm, slice(start, stop)
    if max_norm is not None:
        norm = min(norm, norm_bound(max_norm, stop - start))
    bound, ring = Bound(min(norm, vectors.bound.entry), norm), vectors.engine.ring

    def parts() -> tuple[Any, ...]:
        return tuple(None if part is None else ring.index(part, (..., which)) for part in vectors.parts)

    standing = None if vectors.standing is None else vectors.standing.cut(which, bound.entry)
    return Value(
        vectors.engine,
        parts() if standing is None else parts,
        (*vectors.shape[:-1], stop - start),
        vectors.frac,
        bound,
        masked=vectors.masked,
        is_bit=vectors.is_bit,
        plain=None if vectors.plain is None else vectors.plain[..., which],
        mask_bits=vectors.mask_bits,
        span=vectors.span,
        standing=standing,
    )
