"""Products of any number of masked values, elementwise: one dealt correction for each way to choose masks.

For masked ``<x_i> = (c_i, r_i)``, i = 1 .. m, multiplied out::

    prod (c_i + r_i) = sum over subsets S of  prod_{i not in S} c_i  *  [[prod_{i in S} r_i]]

The corrections with two masks or more are dealt, 2^m - 1 - m of them. Each has the broadcast shape of *its*
factors only, so a scalar times a vector of N entries costs N elements and not a word more.

Cost: no round. Source: Beaver, CRYPTO 1991, as in :mod:`spdz.gates.product`; several factors as in Ohata,
Nuida, "Communication-efficient (client-aided) secure two-party protocols", FC 2020. Secure against malicious
parties: local and under MAC.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from math import prod

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.element import Element
from spdz.arithmetic.public import limit
from spdz.foundations.types import FieldArray, Shape
from spdz.gates.masking import tightened
from spdz.gates.product import NOT_MASKED
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.refusals import expect_secret
from spdz.values.value import Value

KIND = "product"

Subset = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Monomial(Gate):
    """Operands: masked values whose shapes broadcast; ``entry`` and ``norm`` bound the product if known."""

    entry: float | None
    norm: float | None

    def _result(self, factors: tuple[Value, ...]) -> tuple[Shape, int, Bound]:
        if not all(factor.masked for factor in factors):
            raise TypeError(NOT_MASKED)
        shape = np.broadcast_shapes(*(factor.shape for factor in factors))
        frac = sum(factor.frac for factor in factors)
        bound = tightened(
            Bound.of_entry(prod(factor.bound.entry for factor in factors), shape),
            *(
                None if known is None else limit(known, frac, name)
                for known, name in ((self.entry, "entry"), (self.norm, "norm"))
            ),
        )
        return shape, frac, bound

    def deal(self, recipe: Recipe, *factors: Value) -> Value:
        """Deal the products of two masks and more."""
        shape, frac, bound = self._result(factors)
        for subset in _subsets(len(factors)):
            chosen = [factors[i] for i in subset]
            recipe.authenticated(
                _shape(chosen),
                lambda chosen=chosen: reduce(field.mul, (factor.parts[0] for factor in chosen)),  # type: ignore[misc]
                of=tuple(chosen),
                count=(KIND, prod(shape)) if len(subset) == len(factors) else None,
            )
        return recipe.shared_value(KIND, factors, shape, frac, bound)

    def evaluate(self, party: Evaluation, *factors: Value) -> Value:
        """Sum over the subsets."""
        shape, frac, bound = self._result(factors)
        everything, width = range(len(factors)), len(factors[0].parts) - 1
        shares: dict[Subset, Sequence[FieldArray | None]] = {(i,): factors[i].parts[1:] for i in everything}
        for subset in _subsets(len(factors)):
            count = (KIND, prod(shape)) if len(subset) == len(factors) else None
            shares[subset] = party.authenticated(_shape([factors[i] for i in subset]), count=count)
        ring = party.ring
        times, total, unpacked = ring.times, ring.total, ring.unpacked
        eps = [unpacked(factor.parts[0]) for factor in factors]
        # What the largest c multiplies is summed first: arrays are multiplied as seldom as possible.
        big = max(everything, key=lambda i: prod(factors[i].shape))
        inside: list[list[Element]] = [[] for _ in range(width)]
        outside: list[list[Element]] = [[] for _ in range(width)]
        for subset, parts in shares.items():
            others = [eps[i] for i in everything if i not in subset and i != big]
            for j, part in enumerate(parts[:width]):
                if part is not None:
                    term = times(reduce(times, others), unpacked(part)) if others else unpacked(part)
                    (outside if big in subset else inside)[j].append(term)
        sums = [
            total([*alone, times(eps[big], total(common))])
            for alone, common in zip(outside, inside, strict=True)
        ]
        result = Value(party, tuple(ring.packed(one, shape) for one in sums), shape, frac, bound)
        public = reduce(times, [eps[i] for i in everything if i != big])
        return party.plus_public(result, ring.packed(times(eps[big], public), shape))

    def clear(self, engine: ClearText, *factors: Value) -> Value:
        """The product itself."""
        shape, frac, bound = self._result(factors)
        exact = reduce(lambda a, b: a * b, (np.asarray(f.parts[0]).astype(object) for f in factors))
        return engine.value(np.broadcast_to(np.asarray(exact, dtype=object), shape), frac, bound)


def _subsets(m: int) -> Iterable[Subset]:
    """All subsets of two and more of m factors."""
    return (subset for size in range(2, m + 1) for subset in combinations(range(m), size))


def _shape(factors: list[Value]) -> Shape:
    return np.broadcast_shapes(*(factor.shape for factor in factors))


def multiply(*factors: Value, entry: float | None = None, norm: float | None = None) -> Value:
    """Product of two or more masked values, elementwise with broadcasting, exact.

    Args:
        factors: Masked values; the fractional bits of the result are all of theirs added up.
        entry: The largest magnitude of an entry that an honest run can give, as a real number, where the
            caller knows better than the product of the factors' bounds. It is believed.
        norm: The same for the L2 norm along the last axis.

    Returns:
        The shared product.

    Raises:
        ValueError: if a bound is negative or not finite, or the shapes do not broadcast.
    """
    expect_secret("multiply", *factors)
    if len(factors) < 2:
        raise ValueError("a product takes two factors or more")
    result: Value = factors[0].engine.read(Monomial(entry, norm), *factors)
    return result
