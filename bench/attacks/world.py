"""Who attacks whom: Bob, compromised, against Alice, on the corridor scans of the demo.

Both are the demo's robots, with the demo's descriptors. Beside what an exchange tells him, Bob knows his own
scans, where on the map he took each of them, and how descriptors are made: the whitening is public. All of
that any robot of the mission has.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.demo.dataset import Run
from bench.demo.mapping import PublicMap, dead_reckoning, keyframes, submaps
from bench.demo.places import ALICE, BOB, DEFAULT_THRESHOLD, DIFFERENT, SPACING
from bench.demo.scan_context import RADIUS, polar_grid, scan_points
from spdz.foundations.types import FloatArray

DENSE = 1.0
"""Metres of travel between the attacker's own places: an attack uses all his scans, not keyframes alone."""
CELL = 0.5
"""Side of a cell of an occupancy grid, in metres."""
CELLS = int(2 * RADIUS / CELL)
"""Cells a side: the grid spans what the descriptor saw."""
_WALL_SQUARE = 0.25
"""Side of a wall point of the pictures, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places of one robot, in the order in which it came to them.

    Attributes:
        positions: ``(n, 2)``, metres, on the map.
        grids: ``(n, RINGS, SECTORS)``, the polar grids before whitening.
        descriptors: ``(n, 1200)``, norm 1.
        occupancy: ``(n, CELLS, CELLS)``: which cells around the place hold a wall, turned to the walls.
    """

    positions: FloatArray = field(repr=False)
    grids: FloatArray = field(repr=False)
    descriptors: FloatArray = field(repr=False)
    occupancy: npt.NDArray[np.bool_] = field(repr=False)

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What the attacks run on.

    Attributes:
        alice: The victim's keyframes.
        bob: The attacker's keyframes: what he brings to an exchange.
        dense: All the attacker's places.
        public: The public map.
        walls: ``(k, 2)``, metres: points of the building's walls.
        threshold: Of a match.
    """

    alice: Places
    bob: Places
    dense: Places
    public: PublicMap = field(repr=False)
    walls: FloatArray = field(repr=False)
    threshold: float = DEFAULT_THRESHOLD

    @property
    def unseen(self) -> npt.NDArray[np.bool_]:
        """Which of Alice's keyframes are where Bob has never been: ``(n_alice,)``."""
        return np.asarray(distances(self.alice.positions, self.dense.positions).min(axis=1) > DIFFERENT)


def build(run: Run, dense: float = DENSE) -> World:
    """Both robots' places.

    Args:
        run: From :func:`bench.demo.dataset.load`.
        dense: Metres of travel between the attacker's own places.
    """
    public = PublicMap.of(run, SPACING)
    alice, bob, every = (
        _places(run, scans, public, spacing)
        for scans, spacing in ((ALICE, SPACING), (BOB, SPACING), (BOB, dense))
    )
    points = scan_points(run.ranges, run.bearings, run.poses).reshape(-1, 2)
    points = points[np.isfinite(points[:, 0])]
    walls = np.unique(np.round(points / _WALL_SQUARE), axis=0) * _WALL_SQUARE
    return World(alice, bob, every, public, walls)


def distances(first: FloatArray, second: FloatArray) -> FloatArray:
    """Metres between positions ``(m, 2)`` and ``(n, 2)``: ``(m, n)``."""
    offsets = first[:, None] - second[None]
    return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]))


def occupied(points: FloatArray) -> npt.NDArray[np.bool_]:
    """Which cells around the origin hold a point.

    Args:
        points: ``(k, 2)``, metres.

    Returns:
        ``(CELLS, CELLS)``; the first axis is x.
    """
    cells = np.floor((points + RADIUS) / CELL).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < CELLS)).all(axis=1)]
    grid = np.zeros((CELLS, CELLS), dtype=np.bool_)
    grid[cells[:, 0], cells[:, 1]] = True
    return grid


def quarter_turned(occupancy: npt.NDArray[np.bool_], turns: int) -> npt.NDArray[np.bool_]:
    """Occupied cells and their next quarter turns, anticlockwise, as ``quarter_turns`` has it of polar grids.

    Args:
        occupancy: ``(CELLS, CELLS)``; the first axis is x.
        turns: How many, itself included.

    Returns:
        ``(turns, CELLS, CELLS)``.
    """
    return np.stack([np.rot90(occupancy, turn) for turn in range(turns)])


def _places(run: Run, scans: range, public: PublicMap, spacing: float) -> Places:
    at = keyframes(run, scans, spacing)
    around = list(submaps(run, scans, dead_reckoning(run, scans), public.walls, at))
    grids = np.stack([polar_grid(points) for points in around])
    return Places(
        run.poses[scans.start + at, :2],
        grids,
        public.background.describe(grids),
        np.stack([occupied(points) for points in around]),
    )
