"""What a robot makes of its scans on its own: keyframes, its own poses, submaps around keyframes.

And the public map, which all robots have: scans from ``PUBLIC_FROM`` on give the direction of the building's
walls and the statistics that whiten descriptors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from bench.demo.dataset import Run
from bench.demo.scan_context import Background, polar_grid, scan_points, wall_direction
from protocols.geometry.poses import chain
from spdz.foundations.types import FloatArray, IntArray

PUBLIC_FROM = 1800
"""Scans from here on are the public map."""
REACH = 20.0
"""A submap holds the robot's own scans within this many metres of travel, before and after its keyframe."""


@dataclass(frozen=True, slots=True, eq=False)
class PublicMap:
    """What is known of the building before the mission.

    Attributes:
        walls: Direction of the walls in radians, up to quarter turns.
        background: What polar grids of the building look like on the whole.
        grids: ``(n, RINGS, SECTORS)``, of the public keyframes.
        positions: ``(n, 2)``, metres, of the public keyframes.
    """

    walls: float
    background: Background = field(repr=False)
    grids: FloatArray = field(repr=False)
    positions: FloatArray = field(repr=False)

    @staticmethod
    def of(run: Run, spacing: float) -> PublicMap:
        """Make it of a run's public scans, with a keyframe every ``spacing`` metres of travel.

        Raises:
            ValueError: the run has no scans for a public map.
        """
        if len(run.poses) <= PUBLIC_FROM:
            raise ValueError(f"expected a run of more than {PUBLIC_FROM} scans, got {len(run.poses)}")
        scans = range(PUBLIC_FROM, len(run.poses))
        poses = run.poses[scans]
        walls = wall_direction(scan_points(run.ranges[scans], run.bearings, poses), 0.0)
        at = keyframes(run, scans, spacing)
        grids = np.stack([polar_grid(submap) for submap in submaps(run, scans, poses, walls, at)])
        return PublicMap(walls, Background.fit(grids), grids, poses[at, :2])


def travel(run: Run, scans: range) -> FloatArray:
    """Metres travelled at each scan since the first, by odometry."""
    steps = run.odometry[scans.start : scans.stop - 1, :2]
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])


def keyframes(run: Run, scans: range, spacing: float) -> IntArray:
    """Scans, counted from the first, at least ``spacing`` metres of travel apart."""
    travelled = travel(run, scans)
    chosen = [0]
    for scan in range(len(travelled)):
        if travelled[scan] - travelled[chosen[-1]] >= spacing:
            chosen.append(scan)
    return np.array(chosen, dtype=np.int64)


def dead_reckoning(run: Run, scans: range) -> FloatArray:
    """The robot's own poses: odometry from the origin, with the compass heading at the first scan."""
    start = 0.0, 0.0, float(run.poses[scans.start, 2])
    return chain(start, run.odometry[scans.start : scans.stop - 1])


def submaps(run: Run, scans: range, poses: FloatArray, walls: float, at: IntArray) -> Iterator[FloatArray]:
    """The points around keyframes, turned to the walls, with the keyframe at the origin: ``(k, 2)`` each."""
    for submap, _ in directed_submaps(run, scans, poses, walls, at):
        yield submap


def directed_submaps(
    run: Run, scans: range, poses: FloatArray, walls: float, at: IntArray
) -> Iterator[tuple[FloatArray, float]]:
    """Submaps around keyframes, and how each was turned.

    Args:
        run: From :func:`bench.demo.dataset.load`.
        scans: The robot's.
        poses: ``(len(scans), 3)``, as the robot knows them.
        walls: Direction of the walls in radians.
        at: Keyframes, counted from the first scan.

    Yields:
        For each keyframe the points, ``(k, 2)``, metres, without NaN, turned to the walls, the keyframe at
        the origin; and the direction of the walls in the frame of the poses, in radians.
    """
    points, travelled = scan_points(run.ranges[scans], run.bearings, poses), travel(run, scans)
    for keyframe in at:
        first = np.searchsorted(travelled, travelled[keyframe] - REACH)
        last = np.searchsorted(travelled, travelled[keyframe] + REACH, side="right")
        submap = points[first:last]
        direction = wall_direction(submap, walls)
        offsets = submap[np.isfinite(submap[..., 0])] - poses[keyframe, :2]
        turned = (offsets[:, 0] + 1j * offsets[:, 1]) * np.exp(-1j * direction)
        yield np.stack([turned.real, turned.imag], axis=1), direction
