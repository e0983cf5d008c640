"""What a robot of the demo knows on its own, and what of it it shows for a place that matched."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.demo.scan_context import RADIUS, SQUARE, Background, polar_grid
from protocols.geometry.poses import apply, wrap
from protocols.geometry.submap import Submap, thin
from spdz.foundations.types import FloatArray, IntArray

TOLERANCE = 0.1
"""How far the descriptor of a submap may be from the one that was compared: unit vectors, Euclidean.

Measured: at most 0.012 where nobody cheats (float32 moves a few points over the border of a square, and the
gallery rounds), and at least 0.69 from any other keyframe of the same robot.
"""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """One robot's map by odometry alone; k scans, n keyframes.

    Attributes:
        scans: Which scans of the run are its own.
        poses: ``(k, 3)``, in its own frame: the origin is where it started.
        keyframes: ``(n,)``, which of its scans, counted from its first.
        payloads: n submaps, :class:`~protocols.geometry.submap.Submap`.
    """

    scans: range
    poses: FloatArray = field(repr=False)
    keyframes: IntArray = field(repr=False)
    payloads: tuple[bytes, ...] = field(repr=False)


def payload_of(points: FloatArray, walls: float) -> bytes:
    """The submap of a keyframe.

    Args:
        points: ``(k, 2)``, metres, turned to the walls, the keyframe at the origin.
        walls: Direction of the walls in the keyframe's frame, in radians.
    """
    near = points[np.hypot(points[:, 0], points[:, 1]) < RADIUS]
    return Submap(apply((0.0, 0.0, walls), thin(near, SQUARE)), float(wrap(walls))).to_bytes()


def describes(background: Background, payload: bytes, vector: FloatArray) -> bool:
    """Whether a submap gives the descriptor that was compared: a peer that sends another's is found out.

    A peer that computes a submap to a vector of its own making is not: it shows what it claims to have seen.

    Args:
        background: The public statistics that both robots describe with.
        payload: As it came.
        vector: ``(1200,)``, as it was opened.
    """
    try:
        submap = Submap.from_bytes(payload)
    except ValueError:
        return False
    grid = polar_grid(apply((0.0, 0.0, -submap.walls), submap.points))
    return bool(np.linalg.norm(background.describe(grid[None])[0] - vector) <= TOLERANCE)
