"""The tape file: its header and where everything lies.

::

    0           magic, format version, length of the header     PREFIX
    16          header, JSON                                    at most MAX_HEADER bytes
                blake2b-16 of all the above                     the header's digest; then zeros to a sector
    slots       two state slots, a sector each                  spdz.tape.state
    corrections jobs x correction_bytes                         each padded to a multiple of 16
    checksums   jobs x ceil(correction_bytes / CHUNK) x CRC-32  one a chunk
    end

All integers are little-endian. Every length is checked against the file's size before it is believed.
The checksums find accidental damage; deliberate damage is an additive error on shares, which the MAC check
catches. They are bound to the tape and to their place, so that a block that landed elsewhere is found too.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import stat
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

from spdz.foundations.errors import TapeDamaged
from spdz.foundations.types import Json, Security
from spdz.tape.advice import cannot_open, replacement

MAGIC = b"spdztape"
VERSION = 1
PREFIX = struct.Struct("<8sII")
DIGEST = 16
SECTOR = 4096
CHUNK = 1 << 20
MAX_HEADER = 1 << 16
MAX_JOBS = 1 << 32
MAX_JOB_BYTES = 1 << 40

_EXAMPLE = "Give a file that the dealer wrote, such as mission/alice/bob.tape"
_HEX = re.compile(r"[0-9a-f]{1,128}")


@dataclass(frozen=True, slots=True)
class TapeHeader:
    """What a tape is for: public, unchanging, and checked against the peer's in the handshake.

    Attributes:
        mission: Lower-case hex id of the dealing run.
        tape: Lower-case hex id shared by the two tapes of this pair.
        agents: Names of party 0 and party 1.
        party: 0 or 1: whose tape this is.
        security: The security model it was dealt for.
        fingerprint: Hex; what the meter saw of the program.
        program: The program's public parameters, as JSON.
        jobs: Number of jobs, 1 to 2**32.
        pad_bytes: Pseudo-random bytes a job, expanded from its key.
        correction_bytes: Stored bytes a job.

    Raises:
        ValueError: A field is out of range or of the wrong type.
    """

    mission: str
    tape: str
    agents: tuple[str, str]
    party: int
    security: Security
    fingerprint: str
    program: Mapping[str, Json]
    jobs: int
    pad_bytes: int
    correction_bytes: int

    def __post_init__(self) -> None:
        for name in ("mission", "tape", "fingerprint"):
            value = getattr(self, name)
            if not isinstance(value, str) or not _HEX.fullmatch(value):
                raise ValueError(f"{name} must be 1 to 128 lower-case hexadecimal digits, not {value!r}")
        for name, least, most in (
            ("party", 0, 1),
            ("jobs", 1, MAX_JOBS),
            ("pad_bytes", 0, MAX_JOB_BYTES),
            ("correction_bytes", 0, MAX_JOB_BYTES),
        ):
            value = getattr(self, name)
            if type(value) is not int or not least <= value <= most:
                raise ValueError(f"{name} must be an integer from {least} to {most}, not {value!r}")
        if self.security not in get_args(Security):
            raise ValueError(f"security must be one of {get_args(Security)}, not {self.security!r}")
        agents = tuple(self.agents)
        if len(agents) != 2 or agents[0] == agents[1]:
            raise ValueError(f"agents must be two different names, not {self.agents!r}")
        if not all(isinstance(name, str) and name and name.isprintable() for name in agents):
            raise ValueError(f"agents must be printable names, not {self.agents!r}")
        try:
            program = json.loads(json.dumps(self.program, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise ValueError(f"program must be JSON: {error}") from error
        if not isinstance(program, dict):
            raise ValueError(f"program must be a JSON object, not {self.program!r}")
        object.__setattr__(self, "agents", agents)
        object.__setattr__(self, "program", program)  # as it will be read back: tuples are lists

    @property
    def name(self) -> str:
        """The robot whose tape this is."""
        return self.agents[self.party]

    @property
    def peer(self) -> str:
        """The robot that has the other tape."""
        return self.agents[1 - self.party]

    @property
    def dealer_command(self) -> str:
        """The command that deals more of the same."""
        words = [f"--agents {shlex.join(self.agents)}"]
        for key, value in self.program.items():
            if key in ("score", "dim", "reveal", "tile", "max_norm"):
                text = "x".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                words.append(f"--{key.replace('_', '-')} {shlex.quote(text)}")
        return f"python -m spdz.dealer {' '.join(words)} --security {self.security} --count N --out FOLDER"


@dataclass(frozen=True, slots=True)
class Layout:
    """Byte offsets of a tape's parts, all functions of the header.

    Attributes:
        digest: The header's digest: what binds the parts of one file together.
        slots: Offset of the two state slots.
        corrections: Offset of the first job's correction.
        stride: Distance between two corrections: correction_bytes rounded up to a multiple of 16.
        checksums: Offset of the checksum table.
        chunks: Checksums a job.
        end: The file's size.
    """

    digest: bytes
    slots: int
    corrections: int
    stride: int
    checksums: int
    chunks: int
    end: int

    @classmethod
    def of(cls, header: TapeHeader, encoded: bytes) -> Layout:
        """Lay out a tape whose header, digest included, is ``encoded``."""
        slots = _round_up(len(encoded), SECTOR)
        corrections = slots + 2 * SECTOR
        stride = _round_up(header.correction_bytes, 16)
        checksums = corrections + header.jobs * stride
        chunks = -(-header.correction_bytes // CHUNK)
        end = checksums + 4 * header.jobs * chunks
        return cls(encoded[-DIGEST:], slots, corrections, stride, checksums, chunks, end)

    def checksum(self, chunk: memoryview, number: int) -> int:
        """CRC-32 of the tape's ``number``-th chunk, started from a value that says where it belongs."""
        return zlib.crc32(chunk, (int.from_bytes(self.digest[:4], "little") + number) & 0xFFFFFFFF)


def encode_header(header: TapeHeader) -> bytes:
    """The file's first bytes, digest included.

    Raises:
        ValueError: The header is longer than MAX_HEADER.
    """
    body = json.dumps(asdict(header), sort_keys=True, separators=(",", ":")).encode()
    if len(body) > MAX_HEADER:
        raise ValueError(f"the tape's header takes {len(body)} bytes; at most {MAX_HEADER} are allowed")
    data = PREFIX.pack(MAGIC, VERSION, len(body)) + body
    return data + _digest(data)


def read_header(descriptor: int, path: Path) -> tuple[TapeHeader, Layout]:
    """Read and verify the header, and the file's size against it.

    Raises:
        TapeDamaged: Not a tape, another format version, a wrong digest, or the wrong size.
    """
    kind, size = os.fstat(descriptor).st_mode, os.fstat(descriptor).st_size
    if stat.S_ISDIR(kind):
        raise cannot_open(path, IsADirectoryError(), writing=False)
    if not stat.S_ISREG(kind):
        raise TapeDamaged(f"{path}: not a tape: a pipe, a device or a socket. {_EXAMPLE}")
    prefix = os.pread(descriptor, PREFIX.size, 0)
    if len(prefix) < PREFIX.size or not prefix.startswith(MAGIC):
        raise TapeDamaged(f"{path}: not a tape: it does not start with {MAGIC!r}. {_EXAMPLE}")
    _, version, length = PREFIX.unpack(prefix)
    if version != VERSION:
        raise TapeDamaged(
            f"{path}: tape format {version}, but this version of spdz reads format {VERSION}: use the "
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
        fields: dict[str, Any] = json.loads(encoded[PREFIX.size : -DIGEST])
        header = TapeHeader(**fields)
    except (ValueError, TypeError, RecursionError) as error:
        raise TapeDamaged(f"{path}: the header makes no sense: {error}. {replacement(None)}") from error
    layout = Layout.of(header, encoded)
    if size != layout.end:
        raise TapeDamaged(
            f"{path}: {size} bytes long instead of {layout.end}: truncated or not copied whole. "
            f"{replacement(None)}"
        )
    return header, layout


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST).digest()


def _round_up(size: int, multiple: int) -> int:
    return -(-size // multiple) * multiple
