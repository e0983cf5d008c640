"""All that a party's gates do with numbers, here on NumPy words.

Gates say *what* is computed and why; how, is said here. So their text can be read in two ways: as it runs, by
this ring, and once beforehand, by one that writes down what it is asked for (:mod:`spdz.compiled.ring`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import element, field, inner_product, unreduced
from spdz.arithmetic.bits import is_below, shifted
from spdz.arithmetic.element import Element
from spdz.arithmetic.fixed_point import decode
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import elements
from spdz.foundations.errors import ProtocolViolation, Wrapped
from spdz.foundations.types import BigIntArray, Buffer, FieldArray, IntArray, Shape
from spdz.rounds.wire import from_bytes, to_bytes
from spdz.values import input_mask
from spdz.values.outer import OuterRing

_FEW = 32  # entries up to which Python integers are faster than array kernels (measured)


class PartyRing(OuterRing):
    """F_p on NumPy words, integers behind masks, frames, and the result."""

    # -- elements ------------------------------------------------------------------------------------

    def constant(self, raw: Raw) -> FieldArray:
        """Public raw integers mod p."""
        return elements(raw)

    def zeros(self, shape: Shape) -> FieldArray:
        """Zero elements."""
        return field.zeros(shape)

    def product(self, a: FieldArray, b: FieldArray) -> FieldArray:
        """Elementwise product mod p."""
        return field.mul(a, b)

    def scaled(self, a: FieldArray, factor: int) -> FieldArray:
        """Elementwise product with one element that this party knows: its share of the MAC key."""
        return field.scale(a, factor)

    def prepared(self, a: FieldArray) -> Any:
        """A vector that goes into several dot products."""
        return inner_product.prepare(a)

    def dot(self, a: Any, b: Any) -> FieldArray:
        """Dot products over the last axis mod p."""
        return inner_product.dot(a, b)

    def short_dot(self, x: IntArray, b: Any) -> FieldArray:
        """The same of the own raw input, |x| < 2^40."""
        return inner_product.small_dot(x, b)

    # -- elements that are single integers where they are single -------------------------------------

    def unpacked(self, a: FieldArray) -> Element:
        """As an integer if it is single."""
        return element.unpack(a)

    def packed(self, a: Element, shape: Shape) -> FieldArray:
        """As an array; what is single is broadcast."""
        return element.pack(a, shape)

    def times(self, a: Element, b: Element) -> Element:
        """The product."""
        return element.times(a, b)

    def total(self, terms: list[Element]) -> Element:
        """The sum of all; 0 if there are none."""
        return element.total(terms)

    def entry_by_entry(
        self, function: Callable[..., list[Element]], columns: Sequence[FieldArray], shape: Shape
    ) -> list[FieldArray]:
        """``function`` of so many columns, for few entries one after the other."""
        count = int(np.prod(shape))
        if not 0 < count <= _FEW:
            return [element.pack(one, shape) for one in function(*columns)]
        results = [function(*entry) for entry in zip(*map(field.to_list, columns), strict=True)]
        return [field.from_ints(numbers).reshape((*shape, 2)) for numbers in zip(*results, strict=True)]

    # -- integers behind masks -----------------------------------------------------------------------

    def shifted(self, a: FieldArray, by: int) -> FieldArray:
        """``a >> by`` on elements as integers."""
        return shifted(a, by)

    def refuse_wrapped(self, c: FieldArray, bits: int, mask_bits: int) -> None:
        """Give up a c that may have wrapped: whatever its mask, it is then below 2^bits."""
        if is_below(c, bits).any():
            raise wrapped(bits, mask_bits)

    # -- inputs --------------------------------------------------------------------------------------

    def mask_of(self, pad: FieldArray, bits: int) -> FieldArray:
        """The mask r that pads stand for."""
        return input_mask.from_pad(pad, bits)

    def hidden(self, x: IntArray, r: FieldArray, bits: int, norm: int) -> npt.NDArray[Any]:
        """What the owner sends: elements ``x - r``, or words ``x + s``."""
        return input_mask.hide(x, r, bits, norm)

    def encoded_words(self, words: npt.NDArray[Any], bits: int) -> Buffer:
        """Masked coordinates as bytes."""
        return to_bytes(words if bits == input_mask.LONG else input_mask.pack(words, bits))

    def decoded_words(self, raw: Buffer, shape: Shape, bits: int, norm: int) -> npt.NDArray[Any]:
        """A peer's masked coordinates."""
        return (
            from_bytes(raw, shape) if bits == input_mask.LONG else input_mask.unpack(raw, shape, bits, norm)
        )

    def word_elements(self, words: npt.NDArray[Any], bits: int) -> FieldArray:
        """Masked coordinates as elements."""
        return words if bits == input_mask.LONG else input_mask.as_elements(words)

    # -- frames, kernels, results --------------------------------------------------------------------

    def encoded(self, a: FieldArray) -> Buffer:
        """Elements as bytes."""
        return to_bytes(a)

    def decoded(self, raw: Buffer, shape: Shape) -> FieldArray:
        """A peer's elements; ProtocolViolation if one is not below p."""
        return from_bytes(raw, shape)

    def call(
        self, kernel: Callable[..., Any], shape: Shape | None, *operands: Any, refuses: bool = False
    ) -> Any:
        """What no reading looks into: ``kernel(*operands)``, elements of a shape, or anything else (None).

        Args:
            kernel: The function.
            shape: Of its result; None where that is no array of elements.
            operands: What it takes.
            refuses: Whether it may raise because of what the peer has sent.
        """
        return kernel(*operands)

    def unreduced(self, kernel: Callable[..., IntArray], shape: Shape, *operands: Any) -> FieldArray:
        """The same for a kernel whose elements are words to be reduced (:mod:`spdz.arithmetic.unreduced`)."""
        return unreduced.elements(kernel(*operands)).reshape((*shape, 2))

    def opened(self, a: FieldArray, frac: int, *, is_bit: bool) -> Any:
        """An opened result as the user gets it: see :func:`decoded`."""
        return decoded(field.centered(a), frac, is_bit=is_bit)

    def opened_bits(self, bits: npt.NDArray[np.bool_], shape: Shape) -> Any:
        """Opened bits as the user gets them: booleans of a shape."""
        return bits.reshape(shape) if shape else bool(bits[0])


def decoded(integers: BigIntArray, frac: int, *, is_bit: bool) -> Any:
    """A result as the user gets it: float(s) of so many fractional bits, or bool(s).

    Raises:
        ProtocolViolation: if a bit is neither 0 nor 1.
    """
    if not is_bit:
        return decode(integers if integers.ndim else integers.item(), frac)
    if not all(bit in (0, 1) for bit in integers.flat):
        raise ProtocolViolation("an opened bit is neither 0 nor 1: the peer's input was out of range")
    return integers.astype(np.bool_) if integers.ndim else bool(integers.item())


def wrapped(bits: int, mask_bits: int) -> Wrapped:
    """What to raise for an opened number that may have wrapped."""
    return Wrapped(
        f"an opened number may have wrapped behind its mask, which happens once in 2^{mask_bits - bits} "
        "times: nothing was output; run the next job"
    )
