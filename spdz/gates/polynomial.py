"""Polynomials of a masked value, times a masked factor: the powers of the mask are dealt.

For ``<y> = (c, r)`` and ``<w> = (d, l)``, with ``p^(j)`` the j-th derivative of p::

    w p(y) = (d + l) sum_j  p^(j)(c) / j!  r^j

which is linear in ``[[r^j]]`` and ``[[l r^j]]`` with public coefficients.

Cost: no round; 2 n - 1 dealt elements an entry for degree n. Source: Beaver, CRYPTO 1991, multiplied out with
powers of the mask as in Ohata, Nuida, FC 2020 (:mod:`spdz.gates.monomial`). Secure against malicious parties:
local and under MAC.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import comb, prod

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.element import Element
from spdz.foundations.types import FieldArray
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.party_ring import PartyRing
from spdz.values.value import Value

KIND = "polynomial"


@dataclass(frozen=True, slots=True)
class Polynomial(Gate):
    """Operands: w and y, masked and of one shape."""

    coefficients: tuple[int, ...]
    """a_0 .. a_n, raw integers."""
    frac: int
    """Fractional bits of p(y)."""
    entry: int
    """Largest magnitude of an honest w p(y), in raw units."""

    @property
    def _degree(self) -> int:
        return len(self.coefficients) - 1

    def deal(self, recipe: Recipe, w: Value, y: Value) -> Value:
        """Deal r^2 .. r^n and l r .. l r^n."""
        n, shape = self._degree, y.shape

        def make() -> FieldArray:
            r, factor = y.parts[0], w.parts[0]
            powers = [r]
            while len(powers) < n:
                powers.append(field.mul(powers[-1], r))
            return np.stack(powers[1:] + [field.mul(factor, power) for power in powers], axis=-2)

        recipe.authenticated((*shape, 2 * n - 1), make, of=(w, y), count=(KIND, prod(shape)))
        return recipe.shared_value(f"{KIND} {self}", (w, y), shape, *self._form(w))

    def _form(self, w: Value) -> tuple[int, Bound]:
        return w.frac + self.frac, Bound.of_entry(self.entry, w.shape)

    def evaluate(self, party: Evaluation, w: Value, y: Value) -> Value:
        """The sum of the module's docstring."""
        ring, shape, width = party.ring, y.shape, len(y.parts) - 1
        dealt = party.authenticated((*shape, 2 * self._degree - 1), count=(KIND, prod(shape)))
        nothing = ring.zeros(shape)  # the share of an input's mask at the peer
        columns = [nothing if part is None else part for part in (*w.parts, *y.parts)]
        for share in dealt[:width]:
            columns += [ring.index(share, (..., k)) for k in range(2 * self._degree - 1)]
        entry = partial(self._entry, ring, width)
        public, *shares = ring.entry_by_entry(entry, columns, shape)
        return party.plus_public(Value(party, tuple(shares), shape, *self._form(w)), public)

    def _entry(self, ring: PartyRing, width: int, *columns: Element) -> list[Element]:
        """The part of w p(y) outside the masks, and this party's shares of the rest.

        The columns are d and l's shares, c and r's shares, then r^2 .. r^n and l r .. l r^n for each share.
        """
        n = self._degree
        (d, *of_w), (c, *of_y) = columns[: width + 1], columns[width + 1 : 2 * width + 2]
        taylor = _taylor(ring, self.coefficients, c)
        scaled = [ring.times(row, d) for row in taylor]
        results = [scaled[0]]
        for j in range(width):
            start = 2 * width + 2 + j * (2 * n - 1)
            powers, products = columns[start : start + n - 1], columns[start + n - 1 : start + 2 * n - 1]
            # r .. r^n for w's public part; l .. l r^n for its mask.
            pairs = zip([*scaled[1:], *taylor], [of_y[j], *powers, of_w[j], *products], strict=True)
            results.append(ring.total([ring.times(weight, share) for weight, share in pairs]))
        return results

    def clear(self, engine: ClearText, w: Value, y: Value) -> Value:
        """Horner's rule."""
        raw = np.asarray(y.parts[0]).astype(object)
        total = raw * 0 + self.coefficients[-1]
        for a in self.coefficients[-2::-1]:
            total = total * raw + a
        return engine.value(total * np.asarray(w.parts[0]).astype(object), *self._form(w))


def _taylor(ring: PartyRing, coefficients: tuple[int, ...], c: Element) -> list[Element]:
    """``p^(j)(c) / j!`` for j = 0 .. n, by Horner's rule."""
    n = len(coefficients) - 1
    rows = []
    for j in range(n + 1):
        row: Element = comb(n, j) * coefficients[n]
        for k in range(n - 1, j - 1, -1):
            row = ring.total([ring.times(row, c), comb(k, j) * coefficients[k]])
        rows.append(row)
    return rows


def polynomial(w: Value, y: Value, coefficients: tuple[int, ...], frac: int, entry: int) -> Value:
    """``w (a_0 + a_1 y + .. + a_n y^n)``, elementwise and exact on raw integers; n >= 1.

    Args:
        w: Masked value.
        y: Masked value of the same shape.
        coefficients: a_0 .. a_n, public raw integers.
        frac: Fractional bits that the polynomial's value has.
        entry: A public bound on the result's magnitude, in raw units. It is believed.

    Returns:
        The shared result.
    """
    if not (w.masked and y.masked) or w.shape != y.shape:
        raise TypeError("a polynomial needs a masked factor and a masked argument of one shape")
    if entry < 0:
        raise ValueError(f"the bound on a polynomial's magnitude cannot be negative, got {entry}")
    result: Value = y.engine.read(Polynomial(tuple(coefficients), frac, entry), w, y)
    return result
