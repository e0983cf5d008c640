"""What a value is to the meter: the identity of the expression that computes it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spdz.arithmetic.public import Raw
from spdz.foundations.types import Shape


@dataclass(frozen=True, slots=True)
class Symbol:
    """A value's identity: how it is computed, without and with the public constants."""

    recipe: bytes
    text: bytes


def digest(*items: object) -> bytes:
    """Hash a sequence of byte strings, numbers and names, unambiguously."""
    encoded = (item if isinstance(item, bytes) else repr(item).encode() for item in items)
    return hashlib.sha256(b"".join(len(item).to_bytes(8, "little") + item for item in encoded)).digest()


def symbol_of(*items: object) -> Symbol:
    """The symbol of an expression whose operands may be symbols."""
    recipe, text = (
        digest(*(getattr(item, side) if isinstance(item, Symbol) else item for item in items))
        for side in ("recipe", "text")
    )
    return Symbol(recipe, text)


def public_numbers(raw: Raw) -> tuple[Shape, bytes]:
    """The shape of public numbers, and a digest of them."""
    array = np.asarray(raw, dtype=object)
    return array.shape, digest(*(int(entry) for entry in array.flat))


class SymbolRing:
    """Linear maps on symbols."""

    def add(self, a: Symbol, b: Symbol) -> Symbol:
        """Sum."""
        return symbol_of("add", a, b)

    def sub(self, a: Symbol, b: Symbol) -> Symbol:
        """Difference."""
        return symbol_of("sub", a, b)

    def neg(self, a: Symbol) -> Symbol:
        """Negation."""
        return symbol_of("neg", a)

    def scale(self, a: Symbol, factor: Raw) -> Symbol:
        """Product with public numbers, which the dealer must know."""
        return symbol_of("scale", a, *public_numbers(factor))

    def sum(self, a: Symbol, axis: int) -> Symbol:
        """Sum over an axis."""
        return symbol_of("sum", a, axis)

    def index(self, a: Symbol, key: tuple[Any, ...]) -> Symbol:
        """Indexing."""
        return symbol_of("index", a, key)

    def reshape(self, a: Symbol, shape: Shape) -> Symbol:
        """Another shape."""
        return symbol_of("reshape", a, shape)

    def broadcast(self, a: Symbol, shape: Shape) -> Symbol:
        """A larger shape."""
        return symbol_of("broadcast", a, shape)

    def concatenate(self, parts: Sequence[Symbol], shapes: Sequence[Shape]) -> Symbol:
        """End to end."""
        return symbol_of("concatenate", *parts, *shapes)
