"""The demo's two maps made one: with the verified loops, and what it would be without verifying."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.demo.dataset import Run
from bench.demo.places import Robot
from protocols.geometry.files import write_g2o, write_tum
from protocols.geometry.merging import Loop, lay_upon, trajectory_error, two_maps
from protocols.geometry.pose_graph import PoseGraph, Solution, Solver, optimise
from protocols.geometry.verification import Verified
from spdz.foundations.types import FloatArray

STEP = np.array([500.0, 500.0, 5000.0]) ** -0.5
"""Standard deviations of an odometry step: the log's own. Metres, metres, radians."""
LOOP = np.array([0.1, 0.1, 0.02])
"""Those of an alignment of two submaps."""


class Errors(NamedTuple):
    """Trajectory errors in metres: RMSE of all scans' positions after the best turn and shift.

    Attributes:
        alice_alone: Of Alice's odometry, laid upon the truth by itself.
        bob_alone: Of Bob's.
        unverified: Of both, merged with every candidate by plain least squares; both laid upon the truth
            at once, by one turn and shift, as in all that follow.
        kernel_only: The same, with the robust kernel.
        merged: Of both, merged with the verified candidates and the robust kernel.
        alice_merged: Alice's part of it, still laid upon the truth with Bob's.
        bob_merged: Bob's.
    """

    alice_alone: float
    bob_alone: float
    unverified: float
    kernel_only: float
    merged: float
    alice_merged: float
    bob_merged: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Both robots' poses in one frame, Alice's.

    Attributes:
        graph: Of the verified loops.
        poses: ``(k + l, 3)``, Alice's, then Bob's.
        unverified: The same, merged with every candidate by plain least squares.
        errors: How far off they are.
    """

    graph: PoseGraph = field(repr=False)
    poses: FloatArray = field(repr=False)
    unverified: FloatArray = field(repr=False)
    errors: Errors

    def write(self, out: Path, run: Run, alice: Robot, bob: Robot) -> list[Path]:
        """Write ``merged.g2o``, ``alice.tum``, ``bob.tum`` (odometry) and ``merged.tum`` (by time)."""
        files = [out / name for name in ("merged.g2o", "alice.tum", "bob.tum", "merged.tum")]
        write_g2o(files[0], self.graph, self.poses)
        stamps = [run.stamps[robot.local.scans] for robot in (alice, bob)]
        write_tum(files[1], stamps[0], alice.local.poses)
        write_tum(files[2], stamps[1], bob.local.poses)
        write_tum(files[3], np.concatenate(stamps), self.poses)
        return files


def merge(
    run: Run, alice: Robot, bob: Robot, verdicts: Mapping[tuple[int, int], Verified], solver: Solver
) -> Merged:
    """Merge both robots' maps.

    Args:
        run: With the truth.
        alice: From :func:`bench.demo.places.robots`.
        bob: From :func:`bench.demo.places.robots`.
        verdicts: Of the candidates, by Alice's and Bob's keyframe; transforms are of Bob's in Alice's.
        solver: Of the pose graphs.

    Raises:
        ValueError: no candidate was verified.
        ImportError: the solver is not installed.
    """

    def solved(robust: bool, verified_only: bool) -> tuple[PoseGraph, Solution]:
        loops = [
            Loop(int(alice.local.keyframes[i]), int(bob.local.keyframes[j]), verdict.transform)
            for (i, j), verdict in sorted(verdicts.items())
            if verdict.transform is not None and (verdict.accepted or not verified_only)
        ]
        graph = two_maps(alice.local.poses, bob.local.poses, loops, step=STEP, loop=LOOP)
        return graph, optimise(graph, robust=robust, solver=solver)

    graph, found = solved(robust=True, verified_only=True)
    _, careless = solved(robust=False, verified_only=False)
    _, kernel_only = solved(robust=True, verified_only=False)
    truth = np.concatenate([run.poses[robot.local.scans] for robot in (alice, bob)])
    own = len(alice.local.poses)
    off = (lay_upon(found.poses, truth) - truth)[:, :2]
    squares = (off**2).sum(axis=1)
    return Merged(
        graph,
        found.poses,
        careless.poses,
        Errors(
            alice_alone=trajectory_error(alice.local.poses, truth[:own]),
            bob_alone=trajectory_error(bob.local.poses, truth[own:]),
            unverified=trajectory_error(careless.poses, truth),
            kernel_only=trajectory_error(kernel_only.poses, truth),
            merged=trajectory_error(found.poses, truth),
            alice_merged=float(np.sqrt(squares[:own].mean())),
            bob_merged=float(np.sqrt(squares[own:].mean())),
        ),
    )
