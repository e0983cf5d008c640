"""The ten scores in exact arithmetic: the judge of every accuracy figure.

Integers, square roots of integers and fractions only, and nothing of the engine. A score is a function of
the *quantised* descriptors, the raw integers round(x * 2^16), so that the distance to it is the error of the
computation and not that of the rounding of the inputs.

Rational scores (S1, S2, S6, S10) are exact. The others need a square root, taken with 200 fractional bits:
they are within 2^-190 of the true value for every input that the engine accepts.

Normalising the zero vector gives the zero vector.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from math import isqrt

import numpy as np
import numpy.typing as npt

ONE = 1 << 16
"""What the raw integers count: a raw integer is the number times 2^16. Its inverse is one unit of error."""

_ROOT_BITS = 200


def raw(x: npt.ArrayLike) -> list[int]:
    """Quantise one vector as the engine defines it: round(x * 2^16), ties to even.

    A float times a power of two and its rounding to an integer are exact in Python.
    """
    return [round(value * ONE) for value in np.asarray(x, dtype=np.float64).tolist()]


def exact_score(name: str, x: Sequence[int], y: Sequence[int]) -> Fraction:
    """A score of two quantised vectors.

    Args:
        name: ``"S1"`` to ``"S10"``.
        x: Raw integers of the first vector.
        y: Raw integers of the second, of the same length.

    Raises:
        ValueError: if there is no such score or the lengths differ.
    """
    if name not in _SCORES:
        raise ValueError(f"no score is called {name}; there are {', '.join(_SCORES)}")
    if len(x) != len(y) or not x:
        raise ValueError(f"expected two vectors of one length, got {len(x)} and {len(y)} numbers")
    return _SCORES[name](x, y)


def units(value: float | Fraction, exact: Fraction) -> float:
    """How far a value is from the exact one, in units of 2^-16."""
    return float(abs(Fraction(value) - exact) * ONE)


def _dot(x: Sequence[int], y: Sequence[int]) -> int:
    return sum(a * b for a, b in zip(x, y, strict=True))


def _root(value: Fraction | int) -> Fraction:
    """The square root, rounded down to a multiple of 2^-200."""
    value = Fraction(value)
    return Fraction(isqrt((value.numerator << 2 * _ROOT_BITS) // value.denominator), 1 << _ROOT_BITS)


def _l1_dist_bar(x: Sequence[int], y: Sequence[int]) -> Fraction:
    norms = [sum(abs(value) for value in vector) for vector in (x, y)]
    a, b = (norm or 1 for norm in norms)
    return Fraction(sum(abs(p * b - q * a) for p, q in zip(x, y, strict=True)), a * b)


def _l1_dist(x: Sequence[int], y: Sequence[int]) -> Fraction:
    return Fraction(sum(abs(a - b) for a, b in zip(x, y, strict=True)), ONE)


def _l2sq_dist(x: Sequence[int], y: Sequence[int]) -> Fraction:
    return Fraction(sum((a - b) ** 2 for a, b in zip(x, y, strict=True)), ONE**2)


def _dotprod(x: Sequence[int], y: Sequence[int]) -> Fraction:
    return Fraction(_dot(x, y), ONE**2)


def _cossim(x: Sequence[int], y: Sequence[int]) -> Fraction:
    product = _dot(x, x) * _dot(y, y)
    return _dot(x, y) / _root(product) if product else Fraction(0)


def _l2sq_dist_hat(x: Sequence[int], y: Sequence[int]) -> Fraction:
    """2 - 2 cos, without the cancellation: 2 (1 - cos^2) / (1 + cos) where cos > 0."""
    square_x, square_y, cross = _dot(x, x), _dot(y, y), _dot(x, y)
    product = square_x * square_y
    if not product:
        return Fraction(int(square_x != square_y))
    root = _root(product)
    if cross <= 0:
        return 2 - 2 * cross / root
    return 2 * (product - cross**2) / (root * (root + cross))


_SCORES: dict[str, Callable[[Sequence[int], Sequence[int]], Fraction]] = {
    "S1": _l1_dist_bar,
    "S2": _l1_dist,
    "S3": lambda x, y: _root(_l2sq_dist_hat(x, y)),
    "S4": lambda x, y: _root(_l2sq_dist(x, y)),
    "S5": _l2sq_dist_hat,
    "S6": _l2sq_dist,
    "S7": _cossim,
    "S8": _cossim,
    "S9": _cossim,
    "S10": _dotprod,
}
