"""The arithmetic that a linear map of a value acts with, one implementation a reading.

A :class:`~spdz.value.Value` is a tuple of parts, and every linear map acts on all of them alike. What a
part *is* differs: field elements for a party and for the dealer, exact integers in the clear.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from spdz import field
from spdz.types import BigIntArray, FieldArray, IntArray, Shape


class Ring(Protocol):
    """Linear operations on one part. ``shape`` never counts the limb axis of a field array."""

    def add(self, a: Any, b: Any) -> Any:
        """Elementwise sum, broadcasting."""

    def sub(self, a: Any, b: Any) -> Any:
        """Elementwise difference, broadcasting."""

    def neg(self, a: Any) -> Any:
        """Elementwise negation."""

    def scale(self, a: Any, factor: int | IntArray) -> Any:
        """Elementwise product with public integers, broadcasting."""

    def sum(self, a: Any, axis: int) -> Any:
        """Sum over one axis, given as a non-negative number."""

    def index(self, a: Any, key: tuple[Any, ...]) -> Any:
        """Basic indexing, as in NumPy."""

    def reshape(self, a: Any, shape: Shape) -> Any:
        """The same elements in another shape."""

    def broadcast(self, a: Any, shape: Shape) -> Any:
        """A view in a larger shape."""

    def concatenate(self, parts: Sequence[Any], shapes: Sequence[Shape]) -> Any:
        """End to end along the first axis; a part that is None counts as zeros of its shape."""


class FieldRing:
    """F_p on NumPy words."""

    def add(self, a: FieldArray, b: FieldArray) -> FieldArray:
        """Elementwise sum mod p."""
        return field.add(a, b)

    def sub(self, a: FieldArray, b: FieldArray) -> FieldArray:
        """Elementwise difference mod p."""
        return field.sub(a, b)

    def neg(self, a: FieldArray) -> FieldArray:
        """Elementwise negation mod p."""
        return field.neg(a)

    def scale(self, a: FieldArray, factor: int | IntArray) -> FieldArray:
        """Elementwise product with public integers mod p."""
        if isinstance(factor, int):
            return field.scale(a, factor)
        return field.mul(a, field.from_int64(factor))

    def sum(self, a: FieldArray, axis: int) -> FieldArray:
        """Sum over one axis mod p."""
        return field.sum(a, axis)

    def index(self, a: FieldArray, key: tuple[Any, ...]) -> FieldArray:
        """Basic indexing; the limb axis stays."""
        words = (*key, slice(None)) if Ellipsis in key else key
        return np.asarray(a[words])

    def reshape(self, a: FieldArray, shape: Shape) -> FieldArray:
        """The same elements in another shape."""
        return a.reshape((*shape, 2))

    def broadcast(self, a: FieldArray, shape: Shape) -> FieldArray:
        """A view in a larger shape."""
        return a if a.shape[:-1] == shape else np.broadcast_to(a, (*shape, 2))

    def concatenate(self, parts: Sequence[FieldArray | None], shapes: Sequence[Shape]) -> FieldArray:
        """End to end."""
        pairs = zip(parts, shapes, strict=True)
        return np.concatenate([field.zeros(shape) if part is None else part for part, shape in pairs])


def _exact(a: BigIntArray) -> BigIntArray:
    """Leave int64 arrays whose entries are below 2^62 (a sum of two cannot wrap), else Python integers."""
    if a.dtype != object and a.size and max(int(a.max()), -int(a.min())) >= 1 << 62:
        return a.astype(object)
    return a


class IntegerRing:
    """Exact integers: ``int64`` inputs and Python integers in object arrays."""

    def add(self, a: BigIntArray, b: BigIntArray) -> BigIntArray:
        """Elementwise sum."""
        return np.asarray(_exact(a) + _exact(b))

    def sub(self, a: BigIntArray, b: BigIntArray) -> BigIntArray:
        """Elementwise difference."""
        return np.asarray(_exact(a) - _exact(b))

    def neg(self, a: BigIntArray) -> BigIntArray:
        """Elementwise negation."""
        return np.asarray(-a)

    def scale(self, a: BigIntArray, factor: int | IntArray) -> BigIntArray:
        """Elementwise product with public integers."""
        return np.asarray(a.astype(object) * factor)

    def sum(self, a: BigIntArray, axis: int) -> BigIntArray:
        """Sum over one axis."""
        return np.asarray(a.astype(object).sum(axis=axis))

    def index(self, a: BigIntArray, key: tuple[Any, ...]) -> BigIntArray:
        """Basic indexing."""
        return np.asarray(a[key])

    def reshape(self, a: BigIntArray, shape: Shape) -> BigIntArray:
        """The same elements in another shape."""
        return a.reshape(shape)

    def broadcast(self, a: BigIntArray, shape: Shape) -> BigIntArray:
        """A view in a larger shape."""
        return np.broadcast_to(a, shape)

    def concatenate(self, parts: Sequence[BigIntArray], shapes: Sequence[Shape]) -> BigIntArray:
        """End to end."""
        return np.concatenate(parts)
