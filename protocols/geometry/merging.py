"""Two robots' maps as one: a pose graph of both odometries and the loops between them, and its error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocols.geometry.pose_graph import PoseGraph
from protocols.geometry.poses import Pose, between, compose, inverse
from spdz.foundations.types import FloatArray


class Loop(NamedTuple):
    """A place that both robots saw.

    Attributes:
        first: Which of the first robot's poses.
        second: Which of the second's.
        pose: The second in the frame of the first: x, y (metres), theta (radians).
    """

    first: int
    second: int
    pose: Pose


def two_maps(
    first: FloatArray,
    second: FloatArray,
    loops: Sequence[Loop],
    *,
    step: FloatArray,
    loop: FloatArray,
) -> PoseGraph:
    """The graph of two trajectories; the second robot's poses follow the first's.

    The second trajectory starts where that loop lays it with which most others agree (the least median of
    their distances), so a minority of wrong loops does not move the start.

    Args:
        first: ``(k, 3)``, the first robot's poses by odometry.
        second: ``(l, 3)``, the second's, in a frame of its own.
        loops: At least one; all of them may be wrong, so they are the graph's doubtful edges.
        step: ``(3,)``, standard deviations of a step of odometry: metres, metres, radians.
        loop: ``(3,)``, those of a loop.

    Raises:
        ValueError: there is no loop, or one names a pose that is not there.
    """
    if not loops:
        raise ValueError("no loop joins the two maps: nothing tells where they lie to each other")
    ends = np.array([(at.first, at.second) for at in loops])
    if not ((ends >= 0) & (ends < (len(first), len(second)))).all():
        raise ValueError(f"a loop names a pose outside {len(first)} and {len(second)}")
    measured = np.array([at.pose for at in loops], dtype=np.float64)
    expected = compose(first[ends[:, 0]], measured)
    starts = compose(expected, inverse(second[ends[:, 1]]))
    laid = compose(starts[:, None], second[ends[:, 1]])
    misses = np.hypot(laid[..., 0] - expected[:, 0], laid[..., 1] - expected[:, 1])
    start = starts[int(np.argmin(np.median(misses, axis=1)))]

    steps = [np.stack([np.arange(n - 1), np.arange(1, n)], axis=1) for n in (len(first), len(second))]
    pairs = np.concatenate([steps[0], steps[1] + len(first), ends + np.array([0, len(first)])])
    odometry = [between(poses[:-1], poses[1:]) for poses in (first, second)]
    doubtful = np.arange(len(pairs)) >= len(pairs) - len(loops)
    deviations = np.where(doubtful[:, None], loop, step)
    return PoseGraph(
        poses=np.concatenate([first, compose(start, second)]),
        pairs=pairs.astype(np.int64),
        measured=np.concatenate([*odometry, measured]),
        information=deviations[:, :, None] ** -2.0 * np.eye(3),
        doubtful=doubtful,
    )


def lay_upon(estimated: FloatArray, truth: FloatArray) -> FloatArray:
    """Poses turned and shifted, not scaled, so that their positions fit the truth best: ``(n, 3)`` each."""
    a, b = (poses[:, 0] + 1j * poses[:, 1] for poses in (estimated, truth))
    turn = float(np.angle(np.sum((b - b.mean()) * (a - a.mean()).conj())))
    offset = b.mean() - a.mean() * np.exp(1j * turn)
    return compose((offset.real, offset.imag, turn), estimated)


def trajectory_error(estimated: FloatArray, truth: FloatArray) -> float:
    """Absolute trajectory error in metres: root mean square of positions after :func:`lay_upon`.

    The ATE of Sturm et al. ("A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012), in the plane.

    Raises:
        ValueError: the shapes differ or there are no poses.
    """
    if estimated.shape != truth.shape or len(truth) == 0:
        raise ValueError(f"expected as many poses as of the truth, got {estimated.shape} and {truth.shape}")
    offsets = lay_upon(estimated, truth)[:, :2] - truth[:, :2]
    return float(np.sqrt((offsets**2).sum(axis=1).mean()))
