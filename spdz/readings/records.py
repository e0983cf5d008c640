"""Records of slots and pairs as streams, in the order in which they lie on a gallery's tape.

Pairs lie tile by tile, and each tile has a Delta and a public hash key of its own. So a rectangle of pairs
that reaches over several tiles is read tile by tile, and ``order`` says where every record belongs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import Block
from spdz.readings.streams import RecordStream

Octets = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class TilePart:
    """Those pairs of one tile that belong to a rectangle.

    Attributes:
        rows: Their rows in the rectangle.
        columns: Their columns in the rectangle.
        pad: Shape (rows, columns, pad bytes).
        correction: Shape (rows, columns, stored bytes).
        delta: This party's Delta of the tile.
        hash_key: The tile's public hash key.
    """

    rows: slice
    columns: slice
    pad: Octets = field(repr=False)
    correction: Octets = field(repr=False)
    delta: Block = field(repr=False)
    hash_key: bytes


def slot_stream(pads: Octets, corrections: Octets, deltas: Block, hash_keys: Sequence[bytes]) -> RecordStream:
    """The records of n slots: pads (n, bytes), corrections (n, bytes), deltas (n, 2)."""
    batches = [(slice(i, i + 1), key) for i, key in enumerate(hash_keys)]
    return RecordStream((len(pads),), pads, corrections, deltas, batches)


def pair_stream(shape: tuple[int, int], parts: Sequence[TilePart]) -> RecordStream:
    """The records of a rectangle of pairs, from the parts that cover it."""
    total = shape[0] * shape[1]
    pads = np.empty((total, parts[0].pad.shape[2]), dtype=np.uint8)
    corrections = np.empty((total, parts[0].correction.shape[2]), dtype=np.uint8)
    deltas = np.empty((total, 2), dtype=np.uint64)
    order = np.empty(total, dtype=np.intp)
    entries = np.arange(total).reshape(shape)
    batches, start = [], 0
    for part in parts:
        rows, columns = part.pad.shape[:2]
        records = slice(start, start + rows * columns)
        # A view of the rows in four dimensions, so that a cut of a tile is copied once.
        pads[records].reshape(part.pad.shape)[...] = part.pad
        corrections[records].reshape(part.correction.shape)[...] = part.correction
        deltas[records] = part.delta
        order[records] = entries[part.rows, part.columns].reshape(-1)
        batches.append((records, part.hash_key))
        start = records.stop
    one_after_another = len(parts) == 1 or shape[0] == 1
    return RecordStream(shape, pads, corrections, deltas, batches, None if one_after_another else order)
