"""What the demo's pictures show, on their axes: walls, trails and places, turned to the walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.demo.dataset import Run
from bench.demo.local_map import LocalMap
from bench.demo.scan_context import scan_points, wall_direction
from protocols.geometry.poses import apply, compose
from spdz.foundations.types import FloatArray

CELL = 0.25
"""Side in metres of the squares in which walls are drawn."""
MARGIN = 6.0
"""Metres of building shown around the trails."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One robot's map on the axes of a picture, in metres.

    Attributes:
        walls: ``(n, 2)``, the lower left corners of the squares in which something was seen.
        trail: ``(k, 2)``.
        places: ``(m, 2)``, the keyframes.
    """

    walls: FloatArray = field(repr=False)
    trail: FloatArray = field(repr=False)
    places: FloatArray = field(repr=False)


def views(run: Run, maps: Sequence[LocalMap], poses: Sequence[FloatArray]) -> list[View]:
    """Maps in one frame, turned so that walls are upright and the trails lie lengthwise.

    Args:
        run: The run whose scans are drawn.
        maps: Whose scans, and where their keyframes are.
        poses: ``(k, 3)`` of each, in the one frame.
    """
    seen = [scan_points(run.ranges[own.scans], run.bearings, at) for own, at in zip(maps, poses, strict=True)]
    turn = -wall_direction(np.concatenate(seen), 0.0)
    trails = np.concatenate([apply((0, 0, turn), at[:, :2]) for at in poses])
    if np.ptp(trails[:, 1]) > np.ptp(trails[:, 0]):
        turn -= np.pi / 2
    low = np.full(2, np.inf)
    turned = [compose((0, 0, turn), at)[:, :2] for at in poses]
    for trail in turned:
        low = np.minimum(low, trail.min(axis=0) - MARGIN)
    high = np.max([trail.max(axis=0) for trail in turned], axis=0) + MARGIN
    found = []
    for own, points, trail in zip(maps, seen, turned, strict=True):
        walls = apply((0, 0, turn), points[np.isfinite(points[..., 0])])
        walls = walls[((walls > low) & (walls < high)).all(axis=1)] - low
        squares, counts = np.unique(np.floor(walls / CELL).astype(np.int64), axis=0, return_counts=True)
        found.append(View(squares[counts > 1] * CELL, trail - low, (trail - low)[own.keyframes]))
    return found


def seen_by_both(first: View, second: View) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Walls that the first, the second, and both saw, to within a square: ``(n, 2)`` each."""
    side = 1 << 20
    corners = [np.rint(view.walls / CELL).astype(np.int64) + 1 for view in (first, second)]
    keys = [index[:, 0] * side + index[:, 1] for index in corners]
    around = [np.add.outer(key, [x * side + y for x in (-1, 0, 1) for y in (-1, 0, 1)]) for key in keys]
    common = [np.isin(keys[0], around[1]), np.isin(keys[1], around[0])]
    both = np.unique(np.concatenate([first.walls[common[0]], second.walls[common[1]]]), axis=0)
    return first.walls[~common[0]], second.walls[~common[1]], both


def size(shown: Sequence[View]) -> tuple[float, float]:
    """Width and height in metres that hold views of one frame."""
    most = np.max([view.trail.max(axis=0) for view in shown], axis=0) + MARGIN
    return float(most[0]), float(most[1])
