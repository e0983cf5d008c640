"""Masked input: party i learns r from the dealer and sends eps = x - r, once.

Cost: one round for the inputs of both parties, one field element a coordinate, and nothing more however
often the masked value is used: the mask r *is* the Beaver mask of every later product
(function-dependent preprocessing: Ben-Efraim, Nielsen, Omri, "Turbospeedz", ACNS 2019).

Security: eps is uniform in F_p whatever x is. A malicious owner can choose any x in F_p^N and nothing
else: with two parties there is nobody to whom it could send a second, different eps.
"""

from __future__ import annotations

from math import prod

import numpy as np

from spdz import field
from spdz.bound import Bound
from spdz.coroutine import exchange
from spdz.engine import ClearText, Evaluation, Gate, Input, Recipe
from spdz.fixed_point import FRACTION_BITS
from spdz.value import Value
from spdz.wire import exchange_elements, to_bytes


class MaskedInput(Gate):
    """Operands: the inputs of both parties, in program order."""

    async def deal(self, recipe: Recipe, *inputs: Input) -> list[Value]:
        """Deal one mask an input."""
        masked = [recipe.input_mask(source) for source in inputs]
        sent = [sum(prod(source.shape) for source in inputs if source.owner == party) for party in (0, 1)]
        await recipe.round((sent[0], sent[1]))
        return masked

    async def evaluate(self, party: Evaluation, *inputs: Input) -> list[Value]:
        """Send x - r for the own inputs, receive the peer's."""
        shares = [party.input_mask(source) for source in inputs]
        sent = [
            field.sub_from_int64(source.data, mask)
            for source, (mask, _) in zip(inputs, shares, strict=True)
            if source.data is not None and mask is not None
        ]
        received = iter(
            await exchange_elements(sent, [source.shape for source in inputs if source.owner != party.index])
        )
        own, values = iter(sent), []
        for source, (mask, mac) in zip(inputs, shares, strict=True):
            eps = next(own if source.owner == party.index else received)
            parts = (eps, mask, mac) if party.malicious else (eps, mask)
            values.append(
                Value(
                    party,
                    parts,
                    source.shape,
                    FRACTION_BITS,
                    Bound.of_norm(source.norm),
                    masked=True,
                    plain=source.data,
                )
            )
        return values

    async def clear(self, engine: ClearText, *inputs: Input) -> list[Value]:
        """Send the raw integers themselves, 8 bytes a coordinate: what robots do today."""
        own = [source.data for source in inputs if source.data is not None]
        theirs = [source for source in inputs if source.owner != engine.index]
        reply = await exchange(
            [to_bytes(raw) for raw in own],
            8 * sum(prod(source.shape) for source in theirs),
            sum(raw.size for raw in own),
        )
        words = np.frombuffer(reply, dtype=np.int64)
        values, start = [], 0
        for source in inputs:
            raw = source.data
            if raw is None:
                raw = words[start : start + prod(source.shape)].reshape(source.shape)
                start += raw.size
            values.append(engine.value(raw, FRACTION_BITS, Bound.of_norm(source.norm)))
        return values
