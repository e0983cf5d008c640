"""MAC shares of all products of two sets of standing vectors: one bilinear form, not multiplied out.

For the products z_jk = x_j . y_k a party's MAC share is

    m_jk = alpha_i ex_j . ey_k  +  ex_j . my_k  +  mx_j . ey_k  +  (what was dealt),

where ex, ey are the words and mx, my this party's MAC shares of the masks. To check an opening one weighted
sum of all m_jk is enough (:meth:`OuterMac.weighed`), which takes O((R + C) N) instead of O(R C N). So between
the product and the opening the form stays as it is, and linear maps act on its factor and the dealt part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from spdz.arithmetic import field as f
from spdz.arithmetic import inner_product
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import FieldRing
from spdz.arithmetic.weighted import bilinear, weigh_elements, weigh_words
from spdz.foundations.types import FieldArray, Shape
from spdz.values.standing import Standing


@dataclass(frozen=True, slots=True)
class OuterMac:
    """``factor`` times the form above without its dealt part, plus ``rest``.

    Attributes:
        x: Party 0's vectors, the rows.
        y: Party 1's, the columns.
        alpha: This party's share of the MAC key.
        factor: A public integer.
        rest: Elements of shape (R, C).
    """

    x: Standing
    y: Standing
    alpha: int = field(repr=False)
    factor: int
    rest: FieldArray = field(repr=False)

    def elements(self) -> FieldArray:
        """Multiplied out, shape (R, C)."""
        x, y, (mac_x, mac_y) = self.x, self.y, self._macs()
        ex, ey = f.from_int64(x.words)[:, None], f.from_int64(y.words)[None]
        # alpha ex + mx is a share of alpha x.
        of_x = f.add(f.scale(ex, self.alpha), mac_x[:, None])
        form = f.add(inner_product.dot(of_x, ey), inner_product.dot(ex, mac_y[None]))
        return f.add(f.scale(form, self.factor), self.rest)

    def weighed(self, u: FieldArray, v: FieldArray) -> int:
        """sum_jk u_j v_k m_jk mod p, for weights of shape (R,) and (C,)."""
        x, y, (mac_x, mac_y) = self.x, self.y, self._macs()
        ex, ey = weigh_words(u, x.words, x.bits), weigh_words(v, y.words, y.bits)
        of_x = f.add(f.scale(ex, self.alpha), weigh_elements(u, mac_x))
        form = f.add(inner_product.dot(of_x, ey), inner_product.dot(ex, weigh_elements(v, mac_y)))
        return (f.to_int(form) * self.factor + bilinear(u, self.rest, v)) % f.P

    def _macs(self) -> tuple[FieldArray, FieldArray]:
        if self.x.mac is None or self.y.mac is None:
            raise ValueError("there are no MACs in the semi-honest mode")
        return self.x.mac, self.y.mac


class OuterRing(FieldRing):
    """F_p on NumPy words, where a part may be an :class:`OuterMac`; sums and integer factors keep it."""

    def add(self, a: Any, b: Any) -> Any:
        """Elementwise sum mod p."""
        if isinstance(a, OuterMac) or isinstance(b, OuterMac):
            return self._sum(a, b)
        return f.add(a, b)

    def sub(self, a: Any, b: Any) -> Any:
        """Elementwise difference mod p."""
        if isinstance(a, OuterMac) or isinstance(b, OuterMac):
            return self._sum(a, self.neg(b))
        return f.sub(a, b)

    def neg(self, a: Any) -> Any:
        """Elementwise negation mod p."""
        if isinstance(a, OuterMac):
            return replace(a, factor=-a.factor, rest=f.neg(a.rest))
        return f.neg(a)

    def scale(self, a: Any, factor: Raw) -> Any:
        """Elementwise product with public integers mod p."""
        if isinstance(a, OuterMac) and isinstance(factor, int):
            return replace(a, factor=a.factor * factor, rest=f.scale(a.rest, factor))
        return super().scale(_elements(a), factor)

    def sum(self, a: Any, axis: int) -> Any:
        """Sum over one axis mod p."""
        return super().sum(_elements(a), axis)

    def index(self, a: Any, key: tuple[Any, ...]) -> Any:
        """Basic indexing."""
        return super().index(_elements(a), key)

    def reshape(self, a: Any, shape: Shape) -> Any:
        """The same elements in another shape."""
        return super().reshape(_elements(a), shape)

    def broadcast(self, a: Any, shape: Shape) -> Any:
        """A view in a larger shape."""
        if isinstance(a, OuterMac) and a.rest.shape[:-1] == shape:
            return a
        return super().broadcast(_elements(a), shape)

    def concatenate(self, parts: Sequence[Any], shapes: Sequence[Shape]) -> Any:
        """End to end."""
        return super().concatenate([_elements(part) for part in parts], shapes)

    def _sum(self, a: Any, b: Any) -> Any:
        if not isinstance(a, OuterMac):
            a, b = b, a
        if not isinstance(b, OuterMac):
            rest = f.add(a.rest, b)
            return replace(a, rest=rest) if rest.shape == a.rest.shape else f.add(a.elements(), b)
        if a.x is b.x and a.y is b.y:
            return replace(a, factor=a.factor + b.factor, rest=f.add(a.rest, b.rest))
        return replace(a, rest=f.add(a.rest, b.elements()))


def _elements(part: Any) -> Any:
    return part.elements() if isinstance(part, OuterMac) else part
