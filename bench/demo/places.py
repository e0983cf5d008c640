"""Two robots out of one run, their keyframes, and the ground truth.

Alice drives scans 0-799 (413 m), Bob scans 800-1799 (490 m). Both pass the ring of corridors in the
south-west and one corridor further north; elsewhere each is alone. Scans 1800 onward are the public map: they
give the direction of the building's walls and the statistics that whiten the descriptors.

What a robot uses on its own:

- its scans and its own odometry. The optimised poses, which know the other robot's scans, are used for the
  ground truth and the picture alone;
- a compass: its heading at its first scan. The log has none, so the first pose's heading stands in; an error
  of 30 degrees changes nothing (the odometry drifts by 12 degrees, and the walls do the rest). Without a
  compass (``turns=4``) Bob offers every keyframe in four quarter turns, at four times the comparisons and at
  a price: this building's rings of corridors look the same when turned by 180 degrees.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bench.demo.dataset import Run
from bench.demo.local_map import LocalMap, payload_of
from bench.demo.mapping import PublicMap, dead_reckoning, directed_submaps, keyframes
from bench.demo.scan_context import polar_grid, quarter_turns
from spdz.foundations.types import FloatArray

ALICE, BOB = range(0, 800), range(800, 1800)
SPACING = 4.0
"""Metres of travel from keyframe to keyframe."""
SAME, DIFFERENT = 1.0, 4.0
"""Keyframes within 1 m are the same place, beyond 4 m different ones; between, they are left out."""
DEFAULT_THRESHOLD = 0.42
"""Two keyframes match if the inner product of their descriptors is at least this.

Chosen on this run, for one turn a keyframe: precision 0.91, recall 0.70 of 30 pairs of the same place. With
other spacings from 2.5 to 5 m (10 to 65 such pairs) it gives precision 0.57 to 1.00 and recall 0.58 to 0.80.
Another building needs its own.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """One robot with n keyframes.

    Attributes:
        name: ``"alice"`` or ``"bob"``.
        trajectory: ``(k, 2)``, metres, in the map frame; for the picture.
        positions: ``(n, 2)``, metres, of the keyframes in the map frame; for the ground truth.
        descriptors: ``(n * turns, 1200)``, norm 1; the turns of a keyframe lie together.
        turns: Descriptors a keyframe: 1, or 4 where every quarter turn is offered.
        local: What the robot knows on its own: its poses by odometry, and its submaps.
    """

    name: str
    trajectory: FloatArray = field(repr=False)
    positions: FloatArray = field(repr=False)
    descriptors: FloatArray = field(repr=False)
    turns: int = 1
    local: LocalMap = field(repr=False, kw_only=True)

    def fold(self, decisions: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """From one decision a descriptor of this robot to one a keyframe: any turn that matches counts.

        Args:
            decisions: ``(m, n * turns)``, against m descriptors of the other robot.

        Returns:
            ``(m, n)``.

        Raises:
            ValueError: the last axis is not as long as this robot has descriptors.
        """
        if decisions.ndim != 2 or decisions.shape[1] != len(self.descriptors):
            raise ValueError(f"expected shape (m, {len(self.descriptors)}), got {decisions.shape}")
        return np.asarray(decisions.reshape(len(decisions), -1, self.turns).any(axis=2))


class Quality(NamedTuple):
    """How good decisions are. Precision is NaN if nothing that counts was declared a match."""

    precision: float
    recall: float
    true_positives: int
    false_positives: int


def robots(
    run: Run, *, spacing: float = SPACING, turns: int = 1, public: PublicMap | None = None
) -> tuple[Robot, Robot]:
    """Alice and Bob with their descriptors.

    Args:
        run: From :func:`bench.demo.dataset.load`.
        spacing: Metres of travel between keyframes.
        turns: 1, or 4 for robots without a compass: Bob then has four descriptors a keyframe.
        public: The public map; None: made of the run.

    Raises:
        ValueError: ``turns`` or ``spacing`` is out of range, or the run has no scans for a public map.
    """
    if turns not in (1, 4) or not spacing > 0:
        raise ValueError(f"expected turns 1 or 4 and a spacing above 0, got {turns} and {spacing}")
    public = public or PublicMap.of(run, spacing)

    def robot(name: str, scans: range, offered: int) -> Robot:
        at = keyframes(run, scans, spacing)
        poses = dead_reckoning(run, scans)
        grids, payloads = [], []
        for keyframe, (points, walls) in zip(
            at, directed_submaps(run, scans, poses, public.walls, at), strict=True
        ):
            grids.append(quarter_turns(polar_grid(points), offered))
            payloads.append(payload_of(points, walls - poses[keyframe, 2]))
        descriptors = public.background.describe(np.concatenate(grids))
        local = LocalMap(scans, poses, at, tuple(payloads))
        return Robot(
            name, run.poses[scans, :2], run.poses[scans.start + at, :2], descriptors, offered, local=local
        )

    return robot("alice", ALICE, 1), robot("bob", BOB, turns)


def truth(alice: Robot, bob: Robot) -> npt.NDArray[np.int8]:
    """Which keyframes show the same place.

    Returns:
        ``(n_alice, n_bob)``: 1 the same place, 0 different places, -1 left out as neither.
    """
    offsets = alice.positions[:, None] - bob.positions[None]
    distance = np.hypot(offsets[..., 0], offsets[..., 1])
    return np.where(distance <= SAME, 1, np.where(distance <= DIFFERENT, -1, 0)).astype(np.int8)


def precision_recall(decisions: npt.NDArray[np.bool_], truth: npt.NDArray[np.int8]) -> Quality:
    """Compare folded decisions with the ground truth; pairs left out count nowhere.

    Args:
        decisions: ``(n_alice, n_bob)``.
        truth: ``(n_alice, n_bob)`` from :func:`truth`, with at least one pair of the same place.

    Raises:
        ValueError: the shapes differ, or there is nothing to be found.
    """
    if decisions.shape != truth.shape:
        raise ValueError(f"expected decisions of shape {truth.shape}, got {decisions.shape}")
    to_find = int(np.count_nonzero(truth == 1))
    if to_find == 0:
        raise ValueError("no pair shows the same place: recall has no meaning")
    true_positives = int(np.count_nonzero(decisions & (truth == 1)))
    false_positives = int(np.count_nonzero(decisions & (truth == 0)))
    declared = true_positives + false_positives
    precision = true_positives / declared if declared else float("nan")
    return Quality(precision, true_positives / to_find, true_positives, false_positives)
