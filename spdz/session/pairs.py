"""The records of a rectangle of pairs, from the tiles of a gallery's tape that it reaches over."""

from __future__ import annotations

from collections.abc import Iterator

from spdz.gallery.tape import GalleryTape
from spdz.readings.records import TilePart, pair_stream
from spdz.readings.streams import RecordStream


def read_pairs(tape: GalleryTape, rows: range, columns: range) -> RecordStream:
    """Read the records of all pairs of some slots of party 0 with some of party 1.

    Raises:
        TapeError: as :meth:`GalleryTape.tile`.
    """
    sizes = tape.header.bands.sizes
    parts = []
    for row_band, in_rows, of_rows in _cuts(rows, sizes[0]):
        for column_band, in_columns, of_columns in _cuts(columns, sizes[1]):
            tile = tape.tile(row_band, column_band)
            pad, correction = tile.pad[of_rows, of_columns], tile.correction[of_rows, of_columns]
            parts.append(TilePart(in_rows, in_columns, pad, correction, tile.delta, tile.hash_key))
    return pair_stream((len(rows), len(columns)), parts)


def _cuts(slots: range, size: int) -> Iterator[tuple[int, slice, slice]]:
    """Bands that consecutive slots reach over: number, where in the slots, where in the band."""
    for band in range(slots.start // size, -(-slots.stop // size)):
        first, last = max(band * size, slots.start), min((band + 1) * size, slots.stop)
        yield (
            band,
            slice(first - slots.start, last - slots.start),
            slice(first - band * size, last - band * size),
        )
