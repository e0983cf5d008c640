"""Rooms and corridors as points, as a laser sees them."""

import numpy as np

from protocols.geometry.poses import apply, inverse
from spdz.foundations.types import FloatArray

STEP, NOISE = 0.04, 0.01
"""Metres between points of a wall, and their standard deviation across it."""


def walls(*corners: tuple[float, float, float, float], seed: int = 1) -> FloatArray:
    """Points along walls from (x, y) to (u, v)."""
    generator = np.random.default_rng(seed)
    points = []
    for x, y, u, v in corners:
        along = np.arange(0, np.hypot(u - x, v - y), STEP)[:, None] / np.hypot(u - x, v - y)
        points.append(np.array([x, y]) + along * np.array([u - x, v - y]))
    found = np.concatenate(points)
    return np.asarray(found + generator.normal(0, NOISE, found.shape))


def hall(seed: int = 1) -> FloatArray:
    """A hall of odd corners, some 20 by 12 m, without any symmetry."""
    return walls(
        (-9, -4, 11, -4), (11, -4, 11, 3), (11, 3, 5, 3), (5, 3, 5, 6), (5, 6, -2, 6), (-2, 6, -2, 4),
        (-2, 4, -9, 4), (-9, 4, -9, -4), (1, -1, 2, -1), (2, -1, 2, 1), (-6, 0, -5, 1), seed=seed,
    )  # fmt: skip


def corridor(seed: int = 1, length: float = 18.0) -> FloatArray:
    """Two parallel walls, and nothing that tells one end from the other."""
    return walls((-length, -1.2, length, -1.2), (-length, 1.2, length, 1.2), seed=seed)


def square_room(seed: int = 1) -> FloatArray:
    """Four equal walls: every quarter turn looks the same."""
    return walls((-5, -5, 5, -5), (5, -5, 5, 5), (5, 5, -5, 5), (-5, 5, -5, -5), seed=seed)


def seen_from(points: FloatArray, pose: tuple[float, float, float]) -> FloatArray:
    """Points of a frame as they are seen from a pose in it."""
    return apply(inverse(pose), points)
