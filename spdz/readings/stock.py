"""A stock of Beaver triples and input masks, for programs that the dealer was not told of.

The dealer usually deals for a known program, which is far cheaper online. A stock is dealt for none: it is
so many input masks, scalar triples and vector triples, and any program that multiplies with
:func:`spdz.beaver_multiply` and :func:`spdz.beaver_dot` may draw on it, in any order, until it is used up.
Cost online: that of the textbook protocol (Beaver, CRYPTO 1991). Secure as the MAC check is; each piece is
handed out once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from math import prod
from types import MappingProxyType

from spdz.arithmetic import field, inner_product
from spdz.dcf import Keys
from spdz.foundations.errors import TapeExhausted, TapeMismatch
from spdz.foundations.stats import Stats
from spdz.foundations.types import FieldArray, Security, Shape
from spdz.readings.party import Party
from spdz.readings.streams import JobStream
from spdz.rounds.mac_check import MacCheck
from spdz.values.engine import Input, Recipe, Share, Triple
from spdz.values.input_mask import LONG
from spdz.values.trees import TreeKey

SCALAR, VECTOR = "scalar triple", "vector triple"


@dataclass(frozen=True, slots=True)
class Stock:
    """How much is in a stock.

    Attributes:
        inputs: Input masks (coordinates) of party 0 and of party 1.
        scalar_triples: Triples for elementwise products.
        vector_triples: Triples for dot products, by the vectors' length.
    """

    inputs: tuple[int, int]
    scalar_triples: int = 0
    vector_triples: Mapping[int, int] = dataclass_field(default_factory=lambda: MappingProxyType({}))

    def deal(self, recipe: Recipe) -> None:
        """What the dealer deals, in the order in which :class:`StockedParty` loads it."""
        for owner, count in enumerate(self.inputs):
            recipe.input_mask(Input(owner, (count,), 0))
        recipe.triple(SCALAR, (self.scalar_triples,), (self.scalar_triples,), field.mul)
        for length, count in sorted(self.vector_triples.items()):
            recipe.triple(VECTOR, (count, length), (count,), inner_product.dot)


class StockedParty(Party):
    """A party that draws on a stock instead of on what was dealt for its program."""

    def __init__(
        self,
        stock: Stock,
        index: int,
        security: Security,
        stream: JobStream,
        mac_check: MacCheck | None,
        alpha: int | None,
        stats: Stats,
    ) -> None:
        """As :class:`Party`; ``stream`` holds the stock."""
        super().__init__(index, security, stream, mac_check, alpha, stats)
        loader = Party(index, security, stream, None, alpha, Stats())
        self._inputs = [
            _Pool("input masks", count, [loader.input_mask(Input(owner, (count,), 0))])
            for owner, count in enumerate(stock.inputs)
        ]
        size = stock.scalar_triples
        self._scalars = _Pool("scalar triples", size, loader.triple(SCALAR, (size,), (size,)))
        self._vectors = {
            length: _Pool(
                f"vector triples of length {length}",
                count,
                loader.triple(VECTOR, (count, length), (count,)),
            )
            for length, count in sorted(stock.vector_triples.items())
        }

    def input_mask(self, source: Input) -> tuple[FieldArray | None, FieldArray | None]:
        """So many masks of the stock."""
        (share,) = self._inputs[source.owner].take(prod(source.shape), (source.shape,))
        self._stats.book("input mask", prod(source.shape))
        return share

    def triple(self, kind: str, shape: Shape, product_shape: Shape) -> Triple:
        """So many triples of the stock."""
        count = prod(product_shape)
        if kind == SCALAR:
            pool = self._scalars
        elif shape[-1] in self._vectors:
            pool = self._vectors[shape[-1]]
        else:
            raise TapeExhausted(f"the stock holds no vector triples of length {shape[-1]}")
        a, b, c = pool.take(count, (shape, shape, product_shape))
        self._stats.book(kind, count)
        return _dealt(a), _dealt(b), _dealt(c)

    def authenticated(
        self, shape: Shape, *, count: tuple[str, int] | None = None, stored_by: int = 1
    ) -> Share:
        """A stock has nothing that depends on a program."""
        raise TapeMismatch(
            f"a stock serves Beaver products only, not a {count[0] if count else 'gate'}: use beaver_dot "
            "and beaver_multiply, or deal for this program"
        )

    def input_mask_bits(self, source: Input) -> int:
        """A stock's masks serve any input."""
        return LONG

    @property
    def fully_drawn(self) -> bool:
        """A stock need not be used up."""
        return True

    def comparison_key(self, shape: Shape, bits: int, width: int) -> Keys:
        """As :meth:`authenticated`."""
        raise TapeMismatch("a stock holds no comparison keys: deal for this program")

    def tree(self, kind: str, shape: Shape, levels: int, *, top: bool) -> TreeKey:
        """As :meth:`authenticated`."""
        raise TapeMismatch("a stock holds no comparison keys: deal for this program")


class _Pool:
    """Shares of so many alike pieces, handed out from front to back."""

    def __init__(
        self, what: str, count: int, shares: Sequence[tuple[FieldArray | None, FieldArray | None]]
    ) -> None:
        self._what, self._count, self._shares, self._used = what, count, shares, 0

    def take(
        self, count: int, shapes: tuple[Shape, ...]
    ) -> list[tuple[FieldArray | None, FieldArray | None]]:
        """The next ``count`` pieces of every share, in the given shapes."""
        if self._used + count > self._count:
            raise TapeExhausted(
                f"the stock's {self._what} are used up: {self._count} dealt, {self._used} used, {count} more "
                "asked for; deal a larger stock"
            )
        piece = slice(self._used, self._used + count)
        self._used += count
        return [
            (_cut(value, piece, shape), _cut(mac, piece, shape))
            for (value, mac), shape in zip(self._shares, shapes, strict=True)
        ]


def _cut(part: FieldArray | None, piece: slice, shape: Shape) -> FieldArray | None:
    return None if part is None else part[piece].reshape((*shape, 2))


def _dealt(share: tuple[FieldArray | None, FieldArray | None]) -> Share:
    value, mac = share
    if value is None:
        raise TapeMismatch("a triple has a value at both parties")
    return value, mac
