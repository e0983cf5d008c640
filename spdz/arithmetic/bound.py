"""Public bounds on what honest inputs can make of a value: why nothing overflows in silence.

Two numbers travel with every value, both in raw units: the largest *entry* and the largest L2 *norm* along
the last axis. The norm makes dot products tight (Cauchy-Schwarz: |x . y| <= |x| |y|); the entry is what a
comparison and an output must hold. Every rule below keeps ``entry <= norm <= sqrt(n) entry`` true for n
entries along the last axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

from spdz.foundations.types import Shape


def root(n: int) -> int:
    """The square root of n, rounded up (1 for an empty axis)."""
    return isqrt(n - 1) + 1 if n > 0 else 1


def _last(shape: Shape) -> int:
    return shape[-1] if shape else 1


@dataclass(frozen=True, slots=True)
class Bound:
    """Bounds of one value.

    Attributes:
        entry: Largest magnitude of an entry.
        norm: Largest L2 norm along the last axis.
    """

    entry: int
    norm: int

    @classmethod
    def of_norm(cls, norm: int) -> Bound:
        """For vectors of at most this norm."""
        return cls(norm, norm)

    @classmethod
    def of_entry(cls, entry: int, shape: Shape) -> Bound:
        """For entries of at most this magnitude, in an array of this shape."""
        return cls(entry, entry * root(_last(shape)))

    def __add__(self, other: Bound) -> Bound:
        return Bound(self.entry + other.entry, self.norm + other.norm)

    def scaled(self, factor: int) -> Bound:
        """After multiplication with public numbers of at most this magnitude."""
        return Bound(self.entry * factor, self.norm * factor)

    def broadcast(self, old: Shape, new: Shape) -> Bound:
        """After broadcasting: a last axis that was repeated is longer."""
        return self if _last(old) == _last(new) else Bound.of_entry(self.entry, new)

    def summed(self, shape: Shape, axis: int) -> Bound:
        """After a sum over one axis of an array of this shape."""
        length, rest = shape[axis], shape[:axis] + shape[axis + 1 :]
        if axis < len(shape) - 1:
            return self.scaled(length)
        return Bound.of_entry(min(self.entry * length, self.norm * root(length)), rest)

    def dot(self, other: Bound, shape: Shape) -> Bound:
        """Of the dot products, in an array of this shape."""
        return Bound.of_entry(self.norm * other.norm, shape)

    def product(self, other: Bound, shape: Shape) -> Bound:
        """Of the elementwise products, in an array of this shape."""
        return Bound.of_entry(self.entry * other.entry, shape)

    def larger(self, other: Bound, shape: Shape) -> Bound:
        """Of the elementwise maximum, in an array of this shape."""
        entry = max(self.entry, other.entry)
        return Bound(entry, min(self.norm + other.norm, entry * root(_last(shape))))


NOTHING = Bound(0, 0)
"""Of a mask, which stands for no honest number."""
