"""Where a robot was, step by step, from what is known of each place and of each step: a Bayes filter.

The state is a cell of a grid over the building. Forward and backward passes (Rabiner, "A tutorial on hidden
Markov models", Proc. IEEE 1989, section III) give each step's posterior; a step is a convolution, by FFT.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.attacks.motion import SHIFTS
from bench.attacks.world import CELL, distances
from spdz.foundations.types import FloatArray, IntArray

_MARGIN = 40.0
"""Metres around the own path in which the other robot is looked for."""
_MODE = 3.0
"""An estimate is the mean of the posterior within so many metres of its peak."""
_FLOOR = 1e-12
"""Mass that every cell keeps, so that evidence which contradicts itself does not end the track."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Cells of 0.5 m over a building, turned to its walls.

    Attributes:
        origin: ``(2,)``, metres: the first cell's centre.
        shape: Cells along either axis.
    """

    origin: FloatArray
    shape: tuple[int, int]

    @staticmethod
    def around(points: FloatArray) -> Floor:
        """The cells around points ``(k, 2)``, metres, turned to the walls."""
        low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
        rows, columns = (int(cells) for cells in np.ceil((high - low) / CELL))
        return Floor(low, (rows, columns))

    @property
    def centres(self) -> FloatArray:
        """``(rows * columns, 2)``, metres."""
        return self.origin + CELL * np.argwhere(np.ones(self.shape, dtype=np.bool_))

    def nearest(self, points: FloatArray) -> tuple[IntArray, FloatArray]:
        """Of each cell the nearest of points ``(k, 2)``, and how far that is in metres."""
        rows = [distances(row, points) for row in self.centres.reshape(*self.shape, 2)]
        return (
            np.concatenate([row.argmin(axis=1) for row in rows]),
            np.concatenate([row.min(axis=1) for row in rows]),
        )

    def track(self, steps: FloatArray, evidence: Sequence[FloatArray]) -> FloatArray:
        """Estimated positions.

        Args:
            steps: ``(n - 1, 2 SHIFTS + 1, 2 SHIFTS + 1)``: how likely each shift is, sum 1.
            evidence: Of each of n places: how likely what was seen is in each cell, ``(rows * columns,)``.

        Returns:
            ``(n, 2)``, metres, turned to the walls.
        """
        seen = [one.reshape(self.shape) for one in evidence]
        ahead = [seen[0] / seen[0].sum()]
        for step, one in zip(steps, seen[1:], strict=True):
            mass = self._spread(ahead[-1], step) * one
            ahead.append(mass / mass.sum() + _FLOOR)
        behind, centres = np.ones(self.shape), self.centres
        found = np.empty((len(seen), 2))
        for i in reversed(range(len(seen))):
            posterior = (ahead[i] * behind).ravel()
            near = np.linalg.norm(centres - centres[posterior.argmax()], axis=1) < _MODE
            found[i] = posterior[near] @ centres[near] / posterior[near].sum()
            if i:
                behind = self._spread(behind * seen[i], steps[i - 1][::-1, ::-1])
                behind /= behind.sum()
        return found

    def _spread(self, mass: FloatArray, step: FloatArray) -> FloatArray:
        """Move mass by a step, by FFT; what leaves the floor is lost."""
        size = [_smooth(cells + 2 * SHIFTS) for cells in self.shape]
        moved = np.fft.irfft2(np.fft.rfft2(mass, size) * np.fft.rfft2(step, size), size)
        inside = moved[SHIFTS : SHIFTS + self.shape[0], SHIFTS : SHIFTS + self.shape[1]]
        return np.maximum(inside, 0)


def _smooth(least: int) -> int:
    """The next length that is a product of twos, threes and fives: a quick one to transform."""
    size = least
    while True:
        rest = size
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return size
        size += 1
