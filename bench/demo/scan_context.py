"""Place descriptors from laser scans: Scan Context over submaps, whitened.

Scan Context (Kim and Kim, "Scan Context: egocentric spatial descriptor for place recognition within 3D point
cloud map", IROS 2018) is a polar grid, 20 rings by 60 sectors, around the robot. Three changes suit it to a
planar scanner in long, repetitive corridors, where single scans tell nothing apart:

- a *submap*, all scans within 20 m of travel, takes the place of a single scan;
- a cell holds the square root of its number of occupied 5-cm squares (a plane has no heights), blurred;
- the grid is turned to the building's walls and whitened with the statistics of a public map, so that what
  every corridor has counts little and what is special counts much. The score is then the plain inner product
  of unit vectors, as a private comparison wants it; Scan Context's search over 60 rotations is not needed.

The whitening is symmetric under quarter turns, so turning a submap rolls its descriptor by 15 sectors.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import FloatArray

RINGS, SECTORS = 20, 60
DIMENSION = RINGS * SECTORS
QUARTER = SECTORS // 4
"""Sectors in a quarter turn."""

RADIUS = 20.0
"""Radius of the grid in metres."""
SQUARE = 0.05
"""Side of the squares whose occupation is counted, in metres."""
SATURATION = 8
"""Occupied squares beyond this number do not count: near cells would drown the far ones."""
BLUR = 1.0
"""Standard deviation of the Gaussian blur, in cells."""
MAX_RANGE = 15.0
"""Readings beyond this, in metres, are too sparse to be walls."""
MAX_GAP = 0.3
"""Neighbouring readings within this distance, in metres, lie on one wall."""
SHRINKAGE = 0.3
"""What is added to each variance before whitening, as a fraction of the mean variance."""


def scan_points(ranges: FloatArray, bearings: FloatArray, poses: FloatArray) -> FloatArray:
    """Turn k scans of b readings into points in the frame of the poses.

    Args:
        ranges: ``(k, b)``, metres.
        bearings: ``(b,)``, radians.
        poses: ``(k, 3)``, metres and radians.

    Returns:
        ``(k, b, 2)``, metres; NaN where the reading is beyond ``MAX_RANGE``.
    """
    angles = poses[:, 2:] + bearings
    reach = np.where(ranges < MAX_RANGE, ranges, np.nan)
    return np.asarray(
        poses[:, None, :2] + np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=-1)
    )


def wall_direction(points: FloatArray, near: float) -> float:
    """The dominant wall direction: the phase of the fourth harmonic of the segments' directions.

    Walls fix the direction up to quarter turns only; the one nearest to ``near`` is returned.

    Args:
        points: ``(k, b, 2)`` from :func:`scan_points`.
        near: A rough direction in radians, better than 45 degrees.
    """
    segments = np.diff(points, axis=1)
    lengths = np.hypot(segments[..., 0], segments[..., 1])
    segments = segments[lengths < MAX_GAP]
    z = segments[:, 0] + 1j * segments[:, 1]
    size = np.maximum(np.abs(z), np.finfo(np.float64).tiny)
    fourth = np.sum(size * (z / size) ** 4 * np.exp(-4j * near))
    return near + float(np.angle(fourth)) / 4


def polar_grid(points: FloatArray) -> FloatArray:
    """Count occupied squares around the origin in rings and sectors, saturate, take the square root, blur.

    Args:
        points: ``(k, 2)``, metres, without NaN.

    Returns:
        ``(RINGS, SECTORS)``; sectors run anticlockwise from the x axis.
    """
    points = points[np.hypot(points[:, 0], points[:, 1]) < RADIUS + 1]
    side = 2 * int((RADIUS + 2) / SQUARE)
    index = np.floor(points / SQUARE).astype(np.int64) + side // 2
    occupied = np.unique(index[:, 0] * side + index[:, 1])
    centres = (np.stack([occupied // side, occupied % side], axis=1) - side // 2 + 0.5) * SQUARE
    radius = np.hypot(centres[:, 0], centres[:, 1])
    turn = np.arctan2(centres[:, 1], centres[:, 0]) / (2 * np.pi) % 1.0
    cell = (radius / RADIUS * RINGS).astype(np.int64) * SECTORS + (turn * SECTORS).astype(np.int64) % SECTORS
    counts = np.bincount(cell[radius < RADIUS], minlength=DIMENSION).reshape(RINGS, SECTORS)
    return _blur(np.sqrt(np.minimum(counts, SATURATION)))


def _blur(grid: FloatArray) -> FloatArray:
    """Blur with a Gaussian of 7 taps: sectors wrap around, rings end."""
    taps = np.arange(-3, 4)
    weights = np.exp(-((taps / BLUR) ** 2) / 2)
    weights /= weights.sum()
    padded = np.pad(grid, ((3, 3), (0, 0)))
    across = sum(w * padded[3 + t : 3 + t + RINGS] for w, t in zip(weights, taps, strict=True))
    return np.asarray(sum(w * np.roll(across, t, axis=1) for w, t in zip(weights, taps, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """What grids of the building look like on the whole: public, the same for both robots.

    Attributes:
        mean: ``(DIMENSION,)``, the mean grid.
        whitening: ``(DIMENSION, DIMENSION)``, symmetric; the inverse square root of the shrunk covariance.
    """

    mean: FloatArray = field(repr=False)
    whitening: FloatArray = field(repr=False)

    @staticmethod
    def fit(grids: FloatArray) -> "Background":
        """Learn mean and covariance from public grids, each taken in all four quarter turns.

        Args:
            grids: ``(n, RINGS, SECTORS)``, n >= 2 and not all the same.
        """
        turned = np.concatenate([quarter_turns(grid, 4) for grid in grids]).reshape(-1, DIMENSION)
        mean = turned.mean(axis=0)
        centred = turned - mean
        variances, axes = np.linalg.eigh(centred.T @ centred / len(centred))
        # Rounding can leave the null space's variances a little below zero.
        scale = (np.maximum(variances, 0) + SHRINKAGE * variances.mean()) ** -0.5
        return Background(mean, (axes * scale) @ axes.T)

    def describe(self, grids: FloatArray) -> FloatArray:
        """Descriptors of grids.

        Args:
            grids: ``(n, RINGS, SECTORS)``.

        Returns:
            ``(n, DIMENSION)`` of Euclidean norm 1.
        """
        whitened = (grids.reshape(-1, DIMENSION) - self.mean) @ self.whitening
        return np.asarray(whitened / np.linalg.norm(whitened, axis=1, keepdims=True))


def quarter_turns(grid: npt.NDArray[np.float64], turns: int) -> FloatArray:
    """The grid and its next quarter turns, anticlockwise: ``(turns, RINGS, SECTORS)``."""
    return np.stack([np.roll(grid, QUARTER * turn, axis=-1) for turn in range(turns)])
