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

from protocols.cosine import cosine, cosine_of, inverse_norm
from protocols.distance import difference, squared_distance, squared_distance_of
from protocols.score import Of, Operand, Score
from spdz import Engine, Value, absolute, dot, l1_normalised, l2_normalised, sqrt, truncate
from spdz.readings.plans import unchanging

__all__ = ["S1", "S2", "S3", "S4", "S5", "S6", "S7", "S8", "S9", "S10", "SCORES", "Score", "rounded"]


async def rounded(z: Value) -> Value:
    """A score in 24 fractional bits: what it is opened with."""
    (result,) = await truncate(z.rescaled(max(z.frac, 24)), frac=24)
    return result


# -- what a job computes ---------------------------------------------------------------------------------


@unchanging
async def _l1_dist_bar(engine: Engine, x: Value, y: Value) -> Value:
    return await _l1_dist(engine, *await l1_normalised(x, y))


@unchanging
async def _l1_dist(engine: Engine, x: Value, y: Value) -> Value:
    return (await absolute(difference(x, y))).sum()


@unchanging
async def _l2_dist_hat(engine: Engine, x: Value, y: Value) -> Value:
    return await _l2_dist(engine, *await l2_normalised(x, y))


@unchanging
async def _l2_dist(engine: Engine, x: Value, y: Value) -> Value:
    return await sqrt(squared_distance(x, y))


@unchanging
async def _l2sq_dist_hat(engine: Engine, x: Value, y: Value) -> Value:
    return await rounded(squared_distance(*await l2_normalised(x, y)))


@unchanging
async def _l2sq_dist(engine: Engine, x: Value, y: Value) -> Value:
    return squared_distance(x, y)


@unchanging
async def _cossim_hat(engine: Engine, x: Value, y: Value) -> Value:
    return await _rounded_dotprod(engine, *await l2_normalised(x, y))


@unchanging
async def _cossim(engine: Engine, x: Value, y: Value) -> Value:
    return await rounded(await cosine(x, y))


@unchanging
async def _dotprod(engine: Engine, x: Value, y: Value) -> Value:
    return dot(x, y)


@unchanging
async def _rounded_dotprod(engine: Engine, x: Value, y: Value) -> Value:
    return await rounded(dot(x, y))


# -- what a gallery prepares of a slot, and compares of two ----------------------------------------------


@unchanging
async def _bar(engine: Engine, x: Value) -> Operand:
    return tuple(await l1_normalised(x))


@unchanging
async def _hat(engine: Engine, x: Value) -> Operand:
    return tuple(await l2_normalised(x))


@unchanging
async def _hat_and_square(engine: Engine, x: Value) -> Operand:
    (hat,) = await l2_normalised(x)
    return hat, dot(hat, hat)


@unchanging
async def _square(engine: Engine, x: Value) -> Operand:
    return (dot(x, x),)


@unchanging
async def _inverse_norm(engine: Engine, x: Value) -> Operand:
    return await inverse_norm(x)


@unchanging
async def _l2_apart(engine: Engine, x: Operand, y: Operand) -> Value:
    return await sqrt(squared_distance_of(x, y))


@unchanging
async def _l2sq_apart_hat(engine: Engine, x: Operand, y: Operand) -> Value:
    return await rounded(squared_distance_of(x, y))


@unchanging
async def _l2sq_apart(engine: Engine, x: Operand, y: Operand) -> Value:
    return squared_distance_of(x, y)


@unchanging
async def _cosine_of(engine: Engine, x: Operand, y: Operand) -> Value:
    return await rounded(await cosine_of(x, y))


S1 = Score("S1", "L1_dist_bar", False, _l1_dist_bar, prepare=_bar, compare=Of(_l1_dist))
S2 = Score("S2", "L1_dist", False, _l1_dist)
S3 = Score("S3", "L2_dist_hat", False, _l2_dist_hat, prepare=_hat_and_square, compare=_l2_apart)
S4 = Score("S4", "L2_dist", False, _l2_dist, prepare=_square, compare=_l2_apart)
S5 = Score("S5", "L2sq_dist_hat", False, _l2sq_dist_hat, prepare=_hat_and_square, compare=_l2sq_apart_hat)
S6 = Score("S6", "L2sq_dist", False, _l2sq_dist, prepare=_square, compare=_l2sq_apart)
S7 = Score("S7", "cossim_hat", True, _cossim_hat, prepare=_hat, compare=Of(_rounded_dotprod))
S8 = Score("S8", "cossim_2sqrt", True, _cossim, prepare=_inverse_norm, compare=_cosine_of)
S9 = Score("S9", "cossim_1sqrt", True, _cossim, prepare=_inverse_norm, compare=_cosine_of)
S10 = Score("S10", "dotprod", True, _dotprod)

SCORES: dict[str, Score] = {score.name: score for score in (S1, S2, S3, S4, S5, S6, S7, S8, S9, S10)}
