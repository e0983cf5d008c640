"""Pairs of descriptors to measure with: reproducible, several kinds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from spdz.foundations.types import FloatArray

NEARNESS = 0.01
"""L2 distance of the two vectors of a near pair, about."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of pair.

    Attributes:
        name: Its name on the command line.
        what: What it is, in words.
        draw: ``draw(generator, count, n)``: the two halves of so many pairs, each of shape (count, n).
        largest_norm: ``largest_norm(n)``: an L2 norm that no vector of the kind exceeds (for ``normal``: in
            any run that will ever happen).
    """

    name: str
    what: str
    draw: Callable[[np.random.Generator, int, int], tuple[FloatArray, FloatArray]]
    largest_norm: Callable[[int], float]


def draw(kind: str, count: int, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """So many pairs of a kind; the same seed, kind, and length give the same pairs."""
    generator = np.random.default_rng([seed, n, list(KINDS).index(kind)])
    return KINDS[kind].draw(generator, count, n)


def _unit_rows(rows: FloatArray) -> FloatArray:
    norms: FloatArray = np.linalg.norm(rows, axis=-1, keepdims=True)
    return rows / norms


def _normal(generator: np.random.Generator, count: int, n: int) -> tuple[FloatArray, FloatArray]:
    x, y = generator.standard_normal((2, count, n))
    return x, y


def _unit(generator: np.random.Generator, count: int, n: int) -> tuple[FloatArray, FloatArray]:
    x, y = _normal(generator, count, n)
    return _unit_rows(x), _unit_rows(y)


def _near(generator: np.random.Generator, count: int, n: int) -> tuple[FloatArray, FloatArray]:
    x, noise = _unit(generator, count, n)
    return x, _unit_rows(x + NEARNESS * noise)


def _uniform(generator: np.random.Generator, count: int, n: int) -> tuple[FloatArray, FloatArray]:
    x, y = generator.uniform(-10, 10, (2, count, n))
    return x, y


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("unit", "L2 norm 1, random directions", _unit, lambda n: 1.0),
        Kind("near", f"L2 norm 1, about {NEARNESS} apart", _near, lambda n: 1.0),
        Kind("normal", "standard normal coordinates", _normal, lambda n: 10.0 * sqrt(n)),
        Kind("uniform", "coordinates uniform in [-10, 10]", _uniform, lambda n: 10.0 * sqrt(n)),
    )
}
