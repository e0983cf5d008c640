"""Masked input: party i learns r from the dealer and sends eps = x - r, once.

Cost: one round for the inputs of both parties, one field element a coordinate (half of one for short inputs
in the semi-honest mode, :mod:`spdz.values.input_mask`), and nothing more however often the masked value is
used: the mask r *is* the Beaver mask of every later product (function-dependent preprocessing: Ben-Efraim,
Nielsen, Omri, "Turbospeedz", ACNS 2019).

Security: a long mask makes eps uniform in F_p whatever x is. A malicious owner can choose any x in F_p^N and
nothing else: with two parties there is nobody to whom it could send a second, different eps.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import FieldArray, IntArray
from spdz.rounds.coroutine import exchange
from spdz.rounds.wire import NOT_CANONICAL, to_bytes
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
        shares = [party.input_mask(source) for source in inputs]
        bits = [party.input_mask_bits(source) for source in inputs]
        own: list[Any] = [
            _hidden(source.data, mask, length)
            for source, (mask, _), length in zip(inputs, shares, bits, strict=True)
            if source.data is not None and mask is not None
        ]
        theirs = [
            (prod(source.shape) * input_mask.element_bytes(length))
            for source, length in zip(inputs, bits, strict=True)
            if source.owner != party.index
        ]
        sent = sum(prod(source.shape) for source in inputs if source.owner == party.index)
        reply = await exchange([to_bytes(words) for words in own], sum(theirs), sent)
        words, values, start = iter(own), [], 0
        for source, (mask, mac), length in zip(inputs, shares, bits, strict=True):
            if source.owner == party.index:
                eps = next(words)
            else:
                stop = start + prod(source.shape) * input_mask.element_bytes(length)
                eps = np.frombuffer(reply[start:stop], dtype=np.uint64).reshape((*source.shape, -1))
                start = stop
            eps = _public(eps, source, length)
            parts = (eps, mask, mac) if party.malicious else (eps, mask)
            bound = Bound.of_norm(source.norm)
            values.append(
                Value(
                    party,
                    parts,
                    source.shape,
                    FRACTION_BITS,
                    bound,
                    masked=True,
                    plain=source.data,
                    mask_bits=length,
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
            # Quantised inputs are short integers as they are: the baseline need not look at them again.
            bound = Bound.of_norm(source.norm)
            values.append(Value(engine, (raw,), source.shape, FRACTION_BITS, bound, masked=True))
        return values


def _hidden(x: IntArray, mask: FieldArray, bits: int) -> npt.NDArray[np.uint64]:
    """What the owner sends: elements, or one word a coordinate."""
    if bits == input_mask.LONG:
        return field.sub_from_int64(x, mask)
    return input_mask.hide(x, mask)[..., None]


def _public(words: npt.NDArray[np.uint64], source: Input, bits: int) -> FieldArray:
    """The eps that was sent."""
    if bits == input_mask.SHORT:
        return input_mask.public_part(words[..., 0], source.owner)
    if not field.is_canonical(words):
        raise ProtocolViolation(NOT_CANONICAL)
    return words
