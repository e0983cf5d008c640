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
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.field import P
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.arithmetic.public import Raw, fraction_bits, integers, is_whole, magnitude, rounded
from spdz.foundations.types import IntArray, Shape
from spdz.values.refusals import Secret, expect_secret, refuse_slips
from spdz.values.standing import Standing

if TYPE_CHECKING:
    from spdz.values.engine import Engine


class Value(Secret):
    """A secret array that a protocol computes with.

    Attributes:
        engine: The reading that the value belongs to.
        parts: What the reading holds of it (see the module's table).
        shape: Shape of the array.
        frac: Fractional bits; the raw integer is the number times ``2**frac``.
        bound: What no honest run exceeds (:mod:`spdz.arithmetic.bound`); public.
        masked: True for ``<x>``, False for ``[[z]]``.
        is_bit: True if the entries are 0 or 1.
        plain: The owner's own raw input, where this value is one (int64); else None.
        mask_bits: Bits of the mask's randomness (127 for a fresh one; truncation takes some away).
        sign_of: Of a comparison with 0, the masked value that is compared.
        standing: The vectors, where this value is nothing but standing inputs.
        span: Of a value whose mask is a small integer, the largest magnitude of that mask; else 0.
    """

    __slots__ = (
        "_parts",
        "bound",
        "engine",
        "frac",
        "is_bit",
        "mask_bits",
        "masked",
        "plain",
        "shape",
        "sign_of",
        "span",
        "standing",
    )

    def __init__(
        self,
        engine: Engine,
        parts: tuple[Any, ...] | Callable[[], tuple[Any, ...]],
        shape: Shape,
        frac: int,
        bound: Bound,
        *,
        masked: bool = False,
        is_bit: bool = False,
        plain: IntArray | None = None,
        mask_bits: int = 127,
        span: int = 0,
        sign_of: Value | None = None,
        standing: Standing | None = None,
    ) -> None:
        if bound.entry > P // 2:
            raise ValueError(
                f"this program can produce numbers of {bound.entry.bit_length()} bits, which do not fit the "
                "field of 127 bits: use fewer products, truncate between them, or allow a smaller max_norm"
            )
        self.engine, self._parts = engine, parts
        self.shape, self.frac, self.bound = shape, frac, bound
        self.masked, self.is_bit, self.mask_bits, self.span = masked, is_bit, mask_bits, span
        self.plain, self.sign_of, self.standing = plain, sign_of, standing

    def __repr__(self) -> str:
        kind = "masked" if self.masked else "shared"
        return f"<{kind} value of shape {self.shape} with {self.frac} fractional bits>"

    @property
    def parts(self) -> tuple[Any, ...]:
        """What the reading holds of the value (see the module's table)."""
        if callable(self._parts):
            self._parts = self._parts()
        return self._parts

    @property
    def undecided(self) -> bool:
        """Whether this is a comparison that nothing has used yet, and for which nothing is dealt yet."""
        return self.sign_of is not None and callable(self._parts)

    def decide(self) -> None:
        """Have an undecided comparison dealt and evaluated: all readings do so at the same place."""
        if self.undecided:
            _ = self.parts

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    # -- linear maps ---------------------------------------------------------------------------------

    def __add__(self, other: Value | npt.ArrayLike) -> Value:
        if isinstance(other, Value):
            return self._combine(other, self.engine.ring.add, lambda q: q)
        x = self._finer_for(other)
        return x.plus_raw(rounded(other, x.frac))

    def __sub__(self, other: Value | npt.ArrayLike) -> Value:
        if isinstance(other, Value):
            return self._combine(other, self.engine.ring.sub, self.engine.ring.neg)
        x = self._finer_for(other)
        return x.plus_raw(-rounded(other, x.frac))

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
        refuse_slips("a product", factor)
        more = 0 if is_whole(factor) else FRACTION_BITS
        return self._scaled(rounded(factor, more), self.frac + more)

    __rmul__ = __mul__

    def plus_raw(self, raw: int | npt.ArrayLike) -> Value:
        """Add public raw integers (in units of ``2**-frac``)."""
        raw = integers(raw)
        x = self.broadcast(np.broadcast_shapes(self.shape, np.shape(raw)))
        bound = x.bound + Bound.of_entry(magnitude(raw), x.shape)
        return x._with(self.engine.plus(x, raw), x.shape, self.frac, bound)

    def rescaled(self, frac: int) -> Value:
        """The same number with more fractional bits, exactly."""
        frac = fraction_bits(frac)
        if frac == self.frac:
            return self
        if frac < self.frac:
            raise ValueError("to drop fractional bits, truncate")
        return self._scaled(1 << (frac - self.frac), frac)

    def broadcast(self, shape: Shape) -> Value:
        """The same numbers repeated into a larger shape, as in NumPy."""
        if shape == self.shape:
            return self
        bound = self.bound.broadcast(self.shape, shape)
        return self._map(lambda part: self.engine.ring.broadcast(part, shape), shape, bound)

    def bounded(self, bound: Bound) -> Value:
        """The same numbers, of which the caller knows this bound. It is believed: beyond it all is wrong."""
        return Value(
            self.engine,
            self.parts,
            self.shape,
            self.frac,
            bound,
            masked=self.masked,
            is_bit=self.is_bit,
            plain=self.plain,
            mask_bits=self.mask_bits,
            span=self.span,
        )

    def sum(self, axis: int = -1) -> Value:
        """Sum over one axis."""
        axis = range(self.ndim)[axis]
        shape = self.shape[:axis] + self.shape[axis + 1 :]
        bound = self.bound.summed(self.shape, axis)
        result = self._map(lambda part: self.engine.ring.sum(part, axis), shape, bound)
        result.span *= self.shape[axis]
        return result

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
        # With fewer keys than axes, and no dots that stand for some, the last axis stays as it is.
        kept = Ellipsis not in keys and sum(one is not None for one in keys) < self.ndim
        bound = self.bound if kept else Bound.of_entry(self.bound.entry, shape)
        result = self._map(lambda part: self.engine.ring.index(part, keys), shape, bound)
        result.is_bit = self.is_bit
        return result

    def _finer_for(self, public: npt.ArrayLike) -> Value:
        """With at least 16 fractional bits where a real is added: a count minus 2.5 is not one minus 2."""
        refuse_slips("a sum", public)
        return self if is_whole(public) else self.rescaled(max(self.frac, FRACTION_BITS))

    # -- how a linear map acts on the parts ----------------------------------------------------------

    def _with(self, parts: tuple[Any, ...], shape: Shape, frac: int, bound: Bound) -> Value:
        """What a linear map of the masks makes of this value."""
        value = Value(self.engine, parts, shape, frac, bound, masked=self.masked)
        value.mask_bits, value.span = self.mask_bits, self.span
        return value

    def _map(
        self, linear: Callable[[Any], Any], shape: Shape, bound: Bound, frac: int | None = None
    ) -> Value:
        parts = tuple(p if p is None else linear(p) for p in self.parts)
        return self._with(parts, shape, self.frac if frac is None else frac, bound)

    def _scaled(self, raw: Raw, frac: int) -> Value:
        """Times public raw integers; the product is said to have so many fractional bits."""
        shape = np.broadcast_shapes(self.shape, np.shape(raw))
        bound = self.bound.broadcast(self.shape, shape).scaled(magnitude(raw))
        scaled = self._map(lambda part: self.engine.ring.scale(part, raw), shape, bound, frac)
        scaled.span *= max(1, magnitude(raw))
        if not np.all(raw) and not self.span:
            scaled.mask_bits = 0  # where a factor is 0, so is the mask
        return scaled

    def _combine(self, other: Value, both: Callable[[Any, Any], Any], alone: Callable[[Any], Any]) -> Value:
        """Add or subtract; ``alone`` is what becomes of the second operand when the first is zero."""
        x, y = aligned(self, other)
        if x.masked != y.masked:
            x, y = x.engine.shared(x), y.engine.shared(y)
        parts = tuple(
            both(p, q) if p is not None and q is not None else p if q is None else alone(q)
            for p, q in zip(x.parts, y.parts, strict=True)
        )
        value = Value(x.engine, parts, x.shape, x.frac, x.bound + y.bound, masked=x.masked)
        value.mask_bits = min(x.mask_bits, y.mask_bits)
        value.span = x.span + y.span if x.span and y.span else 0
        return value


def aligned(x: Value, y: Value) -> tuple[Value, Value]:
    """Both on one scale and in one shape: only then may their entries, norms and bounds be put together."""
    if x.engine is not y.engine:
        raise ValueError("the two values belong to different runs")
    frac, shape = max(x.frac, y.frac), np.broadcast_shapes(x.shape, y.shape)
    return x.rescaled(frac).broadcast(shape), y.rescaled(frac).broadcast(shape)


def concatenate(*values: Value) -> Value:
    """Values end to end along the first axis, all masked or all shared (else they become shared)."""
    expect_secret("concatenate", *values)
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
    norms, small = [value.bound.norm for value in values], {value.span > 0 for value in values}
    bound = Bound(max(v.bound.entry for v in values), sum(norms) if values[0].ndim == 1 else max(norms))
    return Value(
        engine,
        parts,
        (sum(shape[0] for shape in shapes), *shapes[0][1:]),
        frac,
        bound,
        masked=values[0].masked,
        mask_bits=0 if len(small) > 1 else min(value.mask_bits for value in values),
        span=max(value.span for value in values) if small == {True} else 0,
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
