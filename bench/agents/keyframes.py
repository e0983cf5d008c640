"""Real keyframes for a team: one run through MIT's corridors, cut into as many robots as are wanted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bench.demo import dataset
from bench.demo.mapping import PublicMap, dead_reckoning, submaps
from bench.demo.places import SPACING
from bench.demo.scan_context import polar_grid
from spdz.foundations.types import FloatArray


def team(robots: int, count: int) -> list[FloatArray]:
    """Descriptors of every robot's keyframes, evenly spaced over its part of the run.

    Args:
        robots: How many.
        count: Keyframes of each.

    Returns:
        For each robot float64 of shape (count, 1200), of norm 1.

    Raises:
        ValueError: if there are fewer scans than that.
    """
    run = dataset.load()
    public = PublicMap.of(run, SPACING)
    cuts = np.linspace(0, len(run.poses), robots + 1).astype(int)
    if min(np.diff(cuts)) < count:
        raise ValueError(f"the run has {len(run.poses)} scans: take fewer robots or keyframes")
    return [_describe(run, public, range(int(first), int(last)), count) for first, last in pairwise(cuts)]


def _describe(run: dataset.Run, public: PublicMap, scans: range, count: int) -> FloatArray:
    at = np.linspace(0, len(scans) - 1, count).astype(np.int64)
    around = submaps(run, scans, dead_reckoning(run, scans), public.walls, at)
    return public.background.describe(np.stack([polar_grid(submap) for submap in around]))
