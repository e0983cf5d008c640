"""The arithmetic that a linear map of a value acts with, one implementation a reading.

A :class:`~spdz.values.value.Value` is a tuple of parts, and every linear map acts on all of them alike. What
a part *is* differs: field elements for a party and for the dealer, exact integers in the clear.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.public import Raw, magnitude
from spdz.foundations.types import BigIntArray, FieldArray, Shape


def elements(raw: Raw) -> FieldArray:
    """Public raw integers mod p."""
    if isinstance(raw, int):
        return field.from_int(raw)
    if raw.dtype == object:
        return field.from_ints(raw)
    return field.from_int64(raw.astype(np.int64, copy=False))


class Ring(Protocol):
    """Linear operations on one part. ``shape`` never counts the limb axis of a field array."""

    def add(self, a: Any, b: Any) -> Any:
        """Elementwise sum, broadcasting."""

    def sub(self, a: Any, b: Any) -> Any:
        """Elementwise difference, broadcasting."""

    def neg(self, a: Any) -> Any:
        """Elementwise negation."""

    def scale(self, a: Any, factor: Raw) -> Any:
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

    def scale(self, a: FieldArray, factor: Raw) -> FieldArray:
        """Elementwise product with public integers mod p."""
        if isinstance(factor, int):
            return field.scale(a, factor)
        return field.mul(a, elements(factor))

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


_SHORT = 1 << 40


def whole(numbers: Any) -> BigIntArray:
    """Integers as an int64 array if all are below 2^40 and were one, else as Python integers.

    So a sum of two never wraps, and neither do the limbs of a dot product (:mod:`spdz.gates.product`).
    """
    array = np.asarray(numbers)
    if array.dtype == np.int64 and magnitude(array) < _SHORT:
        return array
    return array.astype(object)


class IntegerRing:
    """Exact integers: short ``int64`` inputs and Python integers in object arrays (:func:`whole`)."""

    def add(self, a: BigIntArray, b: BigIntArray) -> BigIntArray:
        """Elementwise sum."""
        return whole(a + b)

    def sub(self, a: BigIntArray, b: BigIntArray) -> BigIntArray:
        """Elementwise difference."""
        return whole(a - b)

    def neg(self, a: BigIntArray) -> BigIntArray:
        """Elementwise negation."""
        return whole(-a)

    def scale(self, a: BigIntArray, factor: Raw) -> BigIntArray:
        """Elementwise product with public integers."""
        return whole(a.astype(object) * factor)

    def sum(self, a: BigIntArray, axis: int) -> BigIntArray:
        """Sum over one axis."""
        return whole(a.astype(object).sum(axis=axis))

    def index(self, a: BigIntArray, key: tuple[Any, ...]) -> BigIntArray:
        """Basic indexing."""
        return whole(a[key])

    def reshape(self, a: BigIntArray, shape: Shape) -> BigIntArray:
        """The same elements in another shape."""
        return a.reshape(shape)

    def broadcast(self, a: BigIntArray, shape: Shape) -> BigIntArray:
        """A view in a larger shape."""
        return np.broadcast_to(a, shape)

    def concatenate(self, parts: Sequence[BigIntArray], shapes: Sequence[Shape]) -> BigIntArray:
        """End to end."""
        return np.concatenate(parts)
