"""The ten scores in NumPy's float64: the insecure baseline in this engine's own language."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spdz.foundations.types import FloatArray


def _bar(x: FloatArray) -> FloatArray:
    bar: FloatArray = x / np.abs(x).sum()
    return bar


def _hat(x: FloatArray) -> FloatArray:
    hat: FloatArray = x / np.sqrt(x @ x)
    return hat


def _l1(x: FloatArray, y: FloatArray) -> float:
    return float(np.abs(x - y).sum())


def _l2sq(x: FloatArray, y: FloatArray) -> float:
    difference = x - y
    return float(difference @ difference)


def _dot(x: FloatArray, y: FloatArray) -> float:
    return float(x @ y)


PLAIN: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "S1": lambda x, y: _l1(_bar(x), _bar(y)),
    "S2": _l1,
    "S3": lambda x, y: _l2sq(_hat(x), _hat(y)) ** 0.5,
    "S4": lambda x, y: _l2sq(x, y) ** 0.5,
    "S5": lambda x, y: _l2sq(_hat(x), _hat(y)),
    "S6": _l2sq,
    "S7": lambda x, y: _dot(_hat(x), _hat(y)),
    "S8": lambda x, y: _dot(x, y) / (_dot(x, x) ** 0.5 * _dot(y, y) ** 0.5),
    "S9": lambda x, y: _dot(x, y) / (_dot(x, x) * _dot(y, y)) ** 0.5,
    "S10": _dot,
}
"""A score of two vectors of float64, of shape (N,)."""
