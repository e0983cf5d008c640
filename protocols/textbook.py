"""The textbook protocols that the masked-input ones are measured against.

Inputs are shared, then opened again under a Beaver triple: three elements a coordinate in each
direction instead of one. As in the paper's cost table.
"""

from protocols.scores import Score
from spdz import Engine, Value, beaver_dot, beaver_multiply
from spdz.readings.plans import unchanging


async def dot_with_vector_triple(engine: Engine, x: Value, y: Value) -> Value:
    """Dot product with one vector triple: one round after the input's, 2N elements."""
    return await beaver_dot(x, y)


async def dot_with_scalar_triples(engine: Engine, x: Value, y: Value) -> Value:
    """The naive dot product of two vectors: N multiplications one after the other, N rounds."""
    products = [await beaver_multiply(x[i : i + 1], y[i : i + 1]) for i in range(x.shape[-1])]
    total = products[0]
    for product in products[1:]:
        total = total + product
    return total.sum()


async def squared_distance_with_vector_triple(engine: Engine, x: Value, y: Value) -> Value:
    """Squared distance with one vector triple."""
    difference = x - y
    return await beaver_dot(difference, difference)


TEXTBOOK = {
    "S6": Score(
        "S6", "L2sq_dist, vector triple", similarity=False, formula=squared_distance_with_vector_triple
    ),
    "S10": Score("S10", "dotprod, vector triple", similarity=True, formula=dot_with_vector_triple),
}
"""The textbook protocol of each score that has one, by the score's name."""

for _score in TEXTBOOK.values():
    unchanging(_score.formula)
