"""The first bytes of every tape file: its kind, its header, and the digest that binds its parts together.

::

    0           magic, format version, length of the header     PREFIX
    16          header, JSON with sorted keys                   at most MAX_HEADER bytes
                blake2b-16 of all the above                     the header's digest; then zeros to a sector

All integers are little-endian.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

from spdz.foundations.errors import TapeDamaged, TapeMismatch
from spdz.tape.advice import cannot_open, replacement
from spdz.tape.header import Header

PREFIX = struct.Struct("<8sII")
DIGEST = 16
SECTOR = 4096
MAX_HEADER = 1 << 16

_EXAMPLE = "Give a file that the dealer wrote, such as mission/alice/bob.tape"
_H = TypeVar("_H", bound=Header)


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of tape file.

    Attributes:
        magic: Its first 8 bytes.
        version: The format version that is written and read.
        name: What it is, for people.
        opened_by: Who takes it.
    """

    magic: bytes
    version: int
    name: str
    opened_by: str


JOBS = Kind(b"spdztape", 1, "a tape of jobs", "spdz.tape.Tape (python -m spdz match)")
GALLERY = Kind(b"spdzgall", 1, "a gallery's tape, dealt with --slots", "spdz.gallery.GalleryTape")
KINDS = (JOBS, GALLERY)


def is_gallery(path: Path) -> bool:
    """Whether a file begins as a gallery's tape does; False where it cannot be read."""
    try:
        # O_NONBLOCK: a named pipe must not make this wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        return os.pread(descriptor, len(GALLERY.magic), 0) == GALLERY.magic
    except OSError:
        return False
    finally:
        os.close(descriptor)


def encode_envelope(kind: Kind, header: Header) -> bytes:
    """The file's first bytes, digest included.

    Raises:
        ValueError: The header is longer than MAX_HEADER.
    """
    body = json.dumps(asdict(header), sort_keys=True, separators=(",", ":")).encode()
    if len(body) > MAX_HEADER:
        raise ValueError(f"the tape's header takes {len(body)} bytes; at most {MAX_HEADER} are allowed")
    data = PREFIX.pack(kind.magic, kind.version, len(body)) + body
    return data + _digest(data)


def read_envelope(descriptor: int, path: Path, kind: Kind, make: Callable[..., _H]) -> tuple[_H, bytes]:
    """Read and verify the header of a tape that should be of one kind.

    Args:
        descriptor: The file.
        path: Its name, for messages.
        kind: What it should be.
        make: The header's class.

    Returns:
        The header, and its encoding with the digest.

    Raises:
        TapeMismatch: A tape of another kind; the message says who takes it.
        TapeDamaged: Not a tape, another format version, or a wrong digest.
    """
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISDIR(mode):
        raise cannot_open(path, IsADirectoryError(), writing=False)
    if not stat.S_ISREG(mode):
        raise TapeDamaged(f"{path}: not a tape: a pipe, a device or a socket. {_EXAMPLE}")
    prefix = os.pread(descriptor, PREFIX.size, 0)
    for other in KINDS:
        if other is not kind and prefix.startswith(other.magic):
            raise TapeMismatch(
                f"{path}: {other.name}: {other.opened_by} takes it. "
                f"Needed here is {kind.name}, which {kind.opened_by} takes"
            )
    if len(prefix) < PREFIX.size or not prefix.startswith(kind.magic):
        raise TapeDamaged(f"{path}: not a tape: it does not start with {kind.magic!r}. {_EXAMPLE}")
    _, version, length = PREFIX.unpack(prefix)
    if version != kind.version:
        raise TapeDamaged(
            f"{path}: tape format {version}, but this version of spdz reads format {kind.version}: use the "
            "version that dealt it, or deal anew for both robots"
        )
    if length > MAX_HEADER:
        raise TapeDamaged(
            f"{path}: the header claims {length} bytes; at most {MAX_HEADER} are allowed. {replacement(None)}"
        )
    encoded = prefix + os.pread(descriptor, length + DIGEST, PREFIX.size)
    if len(encoded) != PREFIX.size + length + DIGEST or _digest(encoded[:-DIGEST]) != encoded[-DIGEST:]:
        raise TapeDamaged(
            f"{path}: the checksum of the header (bytes 0 to {PREFIX.size + length}) does not hold. "
            f"{replacement(None)}"
        )
    try:
        header = make(**json.loads(encoded[PREFIX.size : -DIGEST]))
    except (ValueError, TypeError, RecursionError) as error:
        raise TapeDamaged(f"{path}: the header makes no sense: {error}. {replacement(None)}") from error
    return header, encoded


def check_size(descriptor: int, path: Path, end: int) -> None:
    """Hold the file's size against what its header says.

    Raises:
        TapeDamaged: It has another.
    """
    size = os.fstat(descriptor).st_size
    if size != end:
        raise TapeDamaged(
            f"{path}: {size} bytes long instead of {end}: truncated or not copied whole. {replacement(None)}"
        )


def round_up(size: int, multiple: int) -> int:
    """The smallest multiple that is not below ``size``."""
    return -(-size // multiple) * multiple


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST).digest()
