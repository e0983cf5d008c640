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
from math import comb, prod

import numpy as np

from spdz import field
from spdz.bound import Bound
from spdz.engine import ClearText, Evaluation, Gate, Recipe
from spdz.field import P
from spdz.types import BigIntArray, FieldArray
from spdz.value import Value

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
            return np.stack(powers[1:] + [field.mul(factor, power) for power in powers])

        recipe.authenticated((2 * n - 1, *shape), make, of=(w, y), count=(KIND, prod(shape)))
        return recipe.shared_value(f"{KIND} {self}", (w, y), shape, *self._form(w))

    def _form(self, w: Value) -> tuple[int, Bound]:
        return w.frac + self.frac, Bound.of_entry(self.entry, w.shape)

    def evaluate(self, party: Evaluation, w: Value, y: Value) -> Value:
        """The sum of the module's docstring."""
        n, shape = self._degree, y.shape
        dealt = party.authenticated((2 * n - 1, *shape), count=(KIND, prod(shape)))
        taylor = _taylor(self.coefficients, field.to_ints(y.parts[0]))
        scaled = [row * field.to_ints(w.parts[0]) % P for row in taylor]
        shares = []
        for j in range(len(y.parts) - 1):
            corrections = dealt[j]
            assert corrections is not None
            powers, products = np.split(field.to_ints(corrections), [n - 1])
            # r, r^2 .. r^n for w's public part; l, l r .. l r^n for its mask.
            total = scaled[1] * field.to_ints(y.parts[1 + j]) + taylor[0] * field.to_ints(w.parts[1 + j])
            for weight, power in zip([*scaled[2:], *taylor[1:]], [*powers, *products], strict=True):
                total = total + weight * power
            shares.append(field.from_ints(total))
        result = Value(party, tuple(shares), shape, *self._form(w))
        return party.plus_public(result, field.from_ints(scaled[0]))

    def clear(self, engine: ClearText, w: Value, y: Value) -> Value:
        """Horner's rule."""
        raw = np.asarray(y.parts[0]).astype(object)
        total = raw * 0 + self.coefficients[-1]
        for a in self.coefficients[-2::-1]:
            total = total * raw + a
        return engine.value(total * np.asarray(w.parts[0]).astype(object), *self._form(w))


def _taylor(coefficients: tuple[int, ...], c: BigIntArray) -> list[BigIntArray]:
    """``p^(j)(c) / j!`` mod p for j = 0 .. n, by Horner's rule.

    On Python integers: there is one entry a vector, for which they are faster than the array kernels.
    """
    n = len(coefficients) - 1
    rows = []
    for j in range(n + 1):
        total = np.full(c.shape, coefficients[n] * comb(n, j), dtype=object)
        for k in range(n - 1, j - 1, -1):
            total = (total * c + coefficients[k] * comb(k, j)) % P
        rows.append(total)
    return rows


def polynomial(w: Value, y: Value, coefficients: tuple[int, ...], frac: int, entry: int) -> Value:
    """``w (a_0 + a_1 y + .. + a_n y^n)``, elementwise and exact on raw integers; n >= 1.

    Args:
        w: Masked value.
        y: Masked value of the same shape.
        coefficients: a_0 .. a_n, public raw integers.
        frac: Fractional bits that the polynomial's value has.
        entry: A public bound on the result's magnitude, in raw units.

    Returns:
        The shared result.
    """
    if not (w.masked and y.masked) or w.shape != y.shape:
        raise TypeError("a polynomial needs a masked factor and a masked argument of one shape")
    result: Value = y.engine.read(Polynomial(tuple(coefficients), frac, entry), w, y)
    return result
