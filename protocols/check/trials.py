"""What is tried on descriptors in one form: random, all-equal, foreign and their own ones, at a threshold."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from protocols.check.clear_scores import score_table, threshold_cosine, unit
from protocols.check.spread import bits_until, effective_dimension
from protocols.check.standing import Form
from protocols.scores import SCORES
from spdz.foundations.types import FloatArray

RARE = 1e-4
"""Share of pairs of different places that a useful threshold lets match."""
NEAR = 0.9
"""The cosine that probe bits are counted until."""
_RANDOM = 1000
"""Random unit vectors that are tried."""


@dataclass(frozen=True, slots=True)
class Trials:
    """What is tried.

    Attributes:
        score: Name of the score.
        norm: Of the vectors that are brought.
        neighbours: Rows at most so far apart may show one place.
        seed: Of the random vectors.
    """

    score: str
    norm: float
    neighbours: int
    seed: int

    def form(
        self, rows: FloatArray, following: FloatArray, foreign: FloatArray | None, threshold: float | None
    ) -> Form:
        """How rows stand at a threshold.

        Args:
            rows: ``(n, N)``.
            following: ``(n, N)``, of each row the one that came next.
            foreign: ``(m, N)``, of another place, if there are any.
            threshold: Of a match; None to try nothing.
        """
        dim, useful = rows.shape[1], self.thresholds(rows, following, foreign)
        dimension = effective_dimension(rows, self.neighbours)
        if threshold is None:
            return Form(dimension, None, None, None, None, None, useful)
        cosine = threshold_cosine(self.score, threshold, self.norm)
        generator = np.random.default_rng(self.seed)
        random = unit(generator.standard_normal((_RANDOM, dim))) * self.norm
        equal = np.full((2, dim), self.norm / sqrt(dim)) * np.array([[1.0], [-1.0]])
        return Form(
            effective_dimension=dimension,
            random=self._share(random, rows, threshold),
            equal=float(self._matches(equal, rows, threshold).mean(axis=1).max()),
            foreign=None if foreign is None else self._share(foreign, rows, threshold),
            own=float(self._matches(rows, rows, threshold)[self._apart(len(rows))].mean()),
            bits=None if cosine is None else bits_until(NEAR, cosine, dimension),
            thresholds=useful,
        )

    def thresholds(
        self, rows: FloatArray, following: FloatArray, foreign: FloatArray | None
    ) -> tuple[float, float] | None:
        """Where a threshold makes sense, the laxer end first; None if there is no such place.

        It lets at most one pair in 10^4 of different places match (foreign ones, if there are any; else rows
        that are no neighbours), and half of the direct neighbours at least, which overlap.
        """
        near = np.diagonal(score_table(self.score, rows, following))
        different = (
            score_table(self.score, rows, rows)[self._apart(len(rows))]
            if foreign is None
            else score_table(self.score, foreign, rows).ravel()
        )
        if SCORES[self.score].similarity:
            lax, strict = float(np.quantile(different, 1 - RARE)), float(np.median(near))
            return (lax, strict) if lax < strict else None
        lax, strict = float(np.quantile(different, RARE)), float(np.median(near))
        return (lax, strict) if lax > strict else None

    def _apart(self, count: int) -> npt.NDArray[np.bool_]:
        index = np.arange(count)
        return np.asarray(np.abs(np.subtract.outer(index, index)) > self.neighbours)

    def _matches(self, x: FloatArray, y: FloatArray, threshold: float) -> npt.NDArray[np.bool_]:
        scores = score_table(self.score, x, y)
        return np.asarray(
            scores >= threshold if SCORES[self.score].similarity else scores <= threshold, dtype=np.bool_
        )

    def _share(self, x: FloatArray, y: FloatArray, threshold: float) -> float:
        return float(self._matches(x, y, threshold).mean())
