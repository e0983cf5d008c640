"""What was dealt to one party, drawn from front to back in the order in which the dealer dealt it.

A *pad* is pseudo-random, expanded from a key; a *correction* is stored. A job is one pad and one correction.
A gallery has one of both for every slot and for every pair of slots, all alike: so many records are read at a
time as there are slots or pairs in a step, and every draw takes the same columns of all of them.
"""

from __future__ import annotations

from copy import copy
from math import prod

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.prf import Batches, expand, one_batch
from spdz.dcf import Keys, key_bytes
from spdz.dcf.keys import BINARY, from_records, hash_index, record_bytes
from spdz.foundations.errors import TapeDamaged
from spdz.foundations.types import Block, Buffer, FieldArray, Shape
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.values.trees import Order, restored

_HASH_KEY = 16


class JobStream:
    """The pad and the correction of one job."""

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

    @property
    def position(self) -> tuple[int, int]:
        """Elements drawn from the pad, and stored bytes."""
        return self._pad_at, self._correction_at

    def at(self, pad: int, stored: int) -> JobStream:
        """The same job, drawn up to a position."""
        stream = copy(self)
        stream._pad_at, stream._correction_at = pad, stored
        return stream

    @property
    def elements(self) -> tuple[FieldArray, FieldArray]:
        """The whole pad and all that is stored, as elements, to be read in any order."""
        return self._pad, np.frombuffer(self._correction, dtype=np.uint64).reshape(-1, 2)

    def pad_blocks(self, shape: Shape) -> Block:
        """The next pseudo-random 128-bit blocks."""
        return self._blocks[self._next(prod(shape))].reshape((*shape, 2))

    def pad(self, shape: Shape) -> FieldArray:
        """The next pseudo-random field elements."""
        return self._pad[self._next(prod(shape))].reshape((*shape, 2))

    def pad_rows(self, shape: Shape) -> Block:
        """The next pseudo-random blocks, one for the key of every entry: shape (n, 2), in the keys' order."""
        return self.pad_blocks((prod(shape),))

    def correction_bytes(self, size: int) -> memoryview:
        """The next stored bytes."""
        start, self._correction_at = self._correction_at, self._correction_at + size
        if self._correction_at > len(self._correction):
            raise TapeDamaged("the job's record is shorter than the program needs")
        return self._correction[start : self._correction_at]

    def correction(self, shape: Shape) -> FieldArray:
        """The next stored field elements or blocks."""
        raw = self.correction_bytes(ELEMENT_BYTES * prod(shape))
        return np.frombuffer(raw, dtype=np.uint64).reshape((*shape, 2))

    def correction_rows(self, shape: Shape, blocks: int) -> Block:
        """The next stored blocks, so many for the key of every entry: shape (n, blocks, 2)."""
        return self.correction((prod(shape), blocks))

    @property
    def exhausted(self) -> bool:
        """Whether the whole job has been drawn."""
        return self._pad_at == len(self._pad) and self._correction_at == len(self._correction)

    def delta(self, shape: Shape) -> Block:
        """This party's Delta for the half-tree keys of an array, one block for all."""
        return self.pad_blocks(())

    def batches(self, shape: Shape) -> tuple[Batches, Order]:
        """The stored public hash key of the half-tree keys of an array, and the keys' order."""
        return one_batch(prod(shape), bytes(self.correction_bytes(_HASH_KEY))), None

    def keys(self, party: int, shape: Shape, bits: int, payloads: int) -> Keys:
        """The next DCF keys, one an entry of an array."""
        n = prod(shape)
        roots = self.pad_blocks((n,))
        words = self.correction_bytes(key_bytes(n, bits, payloads))
        return Keys(party, bits, payloads, roots, [(slice(0, n), words)])


class RecordStream:
    """The pads and corrections of slots or pairs, one row each.

    Args:
        lead: The axes that count records: every array that is drawn begins with them.
        pads: Shape (n, pad bytes), ``uint8``.
        corrections: Shape (n, correction bytes), ``uint8``.
        deltas: This party's Delta of every record, shape (n, 2).
        batches: The public hash keys of the records, which cover the n rows.
        order: Where the rows do not follow each other as the entries of ``lead`` do: the entry of each.
    """

    __slots__ = ("_at", "_batches", "_buffers", "_deltas", "_lead", "_order")

    def __init__(
        self,
        lead: Shape,
        pads: npt.NDArray[np.uint8],
        corrections: npt.NDArray[np.uint8],
        deltas: Block,
        batches: Batches,
        order: Order = None,
    ) -> None:
        self._lead, self._buffers, self._at = lead, (pads, corrections), [0, 0]
        self._deltas, self._batches, self._order = deltas, batches, order

    @property
    def records(self) -> int:
        """How many there are."""
        return len(self._buffers[0])

    def each(self, shape: Shape) -> int:
        """How much of an array a record has."""
        return per_record(shape, self._lead)

    def _rows(self, buffer: int, count: int) -> Block:
        """The next ``count`` blocks of every record, shape (n, count, 2), in the rows' order."""
        start, stop = self._at[buffer], self._at[buffer] + ELEMENT_BYTES * count
        rows = self._buffers[buffer]
        if stop > rows.shape[1]:
            raise TapeDamaged("a record is shorter than the program needs")
        self._at[buffer] = stop
        return rows[:, start:stop].view("<u8").reshape(len(rows), count, 2)

    def _entries(self, buffer: int, shape: Shape) -> Block:
        return restored(self._rows(buffer, self.each(shape)), self._order).reshape((*shape, 2))

    def pad_blocks(self, shape: Shape) -> Block:
        """The next pseudo-random 128-bit blocks of every record."""
        return self._entries(0, shape)

    def pad(self, shape: Shape) -> FieldArray:
        """The next pseudo-random field elements."""
        return field.from_blocks(self.pad_blocks(shape))

    def correction(self, shape: Shape) -> FieldArray:
        """The next stored field elements or blocks."""
        return self._entries(1, shape)

    def pad_rows(self, shape: Shape) -> Block:
        """As :meth:`JobStream.pad_rows`."""
        return self._rows(0, self.each(shape)).reshape(-1, 2)

    def correction_rows(self, shape: Shape, blocks: int) -> Block:
        """As :meth:`JobStream.correction_rows`."""
        each = self.each(shape)
        return self._rows(1, each * blocks).reshape(self.records * each, blocks, 2)

    @property
    def exhausted(self) -> bool:
        """Whether the records have been drawn."""
        return all(at == rows.shape[1] for at, rows in zip(self._at, self._buffers, strict=True))

    def delta(self, shape: Shape) -> Block:
        """This party's Delta for the half-tree keys of an array, in the keys' order."""
        return np.repeat(self._deltas, self.each(shape), axis=0)

    def batches(self, shape: Shape) -> tuple[Batches, Order]:
        """The public hash keys of the half-tree keys of an array, and the keys' order."""
        each = self.each(shape)
        order = self._order
        if order is not None and each > 1:
            order = (order[:, None] * each + np.arange(each)).reshape(-1)
        return [(slice(rows.start * each, rows.stop * each), key) for rows, key in self._batches], order

    def keys(self, party: int, shape: Shape, bits: int, payloads: int) -> Keys:
        """The next DCF keys, one an entry of an array."""
        each = self.each(shape)
        roots = self._rows(0, each).reshape(-1, 2)
        rows = self._rows(1, record_bytes(each, bits, payloads) // ELEMENT_BYTES)
        octets = rows.view(np.uint8).reshape(len(rows), -1)
        words = [
            (keys, from_records(octets[records], hash_index(key), each, bits, payloads))
            for (records, key), (keys, _) in zip(self._batches, self.batches(shape)[0], strict=True)
        ]
        return Keys(party, bits, payloads, roots, words, BINARY, self.batches(shape)[1])


def per_record(shape: Shape, lead: Shape) -> int:
    """Entries of an array that belong to one of the records that ``lead`` counts.

    Raises:
        ValueError: if the array does not begin with the records' axes.
    """
    if shape[: len(lead)] != lead:
        raise ValueError(
            "in a gallery everything that is dealt belongs to one pair of descriptors, or to one descriptor: "
            "move what depends on one descriptor alone into the score's `prepare` step"
        )
    return prod(shape[len(lead) :])
