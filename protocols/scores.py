"""The paper's score functions, each written once and read by party, dealer, clear engine and meter.

| ID  | name         | definition                                           |
|-----|--------------|------------------------------------------------------|
| S1  | L1_dist_bar  | L1 distance of the L1-normalised vectors             |
| S2  | L1_dist      | L1 distance                                          |
| S3  | L2_dist_hat  | L2 distance of the L2-normalised vectors             |
| S4  | L2_dist      | L2 distance                                          |
| S5  | L2sq_dist_hat| squared L2 distance of the L2-normalised vectors     |
| S6  | L2sq_dist    | squared L2 distance                                  |
| S7  | cossim_hat   | dot product of the L2-normalised vectors             |
| S8  | cossim_2sqrt | x . y / (sqrt(x . x) sqrt(y . y))                    |
| S9  | cossim_1sqrt | x . y / sqrt((x . x) (y . y)): S8, written otherwise |
| S10 | dotprod      | dot product (cosine of unit vectors)                 |

Source: Fishberg, Jia, How, "CILC", table "score functions". A score is a program
(:mod:`spdz.readings.program`): run on its own it opens the score, and :func:`protocols.is_candidate` turns it
into one that opens only the comparison with a threshold.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from protocols.cosine import cosine
from protocols.distance import difference, squared_distance
from spdz import Engine, Value, absolute, dot, l1_normalised, l2_normalised, sqrt, truncate
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.readings.plans import unchanging
from spdz.readings.program import result_of


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

    @unchanging
    async def __call__(self, engine: Engine, x: Value, y: Value, /) -> Value:
        """Run the formula."""
        return await result_of("score", self.formula, engine, x, y)

    def __str__(self) -> str:
        return f"{self.name} ({self.title})"

    def within(self, max_norm: float) -> Score:
        """The same score for descriptors of at most this norm (1 for normalised descriptors)."""
        return replace(self, max_norm=max_norm)


async def rounded(z: Value) -> Value:
    """A score in 24 fractional bits: what it is opened with."""
    (result,) = await truncate(z.rescaled(max(z.frac, 24)), frac=24)
    return result


async def _l1_dist_bar(engine: Engine, x: Value, y: Value) -> Value:
    x, y = await l1_normalised(x, y)
    return (await absolute(x - y)).sum()


async def _l1_dist(engine: Engine, x: Value, y: Value) -> Value:
    return (await absolute(difference(x, y))).sum()


async def _l2_dist_hat(engine: Engine, x: Value, y: Value) -> Value:
    x, y = await l2_normalised(x, y)
    return await sqrt(squared_distance(x, y))


async def _l2_dist(engine: Engine, x: Value, y: Value) -> Value:
    return await sqrt(squared_distance(x, y))


async def _l2sq_dist_hat(engine: Engine, x: Value, y: Value) -> Value:
    x, y = await l2_normalised(x, y)
    return await rounded(squared_distance(x, y))


async def _l2sq_dist(engine: Engine, x: Value, y: Value) -> Value:
    return squared_distance(x, y)


async def _cossim_hat(engine: Engine, x: Value, y: Value) -> Value:
    x, y = await l2_normalised(x, y)
    return await rounded(dot(x, y))


async def _cossim(engine: Engine, x: Value, y: Value) -> Value:
    return await rounded(await cosine(x, y))


async def _dotprod(engine: Engine, x: Value, y: Value) -> Value:
    return dot(x, y)


S1 = Score("S1", "L1_dist_bar", similarity=False, formula=_l1_dist_bar)
S2 = Score("S2", "L1_dist", similarity=False, formula=_l1_dist)
S3 = Score("S3", "L2_dist_hat", similarity=False, formula=_l2_dist_hat)
S4 = Score("S4", "L2_dist", similarity=False, formula=_l2_dist)
S5 = Score("S5", "L2sq_dist_hat", similarity=False, formula=_l2sq_dist_hat)
S6 = Score("S6", "L2sq_dist", similarity=False, formula=_l2sq_dist)
S7 = Score("S7", "cossim_hat", similarity=True, formula=_cossim_hat)
S8 = Score("S8", "cossim_2sqrt", similarity=True, formula=_cossim)
S9 = Score("S9", "cossim_1sqrt", similarity=True, formula=_cossim)
S10 = Score("S10", "dotprod", similarity=True, formula=_dotprod)

SCORES: dict[str, Score] = {score.name: score for score in (S1, S2, S3, S4, S5, S6, S7, S8, S9, S10)}

for _score in SCORES.values():
    unchanging(_score.formula)
