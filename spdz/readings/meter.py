"""The meter: a program read for its costs and its identity, without data.

It reads the dealer's text of every gate with *symbols* in place of masks, so it knows beforehand what
the dealer will deal and what the parties will draw: the length of the pads and corrections, rounds,
elements and correlations. The symbols double as the program's fingerprint: two programs have the same
recipe if and only if one's tapes serve the other. Public constants that are added (thresholds) are left
out of the recipe, and are in the text.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from spdz import dcf
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.arithmetic.public import Raw
from spdz.dcf.keys import record_bytes
from spdz.foundations.types import Block, FieldArray, Security, Shape, check_security
from spdz.readings.program import Program, declare, run
from spdz.readings.stock import Stock
from spdz.readings.streams import per_record
from spdz.readings.symbols import Symbol, SymbolRing, digest, public_numbers, symbol_of
from spdz.rounds.coroutine import Check, Request, exchange, run_silently
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.values import input_mask
from spdz.values.engine import Gate, Input, Recipe
from spdz.values.trees import TreePads
from spdz.values.value import Value


@dataclass(frozen=True, slots=True)
class Plan:
    """What the meter saw.

    Attributes:
        inputs: Both inputs, without data.
        pad_bytes: Pseudo-random bytes that each party draws a job.
        correction_bytes: Stored bytes that each party draws a job.
        rounds: Exchanges, MAC checks included.
        elements_sent: Field elements that each party sends.
        correlations: Correlations used, by kind.
        recipe: Hex fingerprint of what must be dealt.
        text: Hex fingerprint of the program with its public constants.
    """

    inputs: tuple[Input, Input]
    pad_bytes: tuple[int, int]
    correction_bytes: tuple[int, int]
    rounds: int
    elements_sent: tuple[int, int]
    correlations: Counter[str]
    recipe: str
    text: str


class Meter(Recipe):
    """The dealer's reading without data.

    Attributes:
        rounds: Exchanges and checks.
        openings: Rounds that open field elements.
        bits_sent: Bits opened.
        opened_bits: Whether what was opened last were bits.
        repeatable: Whether everything opened is checked before anything that depends on it is sent. Then a
            run that was broken off can be run again on the same inputs: a party sends the same bytes,
            whatever the other one did. In the semi-honest mode it does so anyway.
    """

    def __init__(self, security: Security, lead: Shape = ()) -> None:
        """Args: the security model, and the axes that count records where a gallery is metered."""
        check_security(security)
        self.security, self.lead = security, lead
        self.ring = SymbolRing()
        self.pad_bytes, self.correction_bytes = [0, 0], [0, 0]
        self.elements_sent = [0, 0]
        self.rounds = self.openings = self.bits_sent = 0
        self.opened_bits = False
        self.repeatable = True
        self.correlations: Counter[str] = Counter()
        self.trace: list[Symbol] = []
        self._unchecked = False
        self._now: set[str] = set()
        self._open = False

    @property
    def has_unchecked_openings(self) -> bool:
        """Whether an opening waits for a check."""
        return self._unchecked

    def _read(self, gate: Gate, *operands: Any) -> Any:
        """Read the dealer's text."""
        return gate.deal(self, *operands)

    def shared(self, x: Value) -> Value:
        """The same symbol as a shared value."""
        return Value(self, x.parts, x.shape, x.frac, x.bound, is_bit=x.is_bit)

    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """Only the text sees a public constant."""
        (symbol,) = x.parts
        return (Symbol(symbol.recipe, digest("plus", symbol.text, *public_numbers(raw))),)

    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """The same symbol: what it stands for is the same number."""
        return x.parts

    def shared_value(
        self, kind: str, of: tuple[Value, ...], shape: Shape, frac: int, bound: Bound, *, is_bit: bool = False
    ) -> Value:
        """A new symbol made of the operands'."""
        symbol = self._note(kind, shape, frac, *(operand.parts[0] for operand in of))
        return Value(self, (symbol,), shape, frac, bound, is_bit=is_bit)

    def masked_value(
        self,
        kind: str,
        of: tuple[Value, ...],
        shape: Shape,
        frac: int,
        bound: Bound,
        make: Callable[[], FieldArray],
        *,
        mask_bits: int = 127,
        span: int = 0,
        count: tuple[str, int] | None = None,
    ) -> Value:
        """A new symbol, as for a shared value."""
        self.authenticated(shape, make, of=of, count=count)
        symbol = self._note(kind, shape, frac, *(operand.parts[0] for operand in of))
        return Value(self, (symbol,), shape, frac, bound, masked=True, mask_bits=mask_bits, span=span)

    def input_mask(self, source: Input) -> Value:
        """N pad elements at the owner; with MACs N more at the peer and N stored at the owner."""
        size = self._size(source.shape)
        self._draw(source.owner, pad=size)
        if self.malicious:
            self._draw(1 - source.owner, pad=size)
            self._draw(source.owner, correction=size)
        self.correlations["input mask"] += size
        bits, bound = self.input_mask_bits(source), Bound.of_norm(source.norm)
        kind = (source.owner, source.shape, source.norm, source.proved, bits)
        symbol = self._note("input", *kind, len(self.trace))
        span = input_mask.span(bits)
        return Value(self, (symbol,), source.shape, FRACTION_BITS, bound, masked=True, span=span)

    def authenticated(
        self,
        shape: Shape,
        make: Callable[[], FieldArray],
        *,
        of: tuple[Value, ...] = (),
        count: tuple[str, int] | None = None,
        stored_by: int = 1,
    ) -> None:
        """One pad element at either party, and one stored where MACs are."""
        self._note("dealt", shape, count, stored_by, *(operand.parts[0] for operand in of))
        size = self._size(shape)
        self._draw(1 - stored_by, pad=size)
        self._draw(stored_by, correction=size)
        if self.malicious:
            self._draw(stored_by, pad=size)
            self._draw(1 - stored_by, correction=size)
        if count is not None:
            self.correlations[count[0]] += count[1]

    def triple(
        self,
        kind: str,
        shape: Shape,
        product_shape: Shape,
        product: Callable[[FieldArray, FieldArray], FieldArray],
    ) -> None:
        """Random a and b cost pads alone (and MAC corrections); the product is an authenticated value."""
        self._note(kind, shape, product_shape)
        for _ in range(2):
            self._draw(0, pad=self._size(shape))
            self._draw(1, pad=self._size(shape))
            if self.malicious:
                self._draw(1, pad=self._size(shape))
                self._draw(0, correction=self._size(shape))
        self.authenticated(product_shape, lambda: product(None, None), count=(kind, prod(product_shape)))  # type: ignore[arg-type]

    def uniform_below(self, limit: int, shape: Shape) -> FieldArray:
        """No data."""
        return np.zeros((0, 2), dtype=np.uint64)

    def comparison_key(
        self, shape: Shape, bits: int, width: int, make: Callable[[], tuple[FieldArray, FieldArray]]
    ) -> None:
        """A root seed at either party, the same correction words at both."""
        self._note("comparison key", shape, bits, width)
        size, payloads = self._size(shape), 2 * width if self.malicious else width
        for party in (0, 1):
            self._draw(party, pad=size)
            self.correction_bytes[party] += (
                record_bytes(size, bits, payloads) if self.lead else dcf.key_bytes(size, bits, payloads)
            )

    def tree(
        self,
        kind: str,
        z: Value,
        levels: int,
        make: Callable[[TreePads], tuple[Block, Block, Block | None]],
        *,
        top: bool,
    ) -> None:
        """The words at both; ``first`` pad at party 1 and stored at 0, ``top`` the other way round."""
        self._note("tree", kind, z.shape, levels, top, z.parts[0])
        size = self._size(z.shape)
        if not self.lead:  # in a gallery Delta and hash key are the tile's
            for party in (0, 1):
                self._draw(party, pad=1, correction=1)
        self._draw(1, pad=size)
        self._draw(0, correction=size)
        if top:
            self._draw(0, pad=size)
            self._draw(1, correction=size)
        for party in (0, 1):
            self._draw(party, correction=size * (levels - 1))
        self.correlations[kind.split(" of ")[0]] += prod(z.shape)

    async def opening_bits(self, bits: int) -> None:
        """Count one round."""
        self.bits_sent += bits
        await self._opening("bits", (0, 0))

    async def round(self, sent: tuple[int, int]) -> None:
        """Count one round."""
        for party in (0, 1):
            self.elements_sent[party] += sent[party]
        await exchange([], 0, 0)

    async def opening(self, elements: int) -> None:
        """Count one round whose openings wait for a check."""
        await self._opening("elements", (elements, elements))

    async def _opening(self, what: str, sent: tuple[int, int]) -> None:
        self.opened_bits = what == "bits"
        self._unchecked = self.malicious
        self._now.add(what)
        await self.round(sent)

    def _size(self, shape: Shape) -> int:
        """Entries of an array, of one record where a gallery is metered."""
        return per_record(shape, self.lead)

    def _note(self, *items: object) -> Symbol:
        """Add a draw or a result to the trace, whose order is the drawing order."""
        symbol = symbol_of(*items)
        self.trace.append(symbol)
        return symbol

    def _draw(self, party: int, *, pad: int = 0, correction: int = 0) -> None:
        self.pad_bytes[party] += ELEMENT_BYTES * pad
        self.correction_bytes[party] += ELEMENT_BYTES * correction

    def on_request(self, request: Request) -> None:
        """See the rounds as the outermost driver does."""
        self.rounds += 1
        if isinstance(request, Check):
            self._unchecked = self._open = False
        elif self._now:
            self.openings += "elements" in self._now
            self.repeatable &= not self._open
            self._open = self.malicious
            self._now.clear()


def measure(program: Program, shapes: tuple[Shape, Shape], security: Security) -> Plan:
    """Read a program with the meter.

    Args:
        program: The program.
        shapes: Shapes of party 0's and party 1's input.
        security: The security model.

    Returns:
        What the dealer will deal and the parties will draw and send.
    """
    meter = Meter(security)
    inputs = declare(program, shapes)
    run_silently(run(meter, program, inputs), meter.on_request)
    kind = (security, shapes)
    return Plan(
        inputs=inputs,
        pad_bytes=(meter.pad_bytes[0], meter.pad_bytes[1]),
        correction_bytes=(meter.correction_bytes[0], meter.correction_bytes[1]),
        rounds=meter.rounds,
        elements_sent=(meter.elements_sent[0], meter.elements_sent[1]),
        correlations=meter.correlations,
        recipe=digest("recipe", kind, *(symbol.recipe for symbol in meter.trace)).hex(),
        text=digest("text", kind, *(symbol.text for symbol in meter.trace)).hex(),
    )


def measure_stock(stock: Stock, security: Security) -> tuple[int, int]:
    """Pad bytes of both parties for a stock of triples."""
    meter = Meter(security)
    stock.deal(meter)
    return meter.pad_bytes[0], meter.pad_bytes[1]
