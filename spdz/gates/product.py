"""Products of masked values: one dealt correction each, no communication.

For masked ``<x> = (eps_x, [[r_x]])`` and ``<y>``::

    [[x y]] = eps_x eps_y + eps_x [[r_y]] + eps_y [[r_x]] + [[r_x r_y]]

and the same for every bilinear contraction: the dot product (one dealt scalar however long the vectors)
and the elementwise product. Source: Beaver, CRYPTO 1991, with the masks dealt for the known function as
in Ben-Efraim, Nielsen, Omri, "Turbospeedz", ACNS 2019. Secure against malicious parties: everything here
is local and under MAC.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from spdz.arithmetic import field, inner_product
from spdz.arithmetic.bound import Bound
from spdz.foundations.types import BigIntArray, FieldArray, IntArray, Shape
from spdz.gates.outer import dealt_products, product_shares, standing_pairs
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe, Share
from spdz.values.outer import OuterMac
from spdz.values.party_ring import PartyRing
from spdz.values.refusals import expect_secret
from spdz.values.standing import Standing
from spdz.values.value import Value


@dataclass(frozen=True, slots=True)
class Contraction:
    """A bilinear map on field arrays, by a party's ring, on integers, and on shapes."""

    kind: str
    product: Callable[[Any, Any], FieldArray]
    by: Callable[[PartyRing], Callable[[Any, Any], FieldArray]]
    clear_product: Callable[[Any, Any], BigIntArray]
    shape: Callable[[Shape, Shape], Shape]
    bound: Callable[[Bound, Bound, Shape], Bound]


def _dot_shape(x: Shape, y: Shape) -> Shape:
    if not x or not y or x[-1] != y[-1] or not x[-1]:
        raise ValueError(f"dot needs last axes of equal length, at least 1, got shapes {x} and {y}")
    return np.broadcast_shapes(x[:-1], y[:-1])


def _clear_dot(x: BigIntArray, y: BigIntArray) -> BigIntArray:
    """Exact integer dot product over the last axis.

    int64 arrays, which are below 2^40 (:func:`spdz.arithmetic.rings.whole`), are split at 20 bits: each
    partial product stays below 2^40, and a sum of up to 2^22 of them below 2^62.
    """
    if x.dtype == object or y.dtype == object or x.shape[-1] > 1 << 22:
        return np.asarray((x.astype(object) * y).sum(axis=-1), dtype=object)
    mask = (1 << 20) - 1
    (x0, x1), (y0, y1) = (x & mask, x >> 20), (y & mask, y >> 20)
    partial = [np.asarray((a * b).sum(axis=-1)).astype(object) for a in (x0, x1) for b in (y0, y1)]
    return np.asarray(partial[0] + (partial[1] + partial[2]) * (1 << 20) + partial[3] * (1 << 40))


DOT = Contraction(
    "dot product",
    inner_product.dot,
    lambda ring: ring.dot,
    _clear_dot,
    _dot_shape,
    Bound.dot,
)
ELEMENTWISE = Contraction(
    "product",
    field.mul,
    lambda ring: ring.product,
    lambda x, y: np.asarray(x.astype(object) * y),
    np.broadcast_shapes,
    Bound.product,
)


def masked_product(party: Evaluation, by: Contraction, x: Value, y: Value, correction: Share) -> Share:
    """The formula of the module's docstring on one party's parts; returns its shares of the product."""
    ring, product = party.ring, by.by(party.ring)
    eps_x, eps_y = x.parts[0], y.parts[0]
    if by is DOT:
        eps_x = ring.prepared(eps_x)
        eps_y = eps_x if x is y else ring.prepared(eps_y)
        if x.plain is not None and y.parts[1] is None:
            return _own_product(party, x.plain, (x, eps_x), (y, eps_y), correction)
        if y.plain is not None and x.parts[1] is None:
            return _own_product(party, y.plain, (y, eps_y), (x, eps_x), correction)

    def cross(i: int) -> FieldArray | None:
        """``eps_x * y_i + eps_y * x_i`` for part i of both."""
        x_i, y_i = x.parts[i], y.parts[i]
        if x is y:
            return None if x_i is None else ring.scale(product(eps_x, x_i), 2)
        left = None if y_i is None else product(eps_x, y_i)
        right = None if x_i is None else product(eps_y, x_i)
        return left if right is None else right if left is None else ring.add(left, right)

    value, mac = correction
    if mac is None or party.alpha is None:
        terms = [cross(1), product(eps_x, eps_y) if party.index == 0 else None]
        return _total(ring, value, terms), None
    public = product(eps_x, eps_y)
    terms = [cross(1), public if party.index == 0 else None]
    return _total(ring, value, terms), _total(ring, mac, [ring.scaled(public, party.alpha), cross(2)])


def _own_product(
    party: Evaluation, raw: IntArray, own: tuple[Value, Any], peer: tuple[Value, Any], correction: Share
) -> Share:
    """The dot product of our own raw input, with its mask, and a value that is wholly the peer's.

    Here ``x = eps_x + r_x`` is known, so that ``eps_x eps_y + r_x eps_y = x eps_y`` is a product with short
    integers, and ``alpha eps_x eps_y + m_x eps_y = alpha x eps_y + (m_x - alpha r_x) eps_y`` for the MAC
    share m_x, where what is in brackets depends on the tape alone.
    """
    ring, (value, mac), (x, eps_x), (y, eps_y) = party.ring, correction, own, peer
    if party.index == 1:
        value = ring.add(value, ring.dot(eps_y, x.parts[1]))
        if mac is None:
            return value, None
    short = ring.short_dot(raw, eps_y)
    if party.index == 0:
        value = ring.add(value, short)
    if mac is None or party.alpha is None:
        return value, None
    bracket = ring.sub(x.parts[2], ring.scaled(x.parts[1], party.alpha))
    terms = (ring.scaled(short, party.alpha), ring.dot(eps_y, bracket), ring.dot(eps_x, y.parts[2]))
    return value, _total(ring, mac, terms)


def _total(ring: PartyRing, start: FieldArray, terms: Iterable[FieldArray | None]) -> FieldArray:
    for term in terms:
        if term is not None:
            start = ring.add(start, term)
    return start


NOT_MASKED = (
    "a product needs masked values; a computed value must be masked again first: `[z] = await spdz.mask(z)`"
)


@dataclass(frozen=True, slots=True)
class Product(Gate):
    """Operands: two masked values."""

    by: Contraction

    def _result(self, x: Value, y: Value) -> tuple[Shape, int, Bound]:
        if not (x.masked and y.masked):
            raise TypeError(NOT_MASKED)
        shape = self.by.shape(x.shape, y.shape)
        return shape, x.frac + y.frac, self.by.bound(x.bound, y.bound, shape)

    def _pairs(self, x: Value, y: Value) -> tuple[Standing, Standing] | None:
        return standing_pairs(x, y) if self.by is DOT else None

    def deal(self, recipe: Recipe, x: Value, y: Value) -> Value:
        """Deal [[r_x r_y]]; of standing vectors party 0 stores it, as party 1 stores more of what follows."""
        shape, frac, bound = self._result(x, y)
        pairs = self._pairs(x, y)

        def make() -> FieldArray:
            return dealt_products(*pairs) if pairs else self.by.product(x.parts[0], y.parts[0])

        count = (self.by.kind, prod(shape))
        recipe.authenticated(shape, make, of=(x, y), count=count, stored_by=0 if pairs else 1)
        return recipe.shared_value(self.by.kind, (x, y), shape, frac, bound)

    def evaluate(self, party: Evaluation, x: Value, y: Value) -> Value:
        """One local contraction a term."""
        shape, frac, bound = self._result(x, y)
        count, pairs = (self.by.kind, prod(shape)), self._pairs(x, y)
        correction = party.authenticated(shape, count=count, stored_by=0 if pairs else 1)
        if pairs:
            shares = field.add(correction[0], product_shares(party.index, *pairs))
            if correction[1] is None or party.alpha is None:
                return Value(party, (shares,), shape, frac, bound)
            return Value(party, (shares, OuterMac(*pairs, party.alpha, 1, correction[1])), shape, frac, bound)
        value, mac = masked_product(party, self.by, x, y, correction)
        return Value(party, (value, mac) if party.malicious else (value,), shape, frac, bound)

    def clear(self, engine: ClearText, x: Value, y: Value) -> Value:
        """The product itself."""
        product = self.by.clear_product(x.parts[0], y.parts[0])
        return engine.value(product, *self._result(x, y)[1:])


def dot(x: Value, y: Value) -> Value:
    """Dot product over the last axis; leading axes broadcast, so (m, 1, N) and (1, k, N) give (m, k).

    Args:
        x: Masked value of shape S + (N,).
        y: Masked value of shape T + (N,).

    Returns:
        ``[[x . y]]`` with the fractional bits of both added up, exact.
    """
    expect_secret("dot", x, y)
    result: Value = x.engine.read(Product(DOT), x, y)
    return result
