"""A pose graph solved by GTSAM, where it is installed: ``pip install gtsam``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from protocols.geometry.pose_graph import PoseGraph
from spdz.foundations.types import FloatArray

HELD = 1e-9
"""Standard deviation of the first pose, which stays where it is: metres and radians."""


def solve(graph: PoseGraph, doubtful: npt.NDArray[np.bool_], width: float) -> tuple[FloatArray, bool]:
    """Levenberg-Marquardt, with Geman and McClure's kernel on the doubtful edges.

    Args:
        graph: What to fit.
        doubtful: ``(m,)``, which edges get the kernel.
        width: The kernel's, in standard deviations.

    Returns:
        The poses, ``(n, 3)``, and whether the solver stopped of its own accord.

    Raises:
        ImportError: GTSAM is not installed.
    """
    try:
        import gtsam
    except ImportError as error:
        raise ImportError("GTSAM is not installed: pip install gtsam") from error
    factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(graph.poses):
        start.insert(key, gtsam.Pose2(*pose))
    held = gtsam.noiseModel.Isotropic.Sigma(3, HELD)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), held))
    kernel = gtsam.noiseModel.mEstimator.GemanMcClure.Create(width)
    for (i, j), measured, information, wrong in zip(
        graph.pairs, graph.measured, graph.information, doubtful, strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        if wrong:
            noise = gtsam.noiseModel.Robust.Create(kernel, noise)
        factors.add(gtsam.BetweenFactorPose2(int(i), int(j), gtsam.Pose2(*measured), noise))
    parameters = gtsam.LevenbergMarquardtParams()
    solver = gtsam.LevenbergMarquardtOptimizer(factors, start, parameters)
    found = solver.optimize()
    poses = [found.atPose2(key) for key in range(len(graph.poses))]
    settled = solver.iterations() < parameters.getMaxIterations()
    return np.array([[pose.x(), pose.y(), pose.theta()] for pose in poses]), settled
