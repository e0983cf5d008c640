"""The dealer's reading: the program run on masks alone.

The dealer knows the masks, never an input. Reading a program, it writes for either party exactly what
that party will draw, in the same order (the convention is in :mod:`spdz.readings.party`): the pads come from
the job's two keys, so only *corrections* are written down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from dealer.outlets import JobOutlet, RecordOutlet
from dealer.randomness import MacKey, uniform_below
from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import FieldRing
from spdz.foundations.types import Block, FieldArray, Security, Shape
from spdz.readings.meter import Plan
from spdz.readings.program import Program, run
from spdz.readings.stock import Stock
from spdz.readings.streams import JobStream, RecordStream
from spdz.rounds.coroutine import exchange, run_silently
from spdz.values import input_mask
from spdz.values.engine import Gate, Input, Recipe
from spdz.values.trees import TreePads, of_party
from spdz.values.value import Value

_RING = FieldRing()


Pads: TypeAlias = tuple[JobStream, JobStream] | tuple[RecordStream, RecordStream]
Outlet: TypeAlias = JobOutlet | RecordOutlet


class DealtJob(Recipe):
    """One job, or the records of many slots or pairs, being dealt."""

    def __init__(self, security: Security, pads: Pads, mac_key: MacKey | None, outlet: Outlet) -> None:
        self.security, self.ring = security, _RING
        self._pads, self._mac_key, self._outlet = pads, mac_key, outlet
        self._unchecked = False

    @property
    def has_unchecked_openings(self) -> bool:
        """As the meter sees it."""
        return self._unchecked

    def _read(self, gate: Gate, *operands: Any) -> Any:
        """Deal a gate."""
        return gate.deal(self, *operands)

    def shared(self, x: Value) -> Value:
        """A shared value has no mask."""
        x.decide()
        return Value(self, (), x.shape, x.frac, x.bound, is_bit=x.is_bit)

    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """A public constant changes no mask."""
        return x.parts

    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """The mask r - raw."""
        (mask,) = x.parts
        return (field.sub(mask, np.broadcast_to(field.from_int(raw), mask.shape)),)

    def shared_value(
        self, kind: str, of: tuple[Value, ...], shape: Shape, frac: int, bound: Bound, *, is_bit: bool = False
    ) -> Value:
        """The result of a gate: nothing that the dealer knows."""
        return Value(self, (), shape, frac, bound, is_bit=is_bit)

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
        """The mask is dealt as any other value, and kept: later gates multiply it."""
        mask = np.broadcast_to(make(), (*shape, 2))
        self.authenticated(shape, lambda: mask)
        return Value(self, (mask,), shape, frac, bound, masked=True, mask_bits=mask_bits, span=span)

    def input_mask(self, source: Input) -> Value:
        """The owner's pad is the mask."""
        bits = self.input_mask_bits(source)
        mask = input_mask.from_pad(self._pads[source.owner].pad(source.shape), bits)
        self._deal_mac(mask, stored_by=source.owner)
        bound = Bound.of_norm(source.norm)
        span = input_mask.span(bits)
        return Value(self, (mask,), source.shape, FRACTION_BITS, bound, masked=True, span=span)

    def authenticated(
        self,
        shape: Shape,
        make: Callable[[], FieldArray],
        *,
        of: tuple[Value, ...] = (),
        count: tuple[str, int] | None = None,
        stored_by: int = 1,
    ) -> None:
        """One party's share is its pad; ``stored_by`` stores the rest."""
        value = np.broadcast_to(make(), (*shape, 2))
        self._write(stored_by, field.sub(value, self._pads[1 - stored_by].pad(shape)))
        self._deal_mac(value, stored_by=1 - stored_by)

    def triple(
        self,
        kind: str,
        shape: Shape,
        product_shape: Shape,
        product: Callable[[FieldArray, FieldArray], FieldArray],
    ) -> None:
        """A and b are sums of both pads."""
        factors = []
        for _ in range(2):
            factors.append(field.add(self._pads[0].pad(shape), self._pads[1].pad(shape)))
            self._deal_mac(factors[-1], stored_by=0)
        self.authenticated(product_shape, lambda: product(*factors))

    def uniform_below(self, limit: int, shape: Shape) -> FieldArray:
        """From the dealer's own generator."""
        return uniform_below(limit, shape)

    def comparison_key(
        self, shape: Shape, bits: int, width: int, make: Callable[[], tuple[FieldArray, FieldArray]]
    ) -> None:
        """Both parties store the same correction words; the root seeds are pads."""
        thresholds, payload = make()
        columns = payload.reshape(-1, width, 2)
        if self._mac_key is not None:
            columns = np.concatenate([columns, field.scale(columns, self._mac_key.alpha)], axis=1)
        roots = (self._pads[0].pad_rows(shape), self._pads[1].pad_rows(shape))
        self._outlet.keys(roots, shape, thresholds.reshape(-1, 2), columns, bits)

    def tree(
        self,
        kind: str,
        z: Value,
        levels: int,
        make: Callable[[TreePads], tuple[Block, Block, Block | None]],
        *,
        top: bool,
    ) -> None:
        """Delta and the random halves of ``first`` and ``top`` are pads; the rest is stored."""
        shape, (pad0, pad1) = z.shape, self._pads
        batches, order = self._outlet.batches(shape)
        deltas = (of_party(pad0.delta(shape), 0), of_party(pad1.delta(shape), 1))
        first, beside = pad1.pad_rows(shape), pad0.pad_rows(shape) if top else None
        first0, words, top1 = make(TreePads(deltas, first, beside, batches, order))
        self._outlet.rows(0, shape, first0)
        if top1 is not None:
            self._outlet.rows(1, shape, top1)
        for party in (0, 1):
            self._outlet.rows(party, shape, words)

    async def opening_bits(self, bits: int) -> None:
        """As :meth:`round`."""
        self._unchecked = self.malicious
        await exchange([], 0, 0)

    async def round(self, sent: tuple[int, int]) -> None:
        """Nobody is sent anything, but lanes must suspend where a party's do."""
        await exchange([], 0, 0)

    async def opening(self, elements: int) -> None:
        """As :meth:`round`."""
        self._unchecked = self.malicious
        await exchange([], 0, 0)

    def _deal_mac(self, value: FieldArray, *, stored_by: int) -> None:
        """m_0 + m_1 = alpha v: one share is the other party's pad, ``stored_by`` stores the rest."""
        if self._mac_key is not None:
            pad = self._pads[1 - stored_by].pad(value.shape[:-1])
            self._write(stored_by, field.sub(field.scale(value, self._mac_key.alpha), pad))

    def _write(self, party: int, elements: FieldArray) -> None:
        self._outlet.entries(party, elements.shape[:-1], elements)


def deal_job(
    program: Program, plan: Plan, security: Security, keys: tuple[bytes, bytes], mac_key: MacKey | None
) -> tuple[bytes, bytes]:
    """Deal one job of a program.

    Args:
        program: The program.
        plan: What the meter saw of it.
        security: The security model.
        keys: The two parties' pad keys for this job.
        mac_key: The tape's MAC key, or None in semi-honest mode.

    Returns:
        Both parties' corrections.
    """
    outlet = JobOutlet()
    run_silently(run(_new_job(plan.pad_bytes, security, keys, mac_key, outlet), program, plan.inputs))
    return outlet.corrections


def deal_stock(
    stock: Stock,
    pad_bytes: tuple[int, int],
    security: Security,
    keys: tuple[bytes, bytes],
    mac_key: MacKey | None,
) -> tuple[bytes, bytes]:
    """Deal a stock of triples, for no program in particular; arguments as for :func:`deal_job`."""
    outlet = JobOutlet()
    stock.deal(_new_job(pad_bytes, security, keys, mac_key, outlet))
    return outlet.corrections


def _new_job(
    pad_bytes: tuple[int, int],
    security: Security,
    keys: tuple[bytes, bytes],
    mac_key: MacKey | None,
    outlet: JobOutlet,
) -> DealtJob:
    first, second = (JobStream(key, size, b"") for key, size in zip(keys, pad_bytes, strict=True))
    return DealtJob(security, (first, second), mac_key, outlet)
