"""Values: what a protocol computes with, in every reading.

A value is a tuple of *parts* on which every linear map acts alike, so addition, subtraction, scaling by
public numbers, sums and reshaping are written once for all readings and cost no communication:

=========  =============================  ==============================
reading    masked value ``<x>``           shared value ``[[z]]``
=========  =============================  ==============================
party      ``(eps, share of r, MAC)``     ``(share of z, MAC)``
dealer     ``(r,)``                       ``()``
meter      ``(symbol,)``                  ``(symbol,)``
clear      ``(x,)``                       ``(z,)``
=========  =============================  ==============================

A masked value is ``x = eps + r`` with ``eps`` public; products of masked values need one dealt
correction each and no round. A part that is ``None`` is zero everywhere (a party holds nothing of the
other party's input mask; semi-honest runs have no MAC).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from spdz.bound import Bound
from spdz.field import P
from spdz.fixed_point import FRACTION_BITS
from spdz.types import IntArray, Shape

if TYPE_CHECKING:
    from spdz.engine import Engine


class Value:
    """A secret array that a protocol computes with.

    Attributes:
        engine: The reading that the value belongs to.
        parts: What the reading holds of it (see the module's table).
        shape: Shape of the array.
        frac: Fractional bits; the raw integer is the number times ``2**frac``.
        bound: What no honest run exceeds (:mod:`spdz.bound`); public.
        masked: True for ``<x>``, False for ``[[z]]``.
        is_bit: True if the entries are 0 or 1.
        plain: The owner's own raw input, where this value is one (int64); else None.
        mask_bits: Bits of the mask's randomness (127 for a fresh one; truncation takes some away).
    """

    __slots__ = ("bound", "engine", "frac", "is_bit", "mask_bits", "masked", "parts", "plain", "shape")
    __array_priority__ = 1000  # NumPy leaves `array + value` to us
    __array_ufunc__ = None

    def __init__(
        self,
        engine: Engine,
        parts: tuple[Any, ...],
        shape: Shape,
        frac: int,
        bound: Bound,
        *,
        masked: bool = False,
        is_bit: bool = False,
        plain: IntArray | None = None,
        mask_bits: int = 127,
    ) -> None:
        if bound.entry > P // 2:
            raise ValueError(
                f"this program can produce numbers of {bound.entry.bit_length()} bits, which do not fit the "
                "field of 127 bits: use fewer products, or inputs of a smaller max_norm"
            )
        self.engine, self.parts, self.shape = engine, parts, shape
        self.frac, self.bound = frac, bound
        self.masked, self.is_bit, self.plain, self.mask_bits = masked, is_bit, plain, mask_bits

    def __repr__(self) -> str:
        kind = "masked" if self.masked else "shared"
        return f"<{kind} value of shape {self.shape} with {self.frac} fractional bits>"

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    # -- linear maps ---------------------------------------------------------------------------------

    def __add__(self, other: Value | npt.ArrayLike) -> Value:
        if isinstance(other, Value):
            return self._combine(other, self.engine.ring.add, lambda q: q)
        return self.plus_raw(_raw(other, self.frac))

    def __sub__(self, other: Value | npt.ArrayLike) -> Value:
        if isinstance(other, Value):
            return self._combine(other, self.engine.ring.sub, self.engine.ring.neg)
        return self.plus_raw(-_raw(other, self.frac))

    def __radd__(self, other: npt.ArrayLike) -> Value:
        return self + other

    def __rsub__(self, other: npt.ArrayLike) -> Value:
        return -self + other

    def __neg__(self) -> Value:
        return self._map(self.engine.ring.neg, self.shape, self.bound)

    def __mul__(self, factor: npt.ArrayLike) -> Value:
        """Product with public numbers: integers scale exactly, reals are rounded to 16 fractional bits."""
        if isinstance(factor, Value):
            raise TypeError("use spdz.multiply or spdz.dot for the product of two secret values")
        numbers = np.asarray(factor)
        exact = isinstance(factor, int) or numbers.dtype.kind in "iu"
        raw = _raw(factor, 0 if exact else FRACTION_BITS)
        shape = np.broadcast_shapes(self.shape, numbers.shape)
        bound = self.bound.broadcast(self.shape, shape).scaled(_largest(raw))
        scaled = self._map(
            lambda part: self.engine.ring.scale(part, raw),
            shape,
            bound,
        )
        scaled.frac = self.frac + (0 if exact else FRACTION_BITS)
        if not np.all(raw):
            scaled.mask_bits = 0  # where a factor is 0, so is the mask
        return scaled

    __rmul__ = __mul__

    def __truediv__(self, divisor: object) -> Value:
        raise TypeError("a secret value cannot be divided: multiply by the reciprocal of a public number")

    def __lt__(self, other: object) -> bool:
        raise TypeError("compare secret values by `await spdz.nonnegative(x - y)`, which gives a secret bit")

    __le__ = __gt__ = __ge__ = __lt__

    def __bool__(self) -> bool:
        raise TypeError("a program cannot branch on a secret value: only its result is opened")

    def plus_raw(self, raw: int | IntArray) -> Value:
        """Add public raw integers (in units of ``2**-frac``)."""
        result = self.engine.plus(self, raw)
        constant = Bound.of_entry(_largest(raw), result.shape)
        bound = self.bound.broadcast(self.shape, result.shape) + constant
        return Value(
            self.engine,
            result.parts,
            result.shape,
            self.frac,
            bound,
            masked=self.masked,
            mask_bits=self.mask_bits,
        )

    def rescaled(self, frac: int) -> Value:
        """The same number with more fractional bits, exactly."""
        if frac == self.frac:
            return self
        if frac < self.frac:
            raise ValueError("to drop fractional bits, truncate")
        finer = self * (1 << (frac - self.frac))
        finer.frac = frac
        return finer

    def sum(self, axis: int = -1) -> Value:
        """Sum over one axis."""
        axis = range(self.ndim)[axis]
        shape = self.shape[:axis] + self.shape[axis + 1 :]
        bound = self.bound.summed(self.shape, axis)
        return self._map(lambda part: self.engine.ring.sum(part, axis), shape, bound)

    def reshape(self, *shape: int) -> Value:
        """The same entries in another shape."""
        full = np.empty(self.shape, dtype=np.bool_).reshape(shape).shape
        kept = full[-1:] == self.shape[-1:]
        bound = self.bound if kept else Bound.of_entry(self.bound.entry, full)
        result = self._map(lambda part: self.engine.ring.reshape(part, full), full, bound)
        result.is_bit = self.is_bit
        return result

    def __getitem__(self, key: Any) -> Value:
        """Basic indexing: integers, slices, ``None`` and ``...``."""
        keys = key if isinstance(key, tuple) else (key,)
        if not all(one is None or one is Ellipsis or type(one) in (int, slice) for one in keys):
            raise TypeError("a value is indexed by integers, slices, None and ... only")
        shape = np.broadcast_to(np.False_, self.shape)[keys].shape
        # Leading integers and slices leave the last axis as it is, or cut it.
        kept = len(keys) < self.ndim and all(type(one) in (int, slice) for one in keys)
        bound = self.bound if kept else Bound.of_entry(self.bound.entry, shape)
        result = self._map(lambda part: self.engine.ring.index(part, keys), shape, bound)
        result.is_bit = self.is_bit
        return result

    # -- how a linear map acts on the parts ----------------------------------------------------------

    def _map(self, linear: Callable[[Any], Any], shape: Shape, bound: Bound) -> Value:
        parts = tuple(p if p is None else linear(p) for p in self.parts)
        return Value(
            self.engine, parts, shape, self.frac, bound, masked=self.masked, mask_bits=self.mask_bits
        )

    def _combine(self, other: Value, both: Callable[[Any, Any], Any], alone: Callable[[Any], Any]) -> Value:
        """Add or subtract; ``alone`` is what becomes of the second operand when the first is zero."""
        if other.engine is not self.engine:
            raise ValueError("the two values belong to different runs")
        frac = max(self.frac, other.frac)
        x, y = self.rescaled(frac), other.rescaled(frac)
        if x.masked != y.masked:
            x, y = x.engine.shared(x), y.engine.shared(y)
        shape = np.broadcast_shapes(x.shape, y.shape)
        parts = []
        for p, q in zip(x.parts, y.parts, strict=True):
            if p is None or q is None:
                lone = p if q is None else alone(q)
                parts.append(lone if lone is None else x.engine.ring.broadcast(lone, shape))
            else:
                parts.append(both(p, q))
        bound = x.bound.broadcast(x.shape, shape) + y.bound.broadcast(y.shape, shape)
        bits = min(x.mask_bits, y.mask_bits)
        return Value(x.engine, tuple(parts), shape, x.frac, bound, masked=x.masked, mask_bits=bits)


def concatenate(*values: Value) -> Value:
    """Values end to end along the first axis, all masked or all shared (else they become shared)."""
    if any(value.ndim == 0 or value.shape[1:] != values[0].shape[1:] for value in values):
        raise ValueError("only values that differ in their first axis alone can be concatenated")
    engine = values[0].engine
    if len({value.masked for value in values}) > 1:
        values = tuple(engine.shared(value) for value in values)
    frac = max(value.frac for value in values)
    values = tuple(value.rescaled(frac) for value in values)
    shapes = [value.shape for value in values]
    parts = tuple(
        None if all(part is None for part in column) else engine.ring.concatenate(column, shapes)
        for column in zip(*(value.parts for value in values), strict=True)
    )
    norms = [value.bound.norm for value in values]
    bound = Bound(max(v.bound.entry for v in values), sum(norms) if values[0].ndim == 1 else max(norms))
    return Value(
        engine,
        parts,
        (sum(shape[0] for shape in shapes), *shapes[0][1:]),
        frac,
        bound,
        masked=values[0].masked,
        mask_bits=min(value.mask_bits for value in values),
    )


def split(value: Value, shapes: Sequence[Shape]) -> list[Value]:
    """Undo a concatenation of values that had been reshaped: cut the first axis and give back the shapes."""
    width = prod(value.shape[1:])
    results, start = [], 0
    for shape in shapes:
        stop = start + prod(shape) // width
        results.append(value[start:stop].reshape(*shape))
        start = stop
    return results


def _largest(raw: int | IntArray) -> int:
    """Largest magnitude of public raw integers."""
    return abs(raw) if isinstance(raw, int) else int(np.abs(raw).max(initial=0))


def _raw(number: npt.ArrayLike, frac: int) -> Any:
    """Round public numbers to raw integers: a Python int for a scalar, else an int64 array."""
    if isinstance(number, (int, float, np.integer, np.floating)):
        if not isinstance(number, int) and not np.isfinite(number):
            raise ValueError("a public number must be finite")
        return round(Fraction(number.item() if isinstance(number, np.generic) else number) * (1 << frac))
    numbers = np.asarray(number)
    if numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise ValueError("public numbers must be real and finite")
    scaled = np.rint(numbers.astype(np.float64) * float(1 << frac))
    if np.abs(scaled).max(initial=0.0) >= 2.0**53:
        raise ValueError(f"public array entries must be below 2^{53 - frac} to be exact")
    return scaled.astype(np.int64)
