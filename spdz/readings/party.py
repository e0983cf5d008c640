"""A party's engine: one job of a tape, read in the order in which the dealer dealt it.

A job is two byte strings, drawn from front to back: a *pad*, expanded from the job's key, and a stored
*correction*. Which draw comes from which follows from one convention, shared with the dealer:

- input mask of party i: the value is pad at i; the MAC share is pad at 1 - i and correction at i;
- any other dealt value: the value share is pad at party 0 and correction at party 1; the MAC share is
  pad at party 1 and correction at party 0;
- a random triple component: as before, but the value share is pad at both.

So every share has its own place in a pseudo-random stream, and the parties store as little as possible.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from spdz import dcf
from spdz.arithmetic import field
from spdz.arithmetic.prf import expand
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import FieldRing, elements
from spdz.foundations.errors import TapeDamaged
from spdz.foundations.stats import Stats
from spdz.foundations.types import Block, Buffer, FieldArray, Security, Shape
from spdz.rounds.mac_check import MacCheck
from spdz.rounds.wire import ELEMENT_BYTES, exchange_elements
from spdz.values import input_mask
from spdz.values.engine import Evaluation, Gate, Input, Share, Triple
from spdz.values.value import Value

_RING = FieldRing()


class JobStream:
    """The pad and the correction of one job, consumed from front to back."""

    __slots__ = ("_blocks", "_correction", "_correction_at", "_pad", "_pad_at")

    def __init__(self, key: bytes, pad_bytes: int, correction: Buffer) -> None:
        self._blocks = expand(key, pad_bytes)
        self._pad = field.from_blocks(self._blocks)
        self._correction = memoryview(correction)
        self._pad_at = self._correction_at = 0

    def _next(self, count: int) -> slice:
        start, self._pad_at = self._pad_at, self._pad_at + count
        if self._pad_at > len(self._pad):
            raise TapeDamaged("the job's pad is shorter than the program needs")
        return slice(start, self._pad_at)

    def pad_blocks(self, shape: Shape) -> Block:
        """The next pseudo-random 128-bit blocks."""
        return self._blocks[self._next(prod(shape))].reshape((*shape, 2))

    def pad(self, shape: Shape) -> FieldArray:
        """The next pseudo-random field elements."""
        return self._pad[self._next(prod(shape))].reshape((*shape, 2))

    def correction_bytes(self, size: int) -> memoryview:
        """The next stored bytes."""
        start, self._correction_at = self._correction_at, self._correction_at + size
        if self._correction_at > len(self._correction):
            raise TapeDamaged("the job's record is shorter than the program needs")
        return self._correction[start : self._correction_at]

    def correction(self, shape: Shape) -> FieldArray:
        """The next stored field elements."""
        raw = self.correction_bytes(ELEMENT_BYTES * prod(shape))
        return np.frombuffer(raw, dtype=np.uint64).reshape((*shape, 2))

    @property
    def exhausted(self) -> bool:
        """Whether the whole job has been drawn."""
        return self._pad_at == len(self._pad) and self._correction_at == len(self._correction)


class Party(Evaluation):
    """One party running one job.

    Args:
        index: 0 or 1.
        security: The security model.
        stream: The job's correlations.
        mac_check: The session's check, shared by all jobs of the session; None in semi-honest mode.
        alpha: This party's share of the MAC key; None in semi-honest mode.
        stats: Where correlations used are counted.
    """

    def __init__(
        self,
        index: int,
        security: Security,
        stream: JobStream,
        mac_check: MacCheck | None,
        alpha: int | None,
        stats: Stats,
    ) -> None:
        self.index, self.security, self.ring = index, security, _RING
        self.alpha = alpha
        self._stream, self._mac_check, self._stats = stream, mac_check, stats

    def __repr__(self) -> str:
        return f"<{self.security} party {self.index}>"

    def read(self, gate: Gate, *operands: Any) -> Any:
        """Evaluate a gate."""
        return gate.evaluate(self, *operands)

    @property
    def has_unchecked_openings(self) -> bool:
        """Whether the session has unchecked openings."""
        return self._mac_check is not None and self._mac_check.pending

    # -- public numbers ------------------------------------------------------------------------------

    def shared(self, x: Value) -> Value:
        """``[[x]] = eps + [[r]]``."""
        if not x.masked:
            return x
        eps, *shares = x.parts
        share = Value(self, tuple(shares), x.shape, x.frac, x.bound, is_bit=x.is_bit)
        return self.plus_public(share, eps)

    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """Add public integers: to eps of a masked value, else to party 0's share and to the MAC."""
        number = elements(raw)
        if x.masked:
            return field.add(x.parts[0], number), *x.parts[1:]
        return self.plus_public(x, number).parts

    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """Public numbers move from the share of r to eps."""
        number = np.broadcast_to(field.from_int(raw), (*x.shape, 2))
        eps, *shares = x.parts
        share = Value(self, tuple(shares), x.shape, x.frac, x.bound)
        return field.add(eps, number), *self.plus_public(share, field.neg(number)).parts

    def plus_public(self, x: Value, public: FieldArray) -> Value:
        """Party 0 adds to its share; both to the MAC."""
        value, *macs = x.parts
        if self.index == 0:
            value = public if value is None else field.add(value, public)
        elif value is None:
            value = np.zeros_like(public)
        if macs and self.alpha is not None:
            macs = [field.add(macs[0], field.scale(public, self.alpha))]
        return Value(self, (value, *macs), x.shape, x.frac, x.bound, is_bit=x.is_bit)

    # -- what was dealt ------------------------------------------------------------------------------

    def input_mask(self, source: Input) -> tuple[FieldArray | None, FieldArray | None]:
        """The mask itself at the owner; a MAC share at both."""
        self._stats.book("input mask", prod(source.shape))
        own = source.owner == self.index
        mask = None
        if own:
            pad = self._stream.pad(source.shape)
            mask = input_mask.from_pad(pad, self.input_mask_bits(source))
        return mask, self._mac(source.shape, stored=own)

    def authenticated(self, shape: Shape, *, count: tuple[str, int] | None = None) -> Share:
        """This party's shares of the next dealt value."""
        if count is not None:
            self._stats.book(*count)
        value = self._stream.pad(shape) if self.index == 0 else self._stream.correction(shape)
        return value, self._mac(shape, stored=self.index == 0)

    def triple(self, kind: str, shape: Shape, product_shape: Shape) -> Triple:
        """This party's shares of the next Beaver triple."""
        a, b = ((self._stream.pad(shape), self._mac(shape, stored=self.index == 0)) for _ in range(2))
        return a, b, self.authenticated(product_shape, count=(kind, prod(product_shape)))

    @property
    def fully_drawn(self) -> bool:
        """Whether the job is used up."""
        return self._stream.exhausted

    def comparison_key(self, shape: Shape, bits: int, width: int) -> tuple[Block, Buffer]:
        """Root seeds from the pad, correction words from the record."""
        size, payloads = prod(shape), 2 * width if self.malicious else width
        roots = self._stream.pad_blocks((size,))
        return roots, self._stream.correction_bytes(dcf.key_bytes(size, bits, payloads))

    def _mac(self, shape: Shape, *, stored: bool) -> FieldArray | None:
        if not self.malicious:
            return None
        return self._stream.correction(shape) if stored else self._stream.pad(shape)

    # -- openings ------------------------------------------------------------------------------------

    async def open(self, *values: Value) -> list[FieldArray]:
        """Exchange value shares; every opening is recorded for the next MAC check."""
        own = [value.parts[0] for value in values]
        theirs = await exchange_elements(own, [value.shape for value in values])
        opened = [field.add(a, b) for a, b in zip(own, theirs, strict=True)]
        if self._mac_check is not None:
            for value, number in zip(values, opened, strict=True):
                self._mac_check.record(number, value.parts[1])
        return opened
