"""Point-to-line ICP of two 2-D laser submaps, and whether to believe it.

1. *Coarse*: for every heading to try, the occupied cells of both submaps are correlated by FFT over all
   shifts of some metres (Olson, "Real-time correlative scan matching", ICRA 2009); the best peaks are starts.
2. *Fine*: from each start, Gauss-Newton on the distances from points to the nearest point's line (Censi, "An
   ICP variant using a point-to-line metric", ICRA 2008) with Cauchy weights and a shrinking gate.
3. *Doubt*: of the points near either keyframe, the share that has a neighbour in the other submap must be
   large **both ways**: a robot in a bare corridor fits into every richer one, but not the other way round.
   An alignment is refused, too, where the submaps could slide along each other (parallel walls alone), and
   where another start ends elsewhere and fits as well.

All of it is deterministic: the same points give the same answer on the same machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from protocols.geometry.poses import Pose, apply, between, inverse
from protocols.geometry.submap import thin
from spdz.foundations.types import FloatArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NEAR = 8.0
"""Metres around either keyframe whose points are counted: further away both submaps are sparse and bent."""
INLIER = 0.15
"""A point within this of a point of the other submap, in metres, is an inlier."""
LEAST_SHARE = 0.8
"""Of the points near a keyframe, the share of inliers that makes two submaps the same place."""
LEAST_POINTS = 100
"""Points near a keyframe below which nothing is decided."""
LEAST_PAIRS = 30
"""Points moved that must find a line."""
LEAST_SUPPORT = 0.02
"""Least share of the lines that must stand across any direction, or the submaps slide in it."""
FARTHEST_SHIFT = 5.0
"""Metres between two keyframes up to which they are looked for."""
CELL = 0.25
"""Side of the coarse search's cells in metres."""
REACH = 20.0
"""Metres around the keyframes that the coarse search looks at."""
GATES = 1.5, 0.4
"""Metres within which a point finds its line: at first, and after the gate has shrunk."""
SCALE = 0.05
"""Least scale of the Cauchy weights in metres: about the noise of a scan."""
MOVED, SPARSE = 12.0, 0.15
"""Moved about are points within 12 m of the keyframe, one of each square of 0.15 m."""
SETTLED = 5e-4
"""Metres and radians that a step of the refinement moves no more than in the end."""
STARTS = 3
"""Peaks of the coarse search that are refined."""
APART = 1.0, 0.2
"""Metres and radians beyond which two alignments are different ones."""
AS_GOOD = 0.03
"""Another alignment whose share is at most this much smaller fits as well."""
NEIGHBOURS, LINE_RADIUS, FLATNESS = 10, 0.5, 0.3
"""A line at a point: its 10 nearest points, none beyond 0.5 m, at most 0.3 times as broad as long."""
HEADINGS = 2.0
"""Degrees between the headings that the coarse search tries."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where one submap lies in another.

    Attributes:
        transform: The pose of the other keyframe in the own one's frame; None if none was found.
        share: The smaller share of inliers of the two ways, from 0 to 1.
        residual: Root mean square distance of the inliers from their lines, in metres; NaN if there are none.
        why: Why not to believe it; empty if it is believed.
    """

    transform: Pose | None
    share: float
    residual: float
    why: str

    @property
    def accepted(self) -> bool:
        """Whether the two submaps show the same place."""
        return not self.why


def align(
    own: FloatArray,
    other: FloatArray,
    *,
    heading: float | None = 0.0,
    spread: float = 6.0,
    share: float = LEAST_SHARE,
) -> Alignment:
    """Find where the other submap lies in the own one.

    Args:
        own: ``(n, 2)``, metres, in the own keyframe's frame; finite.
        other: ``(m, 2)``, metres, in the other keyframe's frame; finite.
        heading: The other keyframe's heading in the own frame, in radians, as far as it is known; None where
            it is not: every heading is then tried, and places that look alike from two sides are refused.
        spread: Degrees around ``heading`` that are tried.
        share: Least share of inliers that is believed.

    Raises:
        ImportError: SciPy is not installed.
        ValueError: a shape is wrong or a number is not finite.
    """
    for points in (own, other):
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise ValueError(f"expected finite points of shape (n, 2), got {points.shape}")
    first, second = _Surface.of(thin(own)), _Surface.of(thin(other))
    if first is None or second is None:
        return Alignment(None, 0.0, float("nan"), f"fewer than {LEAST_POINTS} points within {NEAR:.0f} m")
    if heading is None:
        headings = np.arange(-np.pi, np.pi, np.radians(HEADINGS))
    else:
        headings = heading + np.radians(np.arange(-spread, spread + HEADINGS / 2, HEADINGS))
    lines, starts = _Lines.of(first), _coarse(first.points, second.points, headings)
    fits = [_fit(first, lines, second, start) for start in starts]
    fits.sort(key=lambda fit: -fit.share)
    best = fits[0]
    if best.why or best.share < share:
        why = best.why or f"{best.share:.0%} of the points agree, and {share:.0%} must"
        return Alignment(best.transform, best.share, best.residual, why)
    for fit in fits[1:]:
        if fit.share >= best.share - AS_GOOD and _apart(best, fit):
            return Alignment(
                best.transform, best.share, best.residual, "two different alignments fit as well"
            )
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The points of a submap.

    Attributes:
        points: ``(n, 2)``.
        tree: Finds the nearest of them.
        near: ``(k, 2)``, those near the keyframe, which are counted.
        sparse: ``(m, 2)``, fewer of those around it, which are moved about.
    """

    points: FloatArray
    tree: cKDTree
    near: FloatArray
    sparse: FloatArray

    @staticmethod
    def of(points: FloatArray) -> _Surface | None:
        """Look at points; None if there are too few near the keyframe."""
        from scipy.spatial import cKDTree

        away = np.hypot(points[:, 0], points[:, 1])
        near = points[away < NEAR]
        if len(near) < LEAST_POINTS:
            return None
        return _Surface(points, cKDTree(points), near, thin(points[away < MOVED], SPARSE))


class _Lines(NamedTuple):
    """The lines on which the points of a surface lie.

    Attributes:
        normals: ``(n, 2)``, across the line at each point.
        flat: ``(n,)``, whether the points around it lie on a line at all.
    """

    normals: FloatArray
    flat: npt.NDArray[np.bool_]

    @staticmethod
    def of(surface: _Surface) -> _Lines:
        """By principal components of each point's neighbours."""
        distance, index = surface.tree.query(surface.points, k=NEIGHBOURS)
        around = surface.points[index] - surface.points[index].mean(axis=1, keepdims=True)
        xx, yy = (around**2).mean(axis=1).T
        xy = (around[..., 0] * around[..., 1]).mean(axis=1)
        along = np.arctan2(2 * xy, xx - yy) / 2
        mean, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        flat = (mean - radius <= FLATNESS**2 * (mean + radius)) & (distance[:, -1] <= LINE_RADIUS)
        return _Lines(np.stack([-np.sin(along), np.cos(along)], axis=1), flat)


def _coarse(own: FloatArray, other: FloatArray, headings: FloatArray) -> list[FloatArray]:
    """The best few starts ``(3,)``, apart from each other, by the number of cells that fall on each other."""
    most = int(FARTHEST_SHIFT / CELL)
    side = 2 * int(REACH / CELL) + most
    spectrum = np.fft.rfft2(_cells(own, side))
    peaks: list[tuple[float, FloatArray]] = []
    for heading in headings:
        turned = np.fft.rfft2(_cells(apply((0, 0, heading), other), side))
        score = np.fft.irfft2(spectrum * np.conj(turned), s=(side, side))
        score = np.roll(score, (most, most), axis=(0, 1))[: 2 * most + 1, : 2 * most + 1]
        for _ in range(STARTS):
            x, y = np.unravel_index(int(score.argmax()), score.shape)
            peaks.append((float(score[x, y]), np.array([(x - most) * CELL, (y - most) * CELL, heading])))
            around = int(APART[0] / CELL)
            score[max(0, x - around) : x + around + 1, max(0, y - around) : y + around + 1] = -1
    starts: list[FloatArray] = []
    for _, start in sorted(peaks, key=lambda peak: -peak[0]):
        if len(starts) < STARTS and all(_differ(start, taken) for taken in starts):
            starts.append(start)
    return starts


def _cells(points: FloatArray, side: int) -> FloatArray:
    """Which cells of a square around the origin hold a point: ``(side, side)`` of 0 and 1."""
    index = np.floor(points / CELL).astype(np.int64) + int(REACH / CELL)
    index = index[((index >= 0) & (index < 2 * int(REACH / CELL))).all(axis=1)]
    cells = np.zeros((side, side))
    cells[index[:, 0], index[:, 1]] = 1.0
    return cells


def _differ(first: FloatArray, second: FloatArray) -> bool:
    offset = between(first, second)
    return bool(np.hypot(offset[0], offset[1]) > APART[0] or abs(offset[2]) > APART[1])


def _apart(first: Alignment, second: Alignment) -> bool:
    return _differ(np.array(first.transform), np.array(second.transform))


def _fit(own: _Surface, lines: _Lines, other: _Surface, start: FloatArray) -> Alignment:
    """Refine a start, then judge it."""
    pose, (gate, last), support = start.copy(), GATES, 0.0
    for _ in range(40):
        moved = apply(pose, other.sparse)
        distance, index = own.tree.query(moved, distance_upper_bound=gate)
        paired = np.flatnonzero(np.isfinite(distance))
        paired = paired[lines.flat[index[paired]]]
        if len(paired) < LEAST_PAIRS:
            return Alignment(None, 0.0, float("nan"), "too few points lie on common lines")
        moved, nearest = moved[paired], index[paired]
        normals = lines.normals[nearest]
        error = ((moved - own.points[nearest]) * normals).sum(axis=1)
        scale = max(SCALE, 1.5 * float(np.median(np.abs(error))))
        weight = 1 / (1 + (error / scale) ** 2)
        arm = moved - pose[:2]
        slope = np.column_stack([normals, arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]])
        normal = (slope * weight[:, None]).T @ slope
        support = float(np.linalg.eigvalsh(normal[:2, :2] / weight.sum())[0])
        # The ridge keeps a pose where it is in a direction that nothing supports.
        step = -np.linalg.solve(
            normal + 1e-3 * len(paired) * np.diag([1, 1, 1e-3]), slope.T @ (weight * error)
        )
        pose = pose + step
        if np.abs(step).max() < SETTLED and gate == last:
            break
        gate = max(last, gate * 0.8)
    moved = apply(pose, other.near)
    distance, index = own.tree.query(moved, distance_upper_bound=INLIER)
    found = np.isfinite(distance)
    nearest = index[found]
    across = ((moved[found] - own.points[nearest]) * lines.normals[nearest]).sum(axis=1)
    across = across[lines.flat[nearest]]
    residual = float(np.sqrt(np.mean(across**2))) if len(across) else float("nan")
    back, _ = other.tree.query(apply(inverse(pose), own.near), distance_upper_bound=INLIER)
    share = min(float(found.mean()), float(np.isfinite(back).mean()))
    transform = float(pose[0]), float(pose[1]), float((pose[2] + np.pi) % (2 * np.pi) - np.pi)
    slides = support < LEAST_SUPPORT
    why = "the walls are all parallel: one submap slides along the other" if slides else ""
    return Alignment(transform, share, residual, why)
