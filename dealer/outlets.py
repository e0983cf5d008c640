"""Where what is dealt goes: one job's two corrections, or the records of many slots or pairs."""

from __future__ import annotations

import secrets
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz import dcf
from spdz.arithmetic.prf import Batches, one_batch
from spdz.dcf.keys import BINARY, hash_index, to_records
from spdz.foundations.types import Block, Buffer, FieldArray, Shape
from spdz.readings.streams import RecordStream
from spdz.rounds.wire import to_bytes
from spdz.values.trees import Order, arranged

_HASH_KEY = 16


class JobOutlet:
    """Both parties' corrections of one job, in the order in which they will be drawn."""

    def __init__(self) -> None:
        self._corrections: tuple[list[Buffer], list[Buffer]] = ([], [])

    @property
    def corrections(self) -> tuple[bytes, bytes]:
        """What either party must store for this job."""
        first, second = (b"".join(parts) for parts in self._corrections)
        return first, second

    def entries(self, party: int, shape: Shape, elements: FieldArray) -> None:
        """Elements of an array."""
        self._corrections[party].append(to_bytes(elements))

    def rows(self, party: int, shape: Shape, blocks: Block) -> None:
        """Blocks of the keys of an array's entries, shape (n, ..., 2), in the keys' order."""
        self._corrections[party].append(to_bytes(blocks))

    def batches(self, shape: Shape) -> tuple[Batches, Order]:
        """A fresh public hash key for the half-tree keys of an array."""
        key = secrets.token_bytes(_HASH_KEY)
        for corrections in self._corrections:
            corrections.append(key)
        return one_batch(prod(shape), key), None

    def keys(
        self, roots: tuple[Block, Block], shape: Shape, thresholds: Block, payload: FieldArray, bits: int
    ) -> None:
        """Deal DCF keys; roots, thresholds (n, 2) and payload (n, w, 2) in the entries' order."""
        key = dcf.generate(*roots, thresholds, payload, bits)
        for corrections in self._corrections:
            corrections.append(key)


class RecordOutlet:
    """Both parties' corrections of many records, one row each."""

    def __init__(self, stream: RecordStream) -> None:
        """Args: any party's stream of pads, which knows the records' order and hash keys."""
        self._stream = stream
        self._columns: tuple[list[Any], list[Any]] = ([], [])

    @property
    def corrections(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """Shape (records, bytes) each."""
        rows = self._stream.records
        first, second = (
            np.concatenate([np.empty((rows, 0), dtype=np.uint8), *columns], axis=1)
            for columns in self._columns
        )
        return first, second

    def entries(self, party: int, shape: Shape, elements: FieldArray) -> None:
        """As :meth:`JobOutlet.entries`."""
        self.rows(party, shape, arranged(elements, self._stream.batches(shape)[1]))

    def rows(self, party: int, shape: Shape, blocks: Block) -> None:
        """As :meth:`JobOutlet.rows`."""
        octets = np.ascontiguousarray(blocks).view(np.uint8)
        self._columns[party].append(octets.reshape(self._stream.records, -1))

    def batches(self, shape: Shape) -> tuple[Batches, Order]:
        """The records' hash keys."""
        return self._stream.batches(shape)

    def keys(
        self, roots: tuple[Block, Block], shape: Shape, thresholds: Block, payload: FieldArray, bits: int
    ) -> None:
        """As :meth:`JobOutlet.keys`; the roots in the keys' order."""
        batches, order = self._stream.batches(shape)
        each, width = self._stream.each(shape), payload.shape[1]
        if order is not None:
            thresholds, payload = thresholds[order], payload[order]
        parts = []
        for keys, public in batches:
            index = hash_index(public)
            key = dcf.generate(
                roots[0][keys],
                roots[1][keys],
                thresholds[keys],
                payload[keys],
                bits,
                digit_bits=BINARY,
                index=index,
            )
            parts.append(to_records(key, (keys.stop - keys.start) // each, each, bits, width))
        for columns in self._columns:
            columns.append(np.concatenate(parts))
