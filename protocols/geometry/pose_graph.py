"""Pose graphs in the plane: the poses that fit odometry and loops best, even if some loops are wrong.

Minimises the sum of squared errors, weighted by their information, over all poses but the first, which stays
where it is. Gauss-Newton on SE(2) with a sparse normal matrix (Grisetti et al., "A tutorial on graph-based
SLAM", ITS Magazine 2010). Edges that may be wrong get the Geman-McClure kernel by graduated non-convexity
(Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 2020): at first nearly quadratic,
so that a start some metres off is no harm, then sharper until an outlier weighs nothing. The kernel does not
start any wider: odometry is a chain that bends for a loop over half the building, and would settle there.

Where GTSAM is installed it may do the same: :func:`optimise` with ``solver="gtsam"``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from protocols.geometry.poses import between, wrap
from spdz.foundations.types import FloatArray, IntArray

Solver: TypeAlias = Literal["scipy", "gtsam"]

BARC = 3.37
"""Errors in standard deviations from which an edge counts as an outlier: 99 % of three normal coordinates."""
WIDEST = 100.0
"""By how much the kernel is wider at first, at most."""
SHARPEN = 1.4
"""By how much the kernel is sharpened in each iteration."""
ITERATIONS = 100
SETTLED = 1e-6
"""Metres and radians that no pose moves by any more."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses, and what was measured between them.

    Attributes:
        poses: ``(n, 3)``, where to start: x, y in metres, theta in radians.
        pairs: ``(m, 2)``, the two poses of each edge.
        measured: ``(m, 3)``, the pose of the second in the frame of the first.
        information: ``(m, 3, 3)``, the inverse covariance of x, y and theta; symmetric, positive definite.
        doubtful: ``(m,)``, which edges may be wrong.
    """

    poses: FloatArray = field(repr=False)
    pairs: IntArray = field(repr=False)
    measured: FloatArray = field(repr=False)
    information: FloatArray = field(repr=False)
    doubtful: npt.NDArray[np.bool_] = field(repr=False)

    def __post_init__(self) -> None:
        n, m = len(self.poses), len(self.pairs)
        shapes = (
            self.poses.shape,
            self.pairs.shape,
            self.measured.shape,
            self.information.shape,
            self.doubtful.shape,
        )
        if shapes != ((n, 3), (m, 2), (m, 3), (m, 3, 3), (m,)) or n == 0:
            raise ValueError(f"a pose graph has shapes (n, 3), (m, 2), (m, 3), (m, 3, 3), (m,), got {shapes}")
        if m and not (
            0 <= self.pairs.min() and self.pairs.max() < n and (self.pairs[:, 0] != self.pairs[:, 1]).all()
        ):
            raise ValueError(f"an edge joins two of the {n} poses, which are numbered from 0")
        if not all(np.isfinite(values).all() for values in (self.poses, self.measured, self.information)):
            raise ValueError("a pose graph holds finite numbers alone")
        if not np.allclose(self.information, np.swapaxes(self.information, 1, 2)):
            raise ValueError("the information of an edge is a symmetric matrix")
        try:
            np.linalg.cholesky(self.information)
        except np.linalg.LinAlgError:
            raise ValueError("the information of an edge is positive definite") from None

    def errors(self, poses: FloatArray) -> FloatArray:
        """What each edge is off by, in standard deviations: ``(m, 3)``."""
        first, second = poses[self.pairs[:, 0]], poses[self.pairs[:, 1]]
        off = between(self.measured, between(first, second))
        return np.asarray((self.whitening() @ off[..., None])[..., 0])

    def whitening(self) -> FloatArray:
        """From errors in metres and radians to standard deviations: ``(m, 3, 3)``."""
        return np.swapaxes(np.linalg.cholesky(self.information), 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What a solver found.

    Attributes:
        poses: ``(n, 3)``.
        weights: ``(m,)``, from 0 (an outlier) to 1; 1 for every edge that is not doubtful.
        settled: Whether the poses had stopped moving when the iterations ended.
    """

    poses: FloatArray = field(repr=False)
    weights: FloatArray = field(repr=False)
    settled: bool = True


def optimise(graph: PoseGraph, *, robust: bool = True, solver: Solver = "scipy") -> Solution:
    """Find the poses that fit best.

    Args:
        graph: What to fit, from a start that is within some metres.
        robust: Whether doubtful edges get the kernel; without, they count like the others.
        solver: SciPy's sparse factorisation, or GTSAM.

    Raises:
        ValueError: the graph is in several pieces, or the solver is neither of the two.
        ImportError: the solver is not installed.
    """
    if solver not in ("scipy", "gtsam"):
        raise ValueError(f'solver is "scipy" or "gtsam", not {solver!r}')
    pieces = _pieces(graph)
    if pieces > 1:
        raise ValueError(f"the pose graph is in {pieces} pieces: nothing tells where they lie to each other")
    doubtful = graph.doubtful if robust else np.zeros_like(graph.doubtful)
    if solver == "gtsam":
        from protocols.geometry.gtsam_solver import solve

        poses, settled = solve(graph, doubtful, BARC)
    else:
        poses, settled = _gauss_newton(graph, doubtful)
    return Solution(poses, _weights(graph, poses, doubtful, 1.0), settled)


def _pieces(graph: PoseGraph) -> int:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(graph.poses)
    joined = coo_array((np.ones(len(graph.pairs)), (graph.pairs[:, 0], graph.pairs[:, 1])), shape=(n, n))
    return int(connected_components(joined, directed=False, return_labels=False))


def _gauss_newton(graph: PoseGraph, doubtful: npt.NDArray[np.bool_]) -> tuple[FloatArray, bool]:
    """Poses, and whether they settled."""
    poses, control, moved = graph.poses.copy(), WIDEST if doubtful.any() else 1.0, np.inf
    for _ in range(ITERATIONS):
        step = _step(graph, poses, _weights(graph, poses, doubtful, control))
        poses = poses + step
        moved = float(np.abs(step).max())
        if control == 1.0 and moved < SETTLED:
            break
        control = max(1.0, control / SHARPEN)
    poses[:, 2] = wrap(poses[:, 2])
    return poses, moved < SETTLED


def _weights(
    graph: PoseGraph, poses: FloatArray, doubtful: npt.NDArray[np.bool_], control: float
) -> FloatArray:
    """Geman and McClure's weights under graduated non-convexity: Yang et al., equation 12."""
    width = control * BARC**2
    return np.where(doubtful, (width / (width + (graph.errors(poses) ** 2).sum(axis=1))) ** 2, 1.0)


def _step(graph: PoseGraph, poses: FloatArray, weights: FloatArray) -> FloatArray:
    """One Gauss-Newton step of all poses: ``(n, 3)``, added to x, y and theta; the first does not move."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    n, m = len(poses), len(graph.pairs)
    if n == 1:
        return np.zeros((1, 3))
    scale = graph.whitening() * np.sqrt(weights)[:, None, None]
    error = graph.errors(poses) * np.sqrt(weights)[:, None]
    of_first, of_second = _slopes(graph, poses)
    blocks = np.stack([scale @ of_first, scale @ of_second], axis=1)
    rows = np.broadcast_to(np.arange(3 * m).reshape(m, 1, 3, 1), blocks.shape)
    columns = np.broadcast_to((3 * graph.pairs[:, :, None, None] + np.arange(3)), blocks.shape)
    slope = coo_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * m, 3 * n)).tocsc()[:, 3:]
    normal = (slope.T @ slope).tocsc()
    solved = spsolve(normal, -slope.T @ error.ravel(), permc_spec="MMD_AT_PLUS_A")
    return np.concatenate([np.zeros((1, 3)), solved.reshape(-1, 3)])


def _slopes(graph: PoseGraph, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How an edge's error moves with its first and its second pose: ``(m, 3, 3)`` each."""
    first, second = poses[graph.pairs[:, 0]], poses[graph.pairs[:, 1]]
    offset = second[:, :2] - first[:, :2]
    turned = _rotations(-(first[:, 2] + graph.measured[:, 2]))
    of_second = np.zeros((len(first), 3, 3))
    of_second[:, :2, :2], of_second[:, 2, 2] = turned, 1.0
    of_first = -of_second
    # A turn of the first pose by d moves the second, as it sees it, by -d x offset.
    quarter = np.stack([offset[:, 1], -offset[:, 0]], axis=1)
    of_first[:, :2, 2] = (turned @ quarter[..., None])[..., 0]
    return of_first, of_second


def _rotations(angles: FloatArray) -> FloatArray:
    cosine, sine = np.cos(angles), np.sin(angles)
    return np.moveaxis(np.array([[cosine, -sine], [sine, cosine]]), -1, 0)
