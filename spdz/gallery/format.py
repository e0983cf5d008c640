"""The file of a gallery's tape: its header and where everything lies.

::

    0       kind, header and digest                             spdz.tape.envelope
    state   two state slots, a sector each                      spdz.tape.state
    keys    a key for each row band, then for each column band  spdz.gallery.table, a sector each
    slots   a sealed record for each slot of party 0, then of party 1
    tiles   a sealed record for each tile, row by row
    end

A sealed record is as long as its correction and TAG bytes more (:mod:`spdz.gallery.keys`). There are records
for every slot of every band, so a little more than were asked for. Every length is checked against the file's
size before it is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from spdz.tape.envelope import DIGEST, GALLERY, SECTOR, check_size, encode_envelope, read_envelope, round_up
from spdz.tape.header import Header, check_integer

BAND = 16
"""Most slots in a band."""

TAG = 16
"""Bytes by which sealing lengthens a record."""

MAX_SLOTS = 1 << 16
MAX_SLOT_BYTES = 1 << 30
MAX_PAIR_BYTES = 1 << 22  # a tile's BAND**2 pairs then take 2**30 bytes: below the 2**31 of one read and seal


class Bands(NamedTuple):
    """How slots come in bands: ``counts[owner]`` bands of ``sizes[owner]`` slots each."""

    sizes: tuple[int, int]
    counts: tuple[int, int]


@dataclass(frozen=True, slots=True)
class GalleryHeader(Header):
    """What a gallery's tape is for: public, unchanging, and checked against the peer's in the handshake.

    Attributes:
        mission: Lower-case hex id of the dealing run.
        tape: Lower-case hex id shared by the two tapes of this pair.
        agents: Names of party 0 and party 1.
        party: 0 or 1: whose tape this is.
        security: The security model it was dealt for.
        fingerprint: Hex; what the meter saw of the program.
        program: The program's public parameters, as JSON.
        slots: Slots asked for, for descriptors of party 0 (rows) and of party 1 (columns), 1 to MAX_SLOTS.
        band: Most slots in a band, 1 to BAND.
        slot_pad: This party's pseudo-random bytes for a slot of party 0 and of party 1.
        slot_correction: This party's stored bytes for a slot of party 0 and of party 1.
        pair_pad: This party's pseudo-random bytes for a pair of slots.
        pair_correction: This party's stored bytes for a pair of slots.

    Raises:
        ValueError: A field is out of range or of the wrong type.
    """

    slots: tuple[int, int]
    band: int
    slot_pad: tuple[int, int]
    slot_correction: tuple[int, int]
    pair_pad: int
    pair_correction: int

    def __post_init__(self) -> None:
        Header.__post_init__(self)  # super() finds no class made with slots=True
        for name, least, most in (
            ("slots", 1, MAX_SLOTS),
            ("slot_pad", 0, MAX_SLOT_BYTES),
            ("slot_correction", 0, MAX_SLOT_BYTES),
        ):
            value = getattr(self, name)
            if not isinstance(value, Sequence) or len(value) != 2:
                raise ValueError(f"{name} must be a number for either party, not {value!r}")
            for number in value:
                check_integer(name, number, least, most)
            object.__setattr__(self, name, tuple(value))
        check_integer("band", self.band, 1, BAND)
        check_integer("pair_pad", self.pair_pad, 0, MAX_PAIR_BYTES)
        check_integer("pair_correction", self.pair_correction, 0, MAX_PAIR_BYTES)

    @property
    def bands(self) -> Bands:
        """Sizes and numbers of row and column bands: as few as may be, and all of one size."""
        (rows, row_bands), (columns, column_bands) = (_bands(slots, self.band) for slots in self.slots)
        return Bands((rows, columns), (row_bands, column_bands))

    @property
    def capacity(self) -> tuple[int, int]:
        """Slots dealt for party 0 and party 1: what was asked for, rounded up to whole bands."""
        sizes, counts = self.bands
        return sizes[0] * counts[0], sizes[1] * counts[1]

    @property
    def dealer_command(self) -> str:
        """The command that deals another of the same."""
        if not {"place", "gallery"}.isdisjoint(self.program):  # of places, or with the name of a plan
            return "python -m spdz.dealer mission.toml --out FOLDER"
        usual = {"reveal": "bit", "resolution": "2^-16", "min_norm": 0.0, "max_norm": 1.0}
        unusual = [name for name, value in usual.items() if self.program.get(name, value) != value]
        command = self.dealing("score", "dim", *unusual)
        proof = " --no-norm-proof" if self.program.get("norm_proof") is False else ""
        return f"{command}{proof} --slots RxC --out FOLDER"


@dataclass(frozen=True, slots=True)
class GalleryLayout:
    """Byte offsets of the parts of a gallery's tape, all functions of the header.

    Attributes:
        digest: The header's digest: what binds the parts of one file together.
        bands: Sizes and numbers of the bands.
        state: Offset of the two state slots.
        keys: Offset of the first row band's key.
        slots: Offsets of the first slot record of party 0 and of party 1.
        slot_bytes: Bytes of a slot record of party 0 and of party 1, sealed.
        tiles: Offset of the first tile.
        tile_bytes: Bytes of a tile, sealed.
        end: The file's size.
    """

    digest: bytes
    bands: Bands
    state: int
    keys: int
    slots: tuple[int, int]
    slot_bytes: tuple[int, int]
    tiles: int
    tile_bytes: int
    end: int

    @classmethod
    def of(cls, header: GalleryHeader, encoded: bytes) -> GalleryLayout:
        """Lay out a tape whose header, digest included, is ``encoded``."""
        bands, capacity = header.bands, header.capacity
        (rows, columns), (row_bands, column_bands) = bands
        state = round_up(len(encoded), SECTOR)
        keys = state + 2 * SECTOR
        slots = keys + (row_bands + column_bands) * SECTOR
        slot_bytes = header.slot_correction[0] + TAG, header.slot_correction[1] + TAG
        columns_slots = slots + capacity[0] * slot_bytes[0]
        tiles = columns_slots + capacity[1] * slot_bytes[1]
        tile_bytes = rows * columns * header.pair_correction + TAG
        end = tiles + row_bands * column_bands * tile_bytes
        return cls(
            encoded[-DIGEST:],
            bands,
            state,
            keys,
            (slots, columns_slots),
            slot_bytes,
            tiles,
            tile_bytes,
            end,
        )

    def slot_at(self, owner: int, index: int) -> int:
        """Offset of a slot's record.

        Raises:
            ValueError: There is no such slot.
        """
        if owner not in (0, 1):
            raise ValueError(f"slots belong to party 0 or 1, not {owner}")
        capacity = self.bands.sizes[owner] * self.bands.counts[owner]
        if not 0 <= index < capacity:
            raise ValueError(f"party {owner} has slots 0 to {capacity - 1}, not {index}")
        return self.slots[owner] + index * self.slot_bytes[owner]

    def tile_at(self, row_band: int, column_band: int) -> int:
        """Offset of a tile's record.

        Raises:
            ValueError: There is no such tile.
        """
        self.check_band(0, row_band)
        self.check_band(1, column_band)
        return self.tiles + (row_band * self.bands.counts[1] + column_band) * self.tile_bytes

    def check_band(self, owner: int, band: int) -> None:
        """Refuse a band that there is not.

        Raises:
            ValueError: naming those that there are.
        """
        if not 0 <= band < self.bands.counts[owner]:
            most = self.bands.counts[owner] - 1
            raise ValueError(f"there are {('row', 'column')[owner]} bands 0 to {most}, not {band}")


def gallery_bytes(header: GalleryHeader) -> int:
    """The exact size of the file.

    Raises:
        ValueError: The header is too long for a tape.
    """
    return GalleryLayout.of(header, encode_gallery_header(header)).end


def encode_gallery_header(header: GalleryHeader) -> bytes:
    """The file's first bytes, digest included.

    Raises:
        ValueError: The header is too long for a tape.
    """
    return encode_envelope(GALLERY, header)


def read_gallery_header(descriptor: int, path: Path) -> tuple[GalleryHeader, GalleryLayout]:
    """Read and verify the header, and the file's size against it.

    Raises:
        TapeMismatch: A tape of another kind.
        TapeDamaged: Not a tape, another format version, a wrong digest, or the wrong size.
    """
    header, encoded = read_envelope(descriptor, path, GALLERY, GalleryHeader)
    layout = GalleryLayout.of(header, encoded)
    check_size(descriptor, path, layout.end)
    return header, layout


def _bands(slots: int, most: int) -> tuple[int, int]:
    """Size and number of the fewest bands, of one size that is as small as may be."""
    count = -(-slots // most)
    return -(-slots // count), count
