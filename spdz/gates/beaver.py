"""The textbook multiplication: a Beaver triple and two openings.

For shared x, y and a dealt ([[a]], [[b]], [[c]]), c = a b: open d = x - a and e = y - b in one round,
then ``[[x y]] = c + d [[b]] + e [[a]] + d e``. That is the masked product with masks a and b.

Cost: one round, two elements a multiplication; 2N elements and one *vector* triple for a dot product of
any length N. Source: Beaver, CRYPTO 1991; MAC-checked as in Damgard, Pastro, Smart, Zakarias, CRYPTO
2012. It serves programs that the dealer was not told of, and the benchmark compares against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

from spdz.arithmetic.bound import NOTHING, Bound
from spdz.foundations.types import Shape
from spdz.gates.product import DOT, ELEMENTWISE, Contraction, masked_product
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.refusals import expect_secret
from spdz.values.value import Value


@dataclass(frozen=True, slots=True)
class BeaverProduct(Gate):
    """Operands: two values of equal shape."""

    by: Contraction

    def _result(self, x: Value, y: Value) -> tuple[str, Shape, int, Bound]:
        if x.shape != y.shape:
            raise ValueError(f"a Beaver multiplication needs equal shapes, got {x.shape} and {y.shape}")
        kind = "vector triple" if self.by is DOT else "scalar triple"
        shape = self.by.shape(x.shape, y.shape)
        return kind, shape, x.frac + y.frac, self.by.bound(x.bound, y.bound, shape)

    async def deal(self, recipe: Recipe, x: Value, y: Value) -> Value:
        """Deal one triple a product."""
        kind, shape, frac, bound = self._result(x, y)
        recipe.triple(kind, x.shape, shape, self.by.product)
        await recipe.opening(2 * prod(x.shape))
        return recipe.shared_value(f"{kind} {self.by.kind}", (x, y), shape, frac, bound)

    async def evaluate(self, party: Evaluation, x: Value, y: Value) -> Value:
        """Open d and e, then the masked product."""
        kind, shape, frac, bound = self._result(x, y)
        x, y = party.shared(x), party.shared(y)
        a, b, c = party.triple(kind, x.shape, shape)
        width = len(x.parts)
        masks = [Value(party, share[:width], x.shape, v.frac, NOTHING) for share, v in ((a, x), (b, y))]
        opened = await party.open(x - masks[0], y - masks[1])
        left, right = (
            Value(party, (eps, *mask.parts), x.shape, mask.frac, mask.bound, masked=True)
            for eps, mask in zip(opened, masks, strict=True)
        )
        product = masked_product(party, self.by, left, right, c)
        return Value(party, product[:width], shape, frac, bound)

    async def clear(self, engine: ClearText, x: Value, y: Value) -> Value:
        """The product itself."""
        product = self.by.clear_product(x.parts[0], y.parts[0])
        return engine.value(product, *self._result(x, y)[2:])


async def beaver_multiply(x: Value, y: Value) -> Value:
    """Elementwise product with scalar Beaver triples: one round, two elements an entry."""
    expect_secret("beaver_multiply", x, y)
    result: Value = await x.engine.read(BeaverProduct(ELEMENTWISE), x, y)
    return result


async def beaver_dot(x: Value, y: Value) -> Value:
    """Dot product over the last axis with one vector Beaver triple: one round, 2N elements."""
    expect_secret("beaver_dot", x, y)
    result: Value = await x.engine.read(BeaverProduct(DOT), x, y)
    return result
