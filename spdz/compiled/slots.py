"""Slots: what stands for a party's numbers while its reading is written down.

A slot is a variable of the code to come. Its form says what that variable will hold:

=======  =====================================================================================
one      a single element: a Python integer v with |v| < 2^bits, right mod p
few      up to FEW elements: a sequence of such integers, in C order
many     field elements of shape S + (2,), canonical (:mod:`spdz.arithmetic.field`)
words    short integers: ``int64`` of shape S, |v| < 2^bits
dealt    elements at a known place of the tape, not yet read in any form
other    anything else: bytes, keys, results
=======  =====================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Any, Literal, NoReturn

from spdz.foundations.types import Shape

FEW = 64
"""Up to so many elements Python integers are quicker than array kernels (measured)."""

Form = Literal["one", "few", "many", "words", "dealt", "other"]


class NotCompiled(Exception):
    """A program asks for what is not written down as code; it is read as it runs."""


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """A variable of the code.

    Attributes:
        name: Its name, or the literal that it is.
        form: What it holds (see the module's table).
        shape: Of the elements.
        bits: Of the integers, where it holds some.
        reduced: Whether all of them are in [0, p).
        early: Whether it depends on the tape alone.
        place: Of what was dealt: ("pad" or "stored", the first element).
    """

    name: str
    form: Form
    shape: Shape
    bits: int = 127
    reduced: bool = True
    early: bool = False
    place: tuple[str, int] | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def literal(self) -> int | None:
        """The number, where it is known."""
        return int(self.name.strip("()")) if self.name.strip("()-").isdigit() else None

    def _refuse(self, *operands: Any) -> NoReturn:
        raise NotCompiled("this step looks at numbers that are not there yet")

    __array__ = __bool__ = __len__ = __iter__ = __int__ = __index__ = _refuse
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __and__ = __xor__ = __rshift__ = _refuse

    def __getattr__(self, name: str) -> Any:
        raise NotCompiled(f"this step asks for {name!r} of numbers that are not there yet")
