"""Sums and products of elements that are single (a Python integer) or many (an array), by one text.

Gates on scores and norms work on one element a vector, for which Python integers cost a tenth of what the
array kernels do; a product of a single element with an array is a scaling, which costs a tenth of an
elementwise product. Sums of integers are not reduced until they are multiplied or packed.
"""

from __future__ import annotations

from functools import reduce
from math import prod
from typing import TypeAlias

import numpy as np

from spdz.arithmetic import field
from spdz.foundations.types import FieldArray, Shape

_LONG_ROW = 256  # from so many elements on, rows times scalars are scaled row by row (measured)

Element: TypeAlias = int | FieldArray
"""A single element as an integer, or an array of shape S + (2,)."""


def unpack(a: FieldArray) -> Element:
    """An array of one element as an integer in [0, p)."""
    return field.to_int(a) if a.size == 2 else a


def pack(a: Element, shape: Shape) -> FieldArray:
    """As an array of shape S + (2,); single elements are broadcast."""
    if isinstance(a, int):
        a = field.from_int(a)
    if a.shape[:-1] == shape:
        return a
    return a.reshape((*shape, 2)) if a.size == 2 * prod(shape) else np.broadcast_to(a, (*shape, 2))


def times(a: Element, b: Element) -> Element:
    """The product."""
    if isinstance(a, int):
        return a * b % field.P if isinstance(b, int) else field.scale(b, a)
    if isinstance(b, int):
        return field.scale(a, b)
    if b.ndim > 2 and b.shape[-2] == 1 and a.shape[-2] >= _LONG_ROW:
        return _scale_rows(a, b)
    return (
        _scale_rows(b, a) if a.ndim > 2 and a.shape[-2] == 1 and b.shape[-2] >= _LONG_ROW else field.mul(a, b)
    )


def _scale_rows(a: FieldArray, b: FieldArray) -> FieldArray:
    """Every row of a, times its own element of b."""
    shape = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    rows = np.broadcast_to(a, (*shape, *a.shape[-2:])).reshape(-1, *a.shape[-2:])
    factors = field.to_list(np.broadcast_to(b, (*shape, 1, 2)))
    scaled = [field.scale(row, factor) for row, factor in zip(rows, factors, strict=True)]
    return np.stack(scaled).reshape((*shape, *a.shape[-2:]))


def plus(a: Element, b: Element) -> Element:
    """The sum."""
    if isinstance(a, int) and isinstance(b, int):
        return a + b
    return field.add(*(field.from_int(one) if isinstance(one, int) else one for one in (a, b)))


def total(terms: list[Element]) -> Element:
    """The sum of all; 0 if there are none."""
    return reduce(plus, terms) if terms else 0
