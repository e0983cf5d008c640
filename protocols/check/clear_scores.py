"""The ten scores in floating point, in the clear, of all pairs at once: to judge one's own descriptors by.

What a private comparison computes is in :mod:`protocols.scores`; these are within its rounding.
"""

from __future__ import annotations

import numpy as np

from spdz.foundations.types import FloatArray


def score_table(name: str, x: FloatArray, y: FloatArray) -> FloatArray:
    """A score of all pairs.

    Args:
        name: ``"S1"`` to ``"S10"``.
        x: ``(m, N)``.
        y: ``(n, N)``.

    Returns:
        ``(m, n)``.

    Raises:
        ValueError: if there is no such score.
    """
    if name == "S10":
        return np.asarray(x @ y.T)
    if name in ("S7", "S8", "S9"):
        return np.asarray(unit(x) @ unit(y).T)
    if name in ("S3", "S5"):
        return _distance(unit(x), unit(y), squared=name == "S5")
    if name in ("S4", "S6"):
        return _distance(x, y, squared=name == "S6")
    if name == "S1":
        return _l1_distance(_l1_unit(x), _l1_unit(y))
    if name == "S2":
        return _l1_distance(x, y)
    raise ValueError(f"unknown score {name!r}; known scores are S1 to S10")


def threshold_cosine(name: str, threshold: float, norm: float) -> float | None:
    """The cosine that a threshold asks of two vectors of one norm; None for L1 distances, which fix none."""
    if name in ("S7", "S8", "S9"):
        return threshold
    if name == "S10":
        return threshold / norm**2
    if name in ("S1", "S2"):
        return None
    length = 1.0 if name in ("S3", "S5") else norm
    square = threshold if name in ("S5", "S6") else threshold * abs(threshold)
    return 1 - square / (2 * length**2)


def unit(rows: FloatArray) -> FloatArray:
    """Rows of L2 norm 1; a row of zeros stays."""
    norms = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(rows / np.where(norms == 0, 1, norms))


def _l1_unit(rows: FloatArray) -> FloatArray:
    sums = np.abs(rows).sum(axis=1, keepdims=True)
    return np.asarray(rows / np.where(sums == 0, 1, sums))


def _distance(x: FloatArray, y: FloatArray, *, squared: bool) -> FloatArray:
    squares = (x * x).sum(axis=1)[:, None] + (y * y).sum(axis=1)[None] - 2 * x @ y.T
    squares = np.maximum(squares, 0)
    return np.asarray(squares if squared else np.sqrt(squares))


def _l1_distance(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.stack([np.abs(y - row).sum(axis=1) for row in x]) if len(x) else np.empty((0, len(y)))
