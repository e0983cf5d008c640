"""The candidate bit: is the score past the threshold? Nothing else is opened.

For a similarity the bit is ``score >= threshold``, for a distance ``score <= threshold``: the threshold is
rounded to the score's fixed-point grid in the direction that keeps the comparison true. For the exact scores
(S2, S6, S10) the decision is that of the quantised descriptors' exact score, for the others that of the score
as computed. The threshold is public and is no part of what was dealt: it may change from call to call.

Cost on top of the score: one DCF key and one opened bit; one more round if the score is not masked yet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.score import Operand, Score
from spdz import Engine, Value, nonnegative
from spdz.readings.plans import unchanging


@dataclass(frozen=True, slots=True)
class Candidate:
    """The program ``[score >= threshold]`` (or ``<=`` for a distance).

    Attributes:
        score: The score function.
        threshold: Public threshold, in the score's units.
    """

    score: Score
    threshold: float

    def __str__(self) -> str:
        return f"{self.score.name} {'>=' if self.score.similarity else '<='} {self.threshold!r}"

    @property
    def max_norm(self) -> float:
        """The score's."""
        return self.score.max_norm

    @property
    def min_norm(self) -> float:
        """The score's."""
        return self.score.min_norm

    @property
    def prove_norm(self) -> bool:
        """The score's."""
        return self.score.prove_norm

    @unchanging
    async def __call__(self, engine: Engine, x: Value, y: Value, /) -> Value:
        """One comparison of the score with the threshold."""
        return await self._past(await self.score(engine, x, y))

    async def prepare(self, engine: Engine, vectors: Value, /) -> Operand:
        """The score's, in a gallery."""
        return await self.score.prepare(engine, vectors)

    async def compare(self, engine: Engine, x: Operand, y: Operand, /) -> Value:
        """One comparison of the score of every pair with the threshold."""
        return await self._past(await self.score.compare(engine, x, y))

    async def _past(self, z: Value) -> Value:
        exact = Fraction(self.threshold) * (1 << z.frac)
        # No honest score exceeds its bound, so that a threshold further out decides the same as bound + 1.
        limit, bound = z.bound.entry + 1, 2 * z.bound.entry + 1
        if self.score.similarity:
            margin = z.plus_raw(-min(max(math.ceil(exact), -limit), limit))
        else:
            margin = (-z).plus_raw(min(max(math.floor(exact), -limit), limit))
        return await nonnegative(margin, bound)


def is_candidate(score: Score, threshold: float) -> Candidate:
    """The program that reveals whether two descriptors match, and nothing else.

    Args:
        score: A score of :mod:`protocols.scores` or your own.
        threshold: Public and finite.

    Returns:
        A program for :func:`spdz.run_local` or a networked session.

    Raises:
        TypeError: if the score is none, such as a bare function.
        ValueError: if the threshold is not one finite real number.
    """
    if not isinstance(score, Score):
        raise TypeError(
            f"is_candidate takes a score, not {type(score).__name__}: protocols.Score(name, title, "
            "similarity=True, formula=function) makes one of an `async def function(engine, x, y)`"
        )
    if isinstance(threshold, bool) or not isinstance(threshold, (int, float, np.integer, np.floating)):
        raise ValueError("the threshold is one real number for all pairs: call once for each threshold")
    if not math.isfinite(threshold):
        raise ValueError("the threshold must be a finite number")
    return Candidate(score, float(threshold))
