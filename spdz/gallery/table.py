"""The keys of the bands: the part of a gallery's tape that is erased piece by piece.

A sector a key, so that an interrupted erasure cannot touch another key (a sector may hold old, new or torn
bytes until it is synced). A sector holds the key and a digest, or zeros once the key is erased. After a crash
inside :meth:`KeyTable.erase` a key is whole, erased or unreadable, and erasing it again finishes it.

As far as the disk allows: flash storage and journaling file systems may keep old copies of a sector.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence

from spdz.foundations.errors import TapeDamaged, TapeExhausted
from spdz.gallery.format import GalleryLayout
from spdz.gallery.keys import KEY_BYTES
from spdz.tape.advice import replacement
from spdz.tape.durable import sync, write_at
from spdz.tape.envelope import DIGEST, SECTOR

_ZEROS = bytes(SECTOR)
_KINDS = ("row", "column")


def encode_table(keys: Sequence[Sequence[bytes]], binding: bytes) -> bytes:
    """All of the table: row keys, then column keys. ``binding`` is the header's digest."""
    return b"".join(
        (key + _digest(key, owner, band, binding)).ljust(SECTOR, b"\0")
        for owner in (0, 1)
        for band, key in enumerate(keys[owner])
    )


class KeyTable:
    """The keys of one open file.

    Args:
        descriptor: The tape file, open for reading and writing.
        layout: Where its parts lie.
        path: Its name, for messages.
        dealer_command: What deals another, for messages.
    """

    def __init__(self, descriptor: int, layout: GalleryLayout, path: os.PathLike[str], dealer_command: str):
        self._descriptor = descriptor
        self._layout = layout
        self._path = path
        self._dealer_command = dealer_command
        self._keys: dict[tuple[int, int], bytes] = {}
        self._erased: set[tuple[int, int]] = set()

    def load(self) -> None:
        """Read all keys that are whole; what is wrong with another is said when it is asked for."""
        rows, columns = self._layout.bands.counts
        table = os.pread(self._descriptor, (rows + columns) * SECTOR, self._layout.keys)
        for owner, band in self._all():
            start = self._offset(owner, band) - self._layout.keys
            sector = table[start : start + SECTOR]
            key = sector[:KEY_BYTES]
            if sector == _ZEROS:
                self._erased.add((owner, band))
            elif sector[KEY_BYTES : KEY_BYTES + DIGEST] == _digest(key, owner, band, self._layout.digest):
                self._keys[owner, band] = key
        if self._erased:  # after a killed process the zeros may be in memory only
            sync(self._descriptor)

    def is_erased(self, owner: int, band: int) -> bool:
        """Whether a band was erased."""
        return (owner, band) in self._erased

    def key(self, owner: int, band: int) -> bytes:
        """The key of a row band (of slots of party 0) or of a column band (of party 1).

        Raises:
            TapeExhausted: It was erased.
            TapeDamaged: It cannot be read.
        """
        key = self._keys.get((owner, band))
        if key is not None:
            return key
        if (owner, band) in self._erased:
            raise TapeExhausted(
                f"{self._path}: {_KINDS[owner]} band {band} was erased, with its slots and tiles. "
                f"Deal more: {self._dealer_command}"
            )
        raise TapeDamaged(
            f"{self._path}: the checksum of the key of {_KINDS[owner]} band {band} at byte "
            f"{self._offset(owner, band)} does not hold. {replacement(None)}"
        )

    def erase(self, bands: Iterable[tuple[int, int]]) -> None:
        """Overwrite keys, given by owner and band; on return they are nowhere in the file.

        Those that are erased already stay so. After an OSError none of them can be used here any more, and
        erasing them again finishes it.
        """
        new = [band for band in bands if band not in self._erased]
        for band in new:
            self._keys.pop(band, None)
        for band in new:
            write_at(self._descriptor, self._offset(*band), _ZEROS)
        if new:
            sync(self._descriptor)
        self._erased.update(new)

    def wipe(self) -> None:
        """Overwrite all keys, whatever is believed of them; on return none is in the file."""
        self.forget()
        write_at(self._descriptor, self._layout.keys, bytes(sum(self._layout.bands.counts) * SECTOR))
        sync(self._descriptor)

    def forget(self) -> None:
        """Drop the keys from memory."""
        self._keys.clear()

    def _all(self) -> Iterable[tuple[int, int]]:
        return ((owner, band) for owner in (0, 1) for band in range(self._layout.bands.counts[owner]))

    def _offset(self, owner: int, band: int) -> int:
        return self._layout.keys + (owner * self._layout.bands.counts[0] + band) * SECTOR


def _digest(key: bytes, owner: int, band: int, binding: bytes) -> bytes:
    place = binding + bytes([owner]) + band.to_bytes(4, "little")
    return hashlib.blake2b(place + key, digest_size=DIGEST, person=b"spdz-gallery-key").digest()
