"""Masked input: party i learns r from the dealer and sends eps = x - r, once.

Cost: one round for the inputs of both parties, one field element a coordinate (half of one or less for inputs
of short masks, :mod:`spdz.values.input_mask`), and nothing more however often the masked value is
used: the mask r *is* the Beaver mask of every later product (function-dependent preprocessing: Ben-Efraim,
Nielsen, Omri, "Turbospeedz", ACNS 2019).

Security: eps is as likely for one x within the bound as for another. A malicious owner can choose any x in
F_p^N and nothing else: with two parties there is nobody to whom it could send a second, different eps.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.rounds.coroutine import exchange
from spdz.rounds.wire import to_bytes
from spdz.values import input_mask
from spdz.values.engine import ClearText, Evaluation, Gate, Input, Recipe
from spdz.values.value import Value


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
        ring = party.ring
        drawn = [(source, party.input_mask(source), party.input_mask_bits(source)) for source in inputs]
        sent: dict[int, Any] = {
            i: ring.hidden(source.data, mask, bits, source.norm)
            for i, (source, (mask, _), bits) in enumerate(drawn)
            if source.data is not None and mask is not None
        }
        sizes = [prod(source.shape) * input_mask.element_bytes(bits) for source, _, bits in drawn]
        reply = await exchange(
            [ring.encoded_words(words, drawn[i][2]) for i, words in sent.items()],
            sum(size for i, size in enumerate(sizes) if i not in sent),
            sum(prod(inputs[i].shape) for i in sent),
        )
        values, start = [], 0
        for i, (source, (mask, mac), bits) in enumerate(drawn):
            if i in sent:
                words = sent[i]
            else:
                raw = reply[start : start + sizes[i]]
                words = ring.decoded_words(raw, source.shape, bits, source.norm)
                start += sizes[i]
            eps = ring.word_elements(words, bits)
            value = Value(
                party,
                (eps, mask, mac) if party.malicious else (eps, mask),
                source.shape,
                FRACTION_BITS,
                Bound.of_norm(source.norm),
                masked=True,
                plain=source.data,
                span=input_mask.span(bits),
            )
            values.append(value)
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
            # Quantised inputs are short integers as they are: the baseline need not look at them again.
            bound = Bound.of_norm(source.norm)
            values.append(Value(engine, (raw,), source.shape, FRACTION_BITS, bound, masked=True))
        return values
