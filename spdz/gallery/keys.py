"""Keys of a gallery's records, their pads, and their seals.

Each band of slots has a random key, which no other band has and no other tape. From these::

    tile's keys   H(label, key of the row band, key of the column band)   one for its pad, one for its seal
    slot's keys   H(label, key of the band, place in the band)            the same
    pad           AES-CTR stream of the pad key                           spdz.prf.expand
    record        AES-256-GCM of the correction under the seal key        NIST SP 800-38D

Without a band's key neither the pads nor the corrections of its slots and tiles can be recomputed. A seal key
seals one record, so the nonce is a constant (SP 800-38D section 8 asks that no pair of key and nonce occurs
twice). The record's place is authenticated with it: damage is noticed, and a record of another place or tape.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from spdz.arithmetic import prf
from spdz.foundations.types import Block, Buffer

KEY_BYTES = 32
"""Length of a band's key."""

HASH_KEY_BYTES = 16

_BLOCK = 16
_NONCE = bytes(12)
_PLACE = struct.Struct("<II")
_TILE_PAD = b"spdz gallery v1: pad of a tile\0"
_TILE_SEAL = b"spdz gallery v1: seal of a tile\0"
_SLOT_PAD = b"spdz gallery v1: pad of a slot\0"
_SLOT_SEAL = b"spdz gallery v1: seal of a slot\0"
_TILE_HASH = b"spdz gallery v1: hash key of a tile\0"
_SLOT_HASH = b"spdz gallery v1: hash key of a slot\0"


@dataclass(frozen=True, slots=True)
class RecordKeys:
    """The two keys of one slot or tile, 32 bytes each, used for nothing else.

    Attributes:
        pad: Its stream is the pad.
        seal: Seals the stored correction.
    """

    pad: bytes = field(repr=False)
    seal: bytes = field(repr=False)


def tile_keys(row_key: bytes, column_key: bytes) -> RecordKeys:
    """The keys of a tile, from those of its two bands."""
    keys = row_key + column_key
    return RecordKeys(hashlib.sha256(_TILE_PAD + keys).digest(), hashlib.sha256(_TILE_SEAL + keys).digest())


def slot_keys(band_key: bytes, place: int) -> RecordKeys:
    """The keys of the slot at ``place`` in its band."""
    key = band_key + struct.pack("<I", place)
    return RecordKeys(hashlib.sha256(_SLOT_PAD + key).digest(), hashlib.sha256(_SLOT_SEAL + key).digest())


def tile_hash_key(tape: str, row_band: int, column_band: int) -> bytes:
    """The public 16-byte hash key of a tile, the same for both parties; ``tape`` is the header's hex id."""
    return _hash_key(_TILE_HASH, tape, row_band, column_band)


def slot_hash_key(tape: str, owner: int, index: int) -> bytes:
    """The public 16-byte hash key of slot ``index`` of party ``owner``, the same for both parties."""
    return _hash_key(_SLOT_HASH, tape, owner, index)


def tile_pad(pad_key: bytes, rows: int, columns: int, pair_pad: int) -> tuple[Block, npt.NDArray[np.uint8]]:
    """Expand a tile's pad.

    Returns:
        The block Delta, shape (2,), and the pairs' pads, ``uint8`` of shape (rows, columns, pair_pad).
    """
    size = rows * columns * pair_pad
    stream = prf.expand(pad_key, _BLOCK + _whole_blocks(size))
    return stream[0], stream[1:].view(np.uint8).reshape(-1)[:size].reshape(rows, columns, pair_pad)


def slot_pad(pad_key: bytes, size: int) -> npt.NDArray[np.uint8]:
    """Expand a slot's pad: ``uint8`` of shape (size,)."""
    return prf.expand(pad_key, _whole_blocks(size)).view(np.uint8).reshape(-1)[:size]


def slot_place(digest: bytes, owner: int, index: int) -> bytes:
    """What a slot's record is bound to; ``digest`` is the header's."""
    return digest + b"S" + _PLACE.pack(owner, index)


def tile_place(digest: bytes, row_band: int, column_band: int) -> bytes:
    """What a tile's record is bound to; ``digest`` is the header's."""
    return digest + b"T" + _PLACE.pack(row_band, column_band)


def seal(seal_key: bytes, correction: Buffer, place: bytes) -> bytes:
    """Encrypt and authenticate a correction: TAG bytes longer."""
    return AESGCM(seal_key).encrypt(_NONCE, correction, place)


def unseal(seal_key: bytes, record: bytes, place: bytes) -> bytes | None:
    """The correction that was sealed for ``place``; None if this is not what was sealed."""
    try:
        return AESGCM(seal_key).decrypt(_NONCE, record, place)
    except InvalidTag:
        return None


def _hash_key(label: bytes, tape: str, first: int, second: int) -> bytes:
    place = label + tape.encode() + b"\0" + _PLACE.pack(first, second)
    return hashlib.sha256(place).digest()[:HASH_KEY_BYTES]


def _whole_blocks(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK
