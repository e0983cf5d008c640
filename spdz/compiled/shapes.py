"""Slots in their forms and shapes: conversions, constants, indexing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import FieldRing, elements
from spdz.compiled import kernels
from spdz.compiled.dealt import dealt_array, dealt_numbers
from spdz.compiled.entries import each
from spdz.compiled.slots import FEW, Form, NotCompiled, Slot
from spdz.compiled.trace import Trace
from spdz.foundations.types import Shape
from spdz.values import input_mask
from spdz.values.party_ring import PartyRing

_ARRAYS = FieldRing()


def few(shape: Shape) -> Form:
    """The form of so few elements."""
    return "one" if prod(shape) == 1 else "few"


class TracedShapes(PartyRing):
    """What changes no number.

    Args:
        trace: Where it is written down.
    """

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self._origins: dict[str, tuple[Slot, Slot]] = {}
        """Of own words: the input, and the mask that was subtracted."""

    # -- forms ---------------------------------------------------------------------------------------

    def numbers(self, a: Slot) -> Slot:
        """As Python integers."""
        if a.form in ("one", "few"):
            return a
        if a.size > FEW or a.size == 0:
            raise NotCompiled(f"{a.size} elements are no few")
        form = few(a.shape)
        if a.form == "dealt":
            return self.trace.note(dealt_numbers(a), form=form, shape=a.shape, early=True)
        if a.form == "words":
            text = "{0}.item()" if form == "one" else "{0}.ravel().tolist()"
            return self.trace.note(text, a, form=form, shape=a.shape, bits=a.bits, reduced=a.reduced)
        if a.form == "other":
            raise NotCompiled("these are no elements")
        text = f"{self._name(field.to_int if form == 'one' else field.to_list)}({{0}})"
        return self.trace.note(text, a, form=form, shape=a.shape)

    def array(self, a: Slot) -> Slot:
        """As field elements."""
        if a.form == "many":
            return a
        if a.form == "dealt":
            return self.trace.note(dealt_array(a), form="many", shape=a.shape, early=True)
        if a.form == "words":
            name = self._name(input_mask.as_elements if a.reduced else field.from_int64)
            return self.trace.note(f"{name}({{0}})", a, form="many", shape=a.shape)
        if a.form == "other":
            raise NotCompiled("these are no elements")
        text = f"{self._name(kernels.array_of)}({{0}}, {a.shape})"
        return self.trace.note(text, self.reduced(a), form="many", shape=a.shape)

    def reduced(self, a: Slot) -> Slot:
        """Python integers in [0, p)."""
        a = self.numbers(a)
        if a.reduced:
            return a
        if (number := a.literal) is not None:
            return self._literal(number % P, a.shape)
        text = each("{0} % P", a.size, a)
        return self.trace.note(text, a, form=a.form, shape=a.shape)

    def _literal(self, number: int, shape: Shape = ()) -> Slot:
        return Slot(f"({number})", "one", shape, number.bit_length(), 0 <= number < P, early=True)

    def _name(self, what: Any) -> str:
        return self.trace.named(what)

    @staticmethod
    def _is_few(*shapes: Shape) -> bool:
        return all(0 < prod(shape) <= FEW for shape in shapes)

    def _arrays(self, kernel: Callable[..., Any], shape: Shape, *operands: Slot, tail: str = "") -> Slot:
        """A kernel on field elements."""
        places = ", ".join(f"{{{i}}}" for i in range(len(operands)))
        text = f"{self._name(kernel)}({places}{tail})"
        return self.trace.note(text, *map(self.array, operands), form="many", shape=shape)

    # -- shapes --------------------------------------------------------------------------------------

    def constant(self, raw: Raw) -> Any:
        """Public raw integers."""
        if isinstance(raw, int):
            return self._literal(raw)
        name, shape = self._name(elements(raw)), raw.shape
        return self.trace.note(name, form="many", shape=shape, early=True)

    def zeros(self, shape: Shape) -> Any:
        """Zero elements."""
        if prod(shape) == 1:
            return self._literal(0, shape)
        if self._is_few(shape):
            return self.trace.note(f"[0] * {prod(shape)}", form="few", shape=shape, bits=0, early=True)
        return self.trace.note(self._name(field.zeros(shape)), form="many", shape=shape, early=True)

    def index(self, a: Any, key: tuple[Any, ...]) -> Any:
        """Basic indexing."""
        shape = np.broadcast_to(np.False_, a.shape)[key].shape
        if not self._is_few(a.shape, shape):
            if a.form == "words":
                text = f"{{0}}[{self._name(key)}]"
                return self.trace.note(text, a, form="words", shape=shape, bits=a.bits, reduced=a.reduced)
            return self._arrays(_ARRAYS.index, shape, a, tail=f", {self._name(key)}")
        chosen = np.asarray(np.arange(a.size).reshape(a.shape)[key])
        return self._chosen(self.numbers(a), chosen)

    def _chosen(self, a: Slot, places: Any) -> Slot:
        """Numbers at flat places."""
        shape, flat = places.shape, places.ravel().tolist()
        if flat == list(range(a.size)):
            return replace(a, shape=shape)
        if a.form == "one":
            text = f"[{{0}}] * {len(flat)}"
        elif len(flat) == 1:
            text = f"{{0}}[{flat[0]}]"
        elif flat == list(range(flat[0], flat[0] + len(flat))):
            text = f"{{0}}[{flat[0]}:{flat[-1] + 1}]"
        else:
            text = f"[{', '.join(f'{{0}}[{i}]' for i in flat)}]"
        return self.trace.note(text, a, form=few(shape), shape=shape, bits=a.bits, reduced=a.reduced)

    def reshape(self, a: Any, shape: Shape) -> Any:
        """The same elements in another shape."""
        if a.shape == shape:
            return a
        if a.form in ("one", "few", "dealt"):
            return replace(a, shape=shape)
        if a.form == "words":
            text = f"{{0}}.reshape({shape})"
            return self.trace.note(text, a, form="words", shape=shape, bits=a.bits, reduced=a.reduced)
        return self.trace.note(f"{{0}}.reshape({(*shape, 2)})", self.array(a), form="many", shape=shape)

    def broadcast(self, a: Any, shape: Shape) -> Any:
        """The same numbers repeated."""
        if a.shape == shape:
            return a
        if self._is_few(shape):
            return self._chosen(self.numbers(a), np.broadcast_to(np.arange(a.size).reshape(a.shape), shape))
        if a.form == "words":
            text = f"{self._name(np.broadcast_to)}({{0}}, {shape})"
            return self.trace.note(text, a, form="words", shape=shape, bits=a.bits, reduced=a.reduced)
        return self._arrays(_ARRAYS.broadcast, shape, a, tail=f", {shape}")

    def concatenate(self, parts: Sequence[Any], shapes: Sequence[Shape]) -> Any:
        """End to end along the first axis."""
        shape = (sum(one[0] for one in shapes), *shapes[0][1:])
        slots = [self.zeros(one) if part is None else part for part, one in zip(parts, shapes, strict=True)]
        places = [f"{{{i}}}" for i in range(len(slots))]
        if self._is_few(shape):
            slots = [self.numbers(one) for one in slots]
            text = ", ".join(p if s.form == "one" else f"*{p}" for p, s in zip(places, slots, strict=True))
            bits, reduced = max(one.bits for one in slots), all(one.reduced for one in slots)
            form = few(shape)
            text = text if form == "one" else f"[{text}]"
            return self.trace.note(text, *slots, form=form, shape=shape, bits=bits, reduced=reduced)
        text = f"{self._name(np.concatenate)}([{', '.join(places)}])"
        return self.trace.note(text, *map(self.array, slots), form="many", shape=shape)
