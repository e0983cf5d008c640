"""Writing a gallery's tape: the dealer's side of :mod:`spdz.gallery.tape`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import Buffer
from spdz.gallery import keys
from spdz.gallery.format import GalleryHeader, GalleryLayout, encode_gallery_header
from spdz.gallery.table import encode_table
from spdz.tape.durable import write_at
from spdz.tape.envelope import SECTOR
from spdz.tape.publishing import NewFile
from spdz.tape.state import State, encode_slot

_NO_CHAIN = bytes(32)  # a gallery has no ratchet


class GalleryWriter:
    """Writes one tape in any order, under a temporary name that becomes the real one when it is whole.

    A context manager: leaving it normally closes the tape, leaving it by an error removes what was written.
    One thread at a time.

    Args:
        path: The tape to make; its folder is created with mode 0700 if missing. Mode 0600.
        header: What it is for.
        row_keys: 32 random bytes for each row band, drawn for this tape alone.
        column_keys: The same for each column band.
        alpha: This party's share of the MAC key, 16 bytes; any in semi-honest mode.

    Raises:
        FileExistsError: There is a file of that name. A dealt tape is never overwritten.
        ValueError: Keys or ``alpha`` have the wrong length or number, two keys are alike, or the header is
            too long.
        OSError: The file cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        header: GalleryHeader,
        row_keys: Sequence[bytes],
        column_keys: Sequence[bytes],
        alpha: bytes,
    ) -> None:
        encoded = encode_gallery_header(header)
        self._layout = layout = GalleryLayout.of(header, encoded)
        self._keys = (tuple(row_keys), tuple(column_keys))
        _check_secrets(self._keys, layout, alpha)
        self._path = Path(path)
        self._header = header
        self._left_slots = tuple(bytearray(b"\1") * capacity for capacity in header.capacity)
        row_bands, column_bands = layout.bands.counts
        self._left_tiles = bytearray(b"\1") * (row_bands * column_bands)
        self._size = 0
        self._new: NewFile | None = NewFile(self._path)
        try:
            state = encode_slot(State(0, _NO_CHAIN, alpha), 1, layout.digest) + bytes(SECTOR)
            table = encode_table(self._keys, layout.digest)
            self._write(self._open_file(), 0, encoded.ljust(layout.state, b"\0") + state + table)
        except BaseException:
            self.discard()
            raise

    @property
    def bytes_written(self) -> int:
        """Bytes of the tape so far; its file's size once closed."""
        return self._size

    def write_slot(self, owner: int, index: int, correction: Buffer) -> None:
        """Seal and write a slot's correction, ``slot_correction[owner]`` bytes.

        Raises:
            ValueError: There is no such slot, it is written already, the correction has another length, or
                the tape is closed.
            OSError: The file cannot be written.
        """
        file = self._open_file()
        offset = self._layout.slot_at(owner, index)
        nbytes = memoryview(correction).nbytes
        if nbytes != self._header.slot_correction[owner]:
            raise ValueError(
                f"{self._path}: a slot of party {owner} takes {self._header.slot_correction[owner]} bytes, "
                f"not {nbytes}"
            )
        if not self._left_slots[owner][index]:
            raise ValueError(f"{self._path}: slot {index} of party {owner} is written already")
        band, place = divmod(index, self._layout.bands.sizes[owner])
        key = keys.slot_keys(self._keys[owner][band], place).seal
        self._write(
            file, offset, keys.seal(key, correction, keys.slot_place(self._layout.digest, owner, index))
        )
        self._left_slots[owner][index] = 0

    def write_tile(self, row_band: int, column_band: int, correction: npt.NDArray[np.uint8]) -> None:
        """Seal and write a tile's correction, ``uint8`` of shape (rows, columns, pair_correction).

        Raises:
            ValueError: There is no such tile, it is written already, the correction has another shape or
                type, or the tape is closed.
            OSError: The file cannot be written.
        """
        file = self._open_file()
        offset = self._layout.tile_at(row_band, column_band)
        shape = (*self._layout.bands.sizes, self._header.pair_correction)
        if correction.dtype != np.uint8 or correction.shape != shape:
            raise ValueError(
                f"{self._path}: a tile takes uint8 of shape {shape}, not {correction.dtype} of "
                f"{correction.shape}"
            )
        number = row_band * self._layout.bands.counts[1] + column_band
        if not self._left_tiles[number]:
            raise ValueError(f"{self._path}: tile ({row_band}, {column_band}) is written already")
        key = keys.tile_keys(self._keys[0][row_band], self._keys[1][column_band]).seal
        data = np.ascontiguousarray(correction).reshape(-1).data
        self._write(
            file, offset, keys.seal(key, data, keys.tile_place(self._layout.digest, row_band, column_band))
        )
        self._left_tiles[number] = 0

    def close(self) -> None:
        """Make the file durable and give it its name. A second call does nothing.

        Raises:
            ValueError: A slot or a tile was not written; nothing is left behind.
            FileExistsError: Somebody else made a file of that name meanwhile.
            OSError: The file cannot be written.
        """
        if self._new is None:
            return
        try:
            slots, tiles = sum(map(sum, self._left_slots)), sum(self._left_tiles)
            if slots or tiles:
                raise ValueError(f"{self._path}: {slots} slots and {tiles} tiles were not written")
            self._new.publish()
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove the unfinished file; a finished tape stays."""
        if self._new is not None:
            new, self._new = self._new, None
            new.discard()

    def __enter__(self) -> GalleryWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _open_file(self) -> int:
        if self._new is None:
            raise ValueError(f"{self._path}: the tape is closed")
        return self._new.file.fileno()

    def _write(self, file: int, offset: int, data: bytes) -> None:
        write_at(file, offset, data)
        self._size += len(data)


def _check_secrets(secrets: tuple[tuple[bytes, ...], ...], layout: GalleryLayout, alpha: bytes) -> None:
    counts = layout.bands.counts
    if (len(secrets[0]), len(secrets[1])) != counts:
        raise ValueError(f"{counts} keys are needed for rows and columns, not {tuple(map(len, secrets))}")
    every = secrets[0] + secrets[1]
    if any(len(key) != keys.KEY_BYTES for key in every) or len(alpha) != 16:
        raise ValueError(f"a band's key takes {keys.KEY_BYTES} bytes and alpha 16")
    if len(set(every)) != len(every):
        raise ValueError("every band takes a key of its own, and two of these are alike")
