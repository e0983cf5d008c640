"""The ring of the compiled reading: the party's ring (:mod:`spdz.values.party_ring`), written down."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any

from spdz.arithmetic import field, unreduced
from spdz.arithmetic.bits import is_below
from spdz.arithmetic.bits import shifted as shifted_array
from spdz.compiled import kernels
from spdz.compiled.arithmetic import TracedArithmetic
from spdz.compiled.entries import each
from spdz.compiled.shapes import few
from spdz.compiled.slots import Form, NotCompiled, Slot
from spdz.compiled.trace import Kind
from spdz.foundations.types import Shape
from spdz.rounds.wire import ELEMENT_BYTES, from_bytes, to_bytes
from spdz.values import input_mask
from spdz.values.party_ring import PartyRing, wrapped

_ON_WORDS = PartyRing()


class TracedRing(TracedArithmetic):
    """Everything else than sums and products."""

    # -- elements that are single integers where they are single -------------------------------------

    def unpacked(self, a: Any) -> Any:
        """As it is."""
        return a

    def packed(self, a: Any, shape: Shape) -> Any:
        """In a shape; what is single is broadcast."""
        return self.broadcast(a, shape) if a.size == 1 else self.reshape(a, shape)

    def times(self, a: Any, b: Any) -> Any:
        """The product."""
        return self.product(self._operand(a), self._operand(b))

    def total(self, terms: list[Any]) -> Any:
        """The sum of all; 0 if there are none."""
        return reduce(self.add, map(self._operand, terms)) if terms else self.constant(0)

    def entry_by_entry(
        self, function: Callable[..., list[Any]], columns: Sequence[Any], shape: Shape
    ) -> list[Any]:
        """All entries at once."""
        return [self.packed(one, shape) for one in function(*columns)]

    def _operand(self, a: Any) -> Slot:
        slot: Slot = self.constant(a) if isinstance(a, int) else a
        return slot

    # -- integers behind masks -----------------------------------------------------------------------

    def shifted(self, a: Any, by: int) -> Any:
        """``a >> by``."""
        if not self._is_few(a.shape):
            return self._arrays(shifted_array, a.shape, a, tail=f", {by}")
        a = self.reduced(a)
        text = each(f"{{0}} >> {by}", a.size, a)
        return self.trace.note(text, a, form=a.form, shape=a.shape, bits=max(a.bits - by, 0))

    def refuse_wrapped(self, c: Any, bits: int, mask_bits: int) -> None:
        """Give up a c that may have wrapped."""
        refuse = f"raise {self._name(wrapped)}({bits}, {mask_bits})"
        if self._is_few(c.shape):
            c = self.reduced(c)
            least = "{0}" if c.form == "one" else "min({0})"
            self.trace.do(f"if {least} >> {bits} == 0: {refuse}", c, kind="refusal")
        else:
            text = f"if {self._name(is_below)}({{0}}, {bits}).any(): {refuse}"
            self.trace.do(text, self.array(c), kind="refusal")

    # -- inputs --------------------------------------------------------------------------------------

    def mask_of(self, pad: Any, bits: int) -> Any:
        """The mask r that pads stand for."""
        if bits == input_mask.LONG:
            return pad
        if not self._is_few(pad.shape):
            text = f"{self._name(kernels.mask_words)}({{0}}, {bits})"
            return self.trace.note(
                text, self.array(pad), form="words", shape=pad.shape, bits=bits, reduced=False
            )
        pad, low = self.numbers(pad), (1 << bits) - 1
        text = each(f"-({{0}} & {low})", pad.size, pad)
        return self.trace.note(text, pad, form=pad.form, shape=pad.shape, bits=bits, reduced=False)

    def hidden(self, x: Any, r: Any, bits: int, norm: int) -> Any:
        """What the owner sends."""
        if bits == input_mask.LONG:
            if self._is_few(x.shape):
                return self.sub(x, r)
            text = f"{self._name(field.sub_from_int64)}({{0}}, {{1}})"
            return self.trace.note(text, x, self.array(r), form="many", shape=x.shape)
        ends = f"{norm}, {(1 << bits) - norm}"
        far = f"{self._name(kernels.far_inside)}({{0}}, {ends})"
        if self._is_few(x.shape):
            whole = "[{0}]" if x.form == "one" else "{0}"
            is_inside = self.trace.note(far.format(whole), r, form="other")
            difference = self.sub(x, r)
            text = f"if not {{1}}: {self._name(kernels.check_hidden)}({whole}, {ends})"
            self.trace.do(text, difference, is_inside)
            return self._known_as(difference, bits)
        is_inside = self.trace.note(far, r, form="other")
        text = f"{self._name(kernels.hidden_words)}({{0}}, {{1}}, {{2}}, {ends})"
        words = self.trace.note(text, x, r, is_inside, form="words", shape=x.shape, bits=bits, kind="effect")
        self._origins[words.name] = (x, r)
        return words

    def _known_as(self, a: Slot, bits: int) -> Slot:
        """The same integers, of which more is known."""
        return Slot(a.name, a.form, a.shape, bits, True, a.early)

    def encoded_words(self, words: Any, bits: int) -> Any:
        """Masked coordinates as bytes."""
        if bits == input_mask.LONG:
            return self.encoded(words)
        if self._is_few(words.shape):
            whole, cut = map(self._name, kernels.packing(words.size, input_mask.element_bytes(bits)))
            text = f"b''.join({cut}({whole}({'' if words.form == 'one' else '*'}{{0}})))"
            return self.trace.note(text, words, form="other")
        text = f"{self._name(to_bytes)}({self._name(input_mask.pack)}({{0}}, {bits}))"
        return self.trace.note(text, words, form="other")

    def decoded_words(self, raw: Any, shape: Shape, bits: int, norm: int) -> Any:
        """A peer's masked coordinates."""
        if bits == input_mask.LONG:
            return self.decoded(raw, shape)
        if not self._is_few(shape):
            text = f"{self._name(input_mask.unpack)}({{0}}, {shape}, {bits}, {norm})"
            return self.trace.note(text, raw.slot, form="words", shape=shape, bits=bits, kind="effect")
        size = input_mask.element_bytes(bits)
        read = ", ".join(map(self._name, kernels.unpacking(prod(shape), size)))
        text = f"{self._name(kernels.words_of)}({{0}}, {read}, {norm}, {(1 << bits) - norm})"
        words = self.trace.note(text, raw.slot, form="few", shape=shape, bits=bits, kind="effect")
        return self._first_or_all(words)

    def _first_or_all(self, a: Slot) -> Slot:
        """A list of integers, or the only one."""
        if a.size > 1:
            return a
        return self.trace.note("{0}[0]", a, form="one", shape=a.shape, bits=a.bits, reduced=a.reduced)

    def word_elements(self, words: Any, bits: int) -> Any:
        """As they are."""
        return words

    # -- frames, kernels, results --------------------------------------------------------------------

    def encoded(self, a: Any) -> Any:
        """Elements as bytes."""
        if self._is_few(a.shape):
            return self._joined(self.reduced(a), ELEMENT_BYTES)
        return self.trace.note(f"{self._name(to_bytes)}({{0}})", self.array(a), form="other")

    def _joined(self, a: Slot, size: int) -> Slot:
        octets = each(f"{{0}}.to_bytes({size}, 'little')", a.size, a)
        text = octets if a.form == "one" else f"b''.join({octets})"
        return self.trace.note(text, a, form="other")

    def decoded(self, raw: Any, shape: Shape) -> Any:
        """A peer's elements."""
        if not self._is_few(shape):
            text = f"{self._name(from_bytes)}({{0}}, {shape})"
            return self.trace.note(text, raw.slot, form="many", shape=shape, kind="effect")
        slot, count = raw.slot, prod(shape)
        if count == 1:
            return self.trace.note(
                f"{self._name(kernels.element_of)}({{0}})", slot, form="one", shape=shape, kind="effect"
            )
        text = f"{self._name(kernels.elements_of)}({{0}}, {self._name(kernels.cut(count, ELEMENT_BYTES))})"
        return self.trace.note(text, slot, form="few", shape=shape, kind="effect")

    def call(
        self, kernel: Callable[..., Any], shape: Shape | None, *operands: Any, refuses: bool = False
    ) -> Any:
        """The kernel on field elements, and on whatever else it is given."""
        text, slots = self._called(kernel, operands)
        form: Form = "other" if shape is None else "many"
        kind: Kind = "effect" if refuses else "value"
        return self.trace.note(text, *slots, form=form, shape=shape or (), kind=kind)

    def unreduced(self, kernel: Callable[..., Any], shape: Shape, *operands: Any) -> Any:
        """The same, and what it gives as elements."""
        text, slots = self._called(kernel, operands)
        if not self._is_few(shape):
            text = f"{self._name(unreduced.elements)}({text}).reshape({(*shape, 2)})"
            return self.trace.note(text, *slots, form="many", shape=shape)
        text, form = f"{self._name(unreduced.integers)}({text})", few(shape)
        bits = unreduced.INTEGER_BITS
        if form == "one":
            text += "[0]"
        return self.trace.note(text, *slots, form=form, shape=shape, bits=bits, reduced=False)

    def _called(self, kernel: Callable[..., Any], operands: Sequence[Any]) -> tuple[str, list[Slot]]:
        """The text of a call, and its operands."""
        places: list[str] = []
        slots: list[Slot] = []
        for operand in operands:
            if isinstance(operand, Received):
                operand = operand.slot
            if isinstance(operand, Slot):
                places.append(f"{{{len(slots)}}}")
                slots.append(operand if operand.form == "other" else self.array(operand))
            else:
                places.append(self._name(operand))
        return f"{self._name(kernel)}({', '.join(places)})", slots

    def opened(self, a: Any, frac: int, *, is_bit: bool) -> Any:
        """The result."""
        if a.shape == () and not is_bit:
            text = f"{self._name(kernels.decoded_element)}({{0}}, {frac})"
            return self.trace.note(text, self.reduced(a), form="other", kind="effect")
        text = f"{self._name(_ON_WORDS.opened)}({{0}}, {frac}, is_bit={is_bit})"
        return self.trace.note(text, self.array(a), form="other", kind="effect")

    def opened_bits(self, bits: Any, shape: Shape) -> Any:
        """The result."""
        text = f"{self._name(_ON_WORDS.opened_bits)}({{0}}, {shape})"
        return self.trace.note(text, bits, form="other", kind="effect")


class Received:
    """A frame of the peer's, to be cut."""

    def __init__(self, ring: TracedRing, slot: Slot, size: int) -> None:
        self._ring, self.slot, self._size = ring, slot, size

    def __getitem__(self, key: slice) -> Received:
        if key.step is not None:
            raise NotCompiled("a frame is cut in pieces")
        if (key.start, key.stop) == (0, self._size):
            return self
        text = f"{{0}}[{key.start}:{key.stop}]"
        return Received(
            self._ring, self._ring.trace.note(text, self.slot, form="other"), key.stop - key.start
        )
