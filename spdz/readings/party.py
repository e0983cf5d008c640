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
import numpy.typing as npt

from spdz.arithmetic.public import Raw
from spdz.dcf import Keys
from spdz.foundations.stats import Stats
from spdz.foundations.types import Block, FieldArray, Security, Shape
from spdz.readings.streams import JobStream, RecordStream
from spdz.rounds.coroutine import exchange
from spdz.rounds.mac_check import MacCheck, unrecorded
from spdz.rounds.wire import ELEMENT_BYTES, element_bytes
from spdz.values.engine import Evaluation, Gate, Input, Share, Triple
from spdz.values.party_ring import PartyRing
from spdz.values.sign_shares import opened_signs, packed_signs, sign_macs
from spdz.values.trees import TreeKey, of_party
from spdz.values.value import Value

_RING = PartyRing()


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
        stream: JobStream | RecordStream,
        mac_check: MacCheck | None,
        alpha: int | None,
        stats: Stats,
    ) -> None:
        self.index, self.security, self.ring = index, security, _RING
        self.alpha = alpha
        self._stream, self._mac_check, self._stats = stream, mac_check, stats

    def __repr__(self) -> str:
        return f"<{self.security} party {self.index}>"

    def _read(self, gate: Gate, *operands: Any) -> Any:
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
            x.decide()
            return x
        eps, *shares = x.parts
        share = Value(self, tuple(shares), x.shape, x.frac, x.bound, is_bit=x.is_bit)
        return self.plus_public(share, eps)

    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """Add public integers: to eps of a masked value, else to party 0's share and to the MAC."""
        number = self.ring.constant(raw)
        if x.masked:
            return self.ring.add(x.parts[0], number), *x.parts[1:]
        return self.plus_public(x, number).parts

    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """Public numbers move from the share of r to eps."""
        ring, (eps, *shares) = self.ring, x.parts
        number = ring.broadcast(ring.constant(raw), x.shape)
        share = Value(self, tuple(shares), x.shape, x.frac, x.bound)
        return ring.add(eps, number), *self.plus_public(share, ring.neg(number)).parts

    def plus_public(self, x: Value, public: FieldArray) -> Value:
        """Party 0 adds to its share; both to the MAC."""
        ring, (value, *macs) = self.ring, x.parts
        if self.index == 0:
            value = public if value is None else ring.add(value, public)
        elif value is None:
            value = ring.zeros(x.shape)
        if macs and self.alpha is not None:
            macs = [ring.add(macs[0], ring.scaled(public, self.alpha))]
        return Value(self, (value, *macs), x.shape, x.frac, x.bound, is_bit=x.is_bit)

    # -- what was dealt ------------------------------------------------------------------------------

    def input_mask(self, source: Input) -> tuple[FieldArray | None, FieldArray | None]:
        """The mask itself at the owner; a MAC share at both."""
        self._stats.book("input mask", prod(source.shape))
        own = source.owner == self.index
        mask = None
        if own:
            pad = self._stream.pad(source.shape)
            mask = self.ring.mask_of(pad, self.input_mask_bits(source))
        return mask, self._mac(source.shape, stored=own)

    def authenticated(
        self, shape: Shape, *, count: tuple[str, int] | None = None, stored_by: int = 1
    ) -> Share:
        """This party's shares of the next dealt value."""
        if count is not None:
            self._stats.book(*count)
        stored = self.index == stored_by
        value = self._stream.correction(shape) if stored else self._stream.pad(shape)
        return value, self._mac(shape, stored=not stored)

    def triple(self, kind: str, shape: Shape, product_shape: Shape) -> Triple:
        """This party's shares of the next Beaver triple."""
        a, b = ((self._stream.pad(shape), self._mac(shape, stored=self.index == 0)) for _ in range(2))
        return a, b, self.authenticated(product_shape, count=(kind, prod(product_shape)))

    @property
    def fully_drawn(self) -> bool:
        """Whether the job is used up."""
        return self._stream.exhausted

    def comparison_key(self, shape: Shape, bits: int, width: int) -> Keys:
        """Root seeds from the pad, correction words stored."""
        return self._stream.keys(self.index, shape, bits, 2 * width if self.malicious else width)

    def tree(self, kind: str, shape: Shape, levels: int, *, top: bool) -> TreeKey:
        """Delta from the pad; ``first`` is party 1's pad, ``top`` party 0's, and the rest is stored."""
        self._stats.book(kind, prod(shape))
        return draw_tree(self._stream, self.index, shape, levels, top)

    def _mac(self, shape: Shape, *, stored: bool) -> FieldArray | None:
        if not self.malicious:
            return None
        return self._stream.correction(shape) if stored else self._stream.pad(shape)

    def _require_check(self) -> None:
        if self.malicious and self._mac_check is None:
            raise unrecorded()

    # -- openings ------------------------------------------------------------------------------------

    async def open(self, *values: Value) -> list[FieldArray]:
        """Exchange value shares; every opening is recorded for the next MAC check."""
        self._require_check()
        ring, sizes = self.ring, [element_bytes(value.shape) for value in values]
        own = [value.parts[0] for value in values]
        total = sum(sizes)
        reply = await exchange([ring.encoded(part) for part in own], total, total // ELEMENT_BYTES)
        opened, start = [], 0
        for value, part, size in zip(values, own, sizes, strict=True):
            opened.append(ring.add(part, ring.decoded(reply[start : start + size], value.shape)))
            start += size
        if self._mac_check is not None:
            for value, number in zip(values, opened, strict=True):
                self._mac_check.record(number, value.parts[1])
        return opened

    async def open_bits(self, shares: Block, delta: Block, n: int) -> npt.NDArray[np.bool_]:
        """Exchange the lowest bits, packed; the rest of every share is its MAC."""
        self._require_check()
        ring = self.ring
        own = ring.call(packed_signs, None, shares)
        reply = await exchange([own], (n + 7) // 8, 0)
        bits: npt.NDArray[np.bool_] = ring.call(opened_signs, None, own, reply, n, refuses=True)
        if self._mac_check is not None:
            self._mac_check.record_bits(ring.call(sign_macs, None, shares, bits, delta))
        return bits


def draw_tree(stream: JobStream | RecordStream, index: int, shape: Shape, levels: int, top: bool) -> TreeKey:
    """A party's half-tree keys: see :meth:`Party.tree`."""
    batches, order = stream.batches(shape)
    delta = of_party(stream.delta(shape), index)

    def blocks(pad_at: int) -> Block:
        """One block a key: a pad at one party, stored at the other."""
        return stream.pad_rows(shape) if index == pad_at else stream.correction_rows(shape, 1)[:, 0]

    first = blocks(1)
    beside = blocks(0) if top else None
    words = stream.correction_rows(shape, levels - 1)
    return TreeKey(delta, first, words, beside, batches, order)
