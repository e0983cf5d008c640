"""Odometry from descriptors alone: what two descriptors in a row tell of the way between them.

A descriptor that was whitened with public statistics is a linear image of the polar grid, up to its length.
The attacker inverts the whitening, takes the length from his own scans, draws the grid in metres, and looks
for the shift under which two grids in a row agree best (they are turned to the walls alike). No map, no match
and no training is needed. Cost: some 400 correlations of 80 x 80 cells a step.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.attacks.world import CELL, CELLS
from bench.demo.scan_context import DIMENSION, RADIUS, RINGS, SECTORS, Background
from spdz.foundations.types import FloatArray

SHIFTS = 11
"""Cells that a robot may have moved along either axis: 5.5 m."""
_SHORT, _LONG = 3.8, 4.3
"""Metres between keyframes: they are taken at the first scan beyond 4 m of travel. A bend makes it less."""
_BEND, _OVER = 1.0, 0.3
"""Standard deviations below and above that, in metres."""
_LEAST, _MOST = 2.5, 5.5
"""No step is shorter or longer, in metres."""
_SHARPNESS = 40.0
"""Nats that one unit of correlation counts for."""
_SLIP = 0.02
"""Chance that two grids agree best by accident: the step is then any step of usual length."""


def rebuilt_grids(descriptors: FloatArray, own_grids: FloatArray, background: Background) -> FloatArray:
    """Polar grids from descriptors, by inverting the public whitening.

    Args:
        descriptors: ``(n, 1200)``, norm 1.
        own_grids: ``(m, RINGS, SECTORS)`` of the attacker's: they tell how long a whitened grid is.
        background: The public statistics.

    Returns:
        ``(n, RINGS, SECTORS)``.
    """
    whitened = (own_grids.reshape(-1, DIMENSION) - background.mean) @ background.whitening
    length = np.median(np.linalg.norm(whitened, axis=1))
    grids = background.mean + length * np.linalg.solve(background.whitening, descriptors.T).T
    return np.asarray(grids.reshape(-1, RINGS, SECTORS))


def usual_step() -> FloatArray:
    """How likely each shift is where nothing is known of the way: ``(2 SHIFTS + 1,) * 2``, sum 1."""
    length = np.hypot(*_shifts())
    short, over = np.minimum(length - _SHORT, 0) / _BEND, np.maximum(length - _LONG, 0) / _OVER
    likely = np.exp(-(short**2 + over**2) / 2) * ((length >= _LEAST) & (length <= _MOST))
    return np.asarray(likely / likely.sum())


def step_likelihoods(grids: FloatArray) -> FloatArray:
    """How likely each shift is between grids in a row.

    Args:
        grids: ``(n, RINGS, SECTORS)``, in the order in which they came.

    Returns:
        ``(n - 1, 2 SHIFTS + 1, 2 SHIFTS + 1)``, each of sum 1; the middle is no shift, in cells of 0.5 m.
    """
    usual, drawn = usual_step(), _drawn(grids)
    steps = np.empty((len(grids) - 1, *usual.shape))
    for step, (before, after) in enumerate(pairwise(drawn)):
        agreement = np.full(usual.shape, -1.0)
        for i, j in np.argwhere(usual > 0):
            agreement[i, j] = _agreement(before, after, i - SHIFTS, j - SHIFTS)
        seen = usual * np.exp(_SHARPNESS * (agreement - agreement.max()))
        steps[step] = (1 - _SLIP) * seen / seen.sum() + _SLIP * usual
    return steps


def _shifts() -> tuple[FloatArray, FloatArray]:
    metres = np.arange(-SHIFTS, SHIFTS + 1) * CELL
    across, along = np.meshgrid(metres, metres, indexing="ij")
    return across, along


def _drawn(grids: FloatArray) -> FloatArray:
    """Polar grids on square cells: ``(n, CELLS, CELLS)``, NaN beyond the radius."""
    centres = (np.arange(CELLS) + 0.5) * CELL - RADIUS
    x, y = np.meshgrid(centres, centres, indexing="ij")
    radius, turn = np.hypot(x, y), np.arctan2(y, x) / (2 * np.pi) % 1.0
    rings = np.minimum((radius / RADIUS * RINGS).astype(np.int64), RINGS - 1)
    sectors = (turn * SECTORS).astype(np.int64) % SECTORS
    return np.where(radius < RADIUS, grids[:, rings, sectors], np.nan)


def _agreement(before: FloatArray, after: FloatArray, i: int, j: int) -> float:
    """Correlation of two drawings where they overlap if the robot moved by (i, j) cells."""
    old = before[max(0, i) : CELLS + min(0, i), max(0, j) : CELLS + min(0, j)]
    new = after[max(0, -i) : CELLS + min(0, -i), max(0, -j) : CELLS + min(0, -j)]
    both = np.isfinite(old) & np.isfinite(new)
    a, b = old[both], new[both]
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))
