"""Sums and products on slots: what a value's linear maps and a gate's products write down.

Up to FEW elements are Python integers here, which are reduced mod p only where they must be: before a frame,
a shift, a check, or where they would grow beyond ROOM bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import prod
from operator import add, mul, sub
from typing import Any

import numpy as np

from spdz.arithmetic import element, field, inner_product
from spdz.arithmetic.field import P
from spdz.arithmetic.public import Raw
from spdz.compiled import kernels
from spdz.compiled.entries import each
from spdz.compiled.shapes import TracedShapes, few
from spdz.compiled.slots import Slot
from spdz.foundations.types import Shape

ROOM = 512
"""Bits that an unreduced integer may have: a reduction costs more than a longer product (measured)."""

_ONE_LIMB = 22
"""Bits of the longest short integers that are not split in dot products."""

_OPERATORS = {"+": add, "-": sub, "*": mul}

_WORD = 62
"""Bits of the longest short integers: a sum of two does not wrap."""


def _bits(sign: str, a: Slot, b: Slot) -> int:
    """Of a sum or product of integers."""
    return a.bits + b.bits if sign == "*" else 1 + max(a.bits, b.bits)


class TracedArithmetic(TracedShapes):
    """What computes."""

    def _slim(self, bits: int, *operands: Slot) -> tuple[Slot, ...]:
        """The operands, reduced if a result of so many bits is too long."""
        return (
            tuple(self.reduced(one) if one.bits > 127 else one for one in operands)
            if bits > ROOM
            else operands
        )

    # -- sums ----------------------------------------------------------------------------------------

    def add(self, a: Any, b: Any) -> Any:
        """Elementwise sum."""
        return self._signed_sum("+", field.add, a, b)

    def sub(self, a: Any, b: Any) -> Any:
        """Elementwise difference."""
        return self._signed_sum("-", field.sub, a, b)

    def neg(self, a: Any) -> Any:
        """Elementwise negation."""
        if self._is_few(a.shape):
            a = self.numbers(a)
            text = each("-{0}", a.size, a)
            return self.trace.note(text, a, form=a.form, shape=a.shape, bits=a.bits, reduced=False)
        if a.form == "words":
            return self.trace.note("-{0}", a, form="words", shape=a.shape, bits=a.bits, reduced=False)
        return self._arrays(field.neg, a.shape, a)

    def _signed_sum(self, sign: str, kernel: Callable[..., Any], a: Slot, b: Slot) -> Slot:
        shape = np.broadcast_shapes(a.shape, b.shape)
        if self._is_few(shape):
            a, b = self.numbers(a), self.numbers(b)
            if b.literal == 0 and a.shape == shape:
                return a
            if a.literal == 0 and sign == "+" and b.shape == shape:
                return b
            return self._pairwise(sign, shape, a, b)
        if a.form == b.form == "words":
            # Two that are not negative differ by no more than the larger.
            grows = sign == "+" or not (a.reduced and b.reduced)
            bits = max(a.bits, b.bits) + grows
            if bits <= _WORD:
                positive = sign == "+" and a.reduced and b.reduced
                text = f"{{0}} {sign} {{1}}"
                return self.trace.note(text, a, b, form="words", shape=shape, bits=bits, reduced=positive)
        return self._arrays(kernel, shape, a, b)

    def _pairwise(self, sign: str, shape: Shape, a: Slot, b: Slot) -> Slot:
        a, b = self._slim(_bits(sign, a, b), a, b)
        form, bits = few(shape), _bits(sign, a, b)
        a, b = (one if one.form == "one" else self.broadcast(one, shape) for one in (a, b))
        if form != "one" and a.form == b.form == "one":
            a = self.broadcast(a, shape)
        text = each(f"{{0}} {sign} {{1}}", prod(shape), a, b)
        if a.form == b.form == "few" and "zip" in text:
            text = f"list(map({self._name(_OPERATORS[sign])}, {{0}}, {{1}}))"
        return self.trace.note(text, a, b, form=form, shape=shape, bits=bits, reduced=False)

    def sum(self, a: Any, axis: int) -> Any:
        """Sum over one axis."""
        shape = a.shape[:axis] + a.shape[axis + 1 :]
        if not self._is_few(a.shape):
            return self._arrays(field.sum, shape, a, tail=f", {axis}")
        a = self.numbers(a)
        bits = a.bits + a.shape[axis].bit_length()
        if a.form == "one":
            return replace(a, shape=shape)
        form = few(shape)
        if form == "one":
            text = "sum({0})"
        else:
            places = np.moveaxis(np.arange(a.size).reshape(a.shape), axis, -1).reshape(prod(shape), -1)
            sums = ", ".join(" + ".join(f"{{0}}[{i}]" for i in row) for row in places.tolist())
            text = f"[{sums}]"
        return self.trace.note(text, a, form=form, shape=shape, bits=bits, reduced=False)

    # -- products ------------------------------------------------------------------------------------

    def product(self, a: Any, b: Any) -> Any:
        """Elementwise product, broadcasting."""
        shape = np.broadcast_shapes(a.shape, b.shape)
        if self._is_few(shape):
            a, b = self.numbers(a), self.numbers(b)
            if 0 in (a.literal, b.literal):
                return self.zeros(shape)
            return self._pairwise("*", shape, a, b)
        for one, many in ((a, b), (b, a)):
            if one.size == 1:
                text = f"{self._name(field.scale)}({{0}}, {{1}})"
                operands = self.array(self.broadcast(many, shape)), self.reduced(one)
                return self.trace.note(text, *operands, form="many", shape=shape)
        return self._arrays(element.times, shape, a, b)

    def scale(self, a: Any, factor: Raw) -> Any:
        """Elementwise product with public integers."""
        if not isinstance(factor, int):
            return self.product(a, self.constant(factor))
        if a.form == "words" and not self._is_few(a.shape):
            bits = a.bits + factor.bit_length()
            if bits <= _WORD:
                positive = a.reduced and factor >= 0
                text = f"{{0}} * {factor}"
                return self.trace.note(text, a, form="words", shape=a.shape, bits=bits, reduced=positive)
        centred = (factor + P // 2) % P - P // 2
        return self.product(a, self._literal(centred))

    def scaled(self, a: Any, factor: Any) -> Any:
        """Elementwise product with one element."""
        return self.product(a, factor)

    def prepared(self, a: Any) -> Any:
        """As it is: what is split is split once anyway."""
        return a

    def dot(self, a: Any, b: Any) -> Any:
        """Dot products over the last axis."""
        n = a.shape[-1]
        shape = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
        if a.shape == b.shape and self._is_few(a.shape):
            a, b = self.numbers(a), self.numbers(b)
            a, b = self._slim(a.bits + b.bits + n.bit_length(), a, b)
            bits = a.bits + b.bits + n.bit_length()
            if a.form == "one":
                return replace(self.product(a, b), shape=shape)
            form, times = few(shape), self._name(mul)
            if form == "one":
                text = f"sum(map({times}, {{0}}, {{1}}))"
            else:
                pieces = [f"[{i}:{i + n}]" for i in range(0, a.size, n)]
                text = f"[{', '.join(f'sum(map({times}, {{0}}{one}, {{1}}{one}))' for one in pieces)}]"
            return self.trace.note(text, a, b, form=form, shape=shape, bits=bits, reduced=False)
        if a.size == b.size == n:
            return self._single_dot(a, b, shape)
        return self._arrays(inner_product.dot, shape, a, b)

    def short_dot(self, x: Any, b: Any) -> Any:
        """The same: the own raw input is a vector of short integers."""
        return self.dot(x, b)

    def _single_dot(self, a: Slot, b: Slot, shape: Shape) -> Slot:
        """Of two long vectors, as one exact floating-point product of their limbs."""
        if a.form != "words":
            a, b = b, a
        if a.form != "words" or a.size > kernels.LONGEST:
            return self._arrays(inner_product.dot, shape, a, b)
        if (origin := self._origins.get(a.name)) is not None:
            # Of the two, the own input is short, and what depends on the mask alone is done ahead.
            x, r = origin
            difference: Slot = self.sub(self._single_dot(x, b, shape), self._single_dot(r, b, shape))
            return difference
        (left, width), (right, other) = self._limbs(a), self._limbs(b)
        text = f"{self._name(kernels.product)}({{0}}, {{1}}, {width}, {other})"
        bits = a.bits + b.bits + a.size.bit_length()
        return self.trace.note(text, left, right, form="one", shape=shape, bits=bits, reduced=False)

    def _limbs(self, a: Slot) -> tuple[Slot, int]:
        """Limbs, and their bits."""
        a = self.reshape(a, (a.size,))
        if a.form != "words":
            text = f"{self._name(kernels.element_limbs)}({{0}})"
            return self.trace.note(text, self.array(a), form="other"), kernels.ELEMENT_LIMB
        if a.bits <= _ONE_LIMB:
            return self.trace.note(f"{self._name(kernels.one_limb)}({{0}})", a, form="other"), a.bits
        split = kernels.word_limbs if a.reduced else kernels.signed_limbs
        count = -(-(a.bits + (not a.reduced)) // kernels.WORD_LIMB)
        text = f"{self._name(split)}({{0}}, {count})"
        return self.trace.note(text, a, form="other"), kernels.WORD_LIMB
