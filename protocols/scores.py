"""The paper's score functions, each written once and read by party, dealer, clear engine and meter.

| ID  | name      | definition                                   |
|-----|-----------|----------------------------------------------|
| S6  | L2sq_dist | squared L2 distance                          |
| S10 | dotprod   | dot product (cosine of unit vectors)         |

Source: Fishberg, Jia, How, "CILC", table "score functions". A score is a program
(:mod:`spdz.program`): run on its own it opens the score, and :func:`protocols.is_candidate` turns it
into one that opens only the comparison with a threshold.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from protocols.distance import squared_distance
from spdz import Engine, Value, dot
from spdz.fixed_point import MAX_NORM


@dataclass(frozen=True, slots=True)
class Score:
    """A score function of two descriptors.

    Attributes:
        name: Identifier, e.g. ``"S10"``.
        title: The paper's name.
        similarity: True if larger means more alike (candidate: score >= threshold), False for a
            distance (candidate: score <= threshold).
        formula: The protocol on masked descriptors of shape S + (N,).
        max_norm: Largest L2 norm of a descriptor; a smaller one makes the dealt keys smaller.
    """

    name: str
    title: str
    similarity: bool
    formula: Callable[[Engine, Value, Value], Awaitable[Value]]
    max_norm: float = MAX_NORM

    async def __call__(self, engine: Engine, x: Value, y: Value, /) -> Value:
        """Run the formula."""
        return await self.formula(engine, x, y)

    def __str__(self) -> str:
        return f"{self.name} ({self.title})"

    def within(self, max_norm: float) -> Score:
        """The same score for descriptors of at most this norm (1 for normalised descriptors)."""
        return replace(self, max_norm=max_norm)


async def _l2sq_dist(engine: Engine, x: Value, y: Value) -> Value:
    return squared_distance(x, y)


async def _dotprod(engine: Engine, x: Value, y: Value) -> Value:
    return dot(x, y)


S6 = Score("S6", "L2sq_dist", similarity=False, formula=_l2sq_dist)
S10 = Score("S10", "dotprod", similarity=True, formula=_dotprod)

SCORES: dict[str, Score] = {score.name: score for score in (S6, S10)}
