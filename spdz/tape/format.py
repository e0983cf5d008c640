"""The tape file: its header and where everything lies.

::

    0           kind, header and digest                         spdz.tape.envelope
    slots       two state slots, a sector each                  spdz.tape.state
    corrections jobs x correction_bytes                         each padded to a multiple of 16
    checksums   jobs x ceil(correction_bytes / CHUNK) x CRC-32  one a chunk
    end

All integers are little-endian. Every length is checked against the file's size before it is believed.
The checksums find accidental damage; deliberate damage is an additive error on shares, which the MAC check
catches. They are bound to the tape and to their place, so that a block that landed elsewhere is found too.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

from spdz.tape.envelope import DIGEST, JOBS, SECTOR, check_size, encode_envelope, read_envelope, round_up
from spdz.tape.header import Header, check_integer

CHUNK = 1 << 20
MAX_JOBS = 1 << 32
MAX_JOB_BYTES = 1 << 40


@dataclass(frozen=True, slots=True)
class TapeHeader(Header):
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

    jobs: int
    pad_bytes: int
    correction_bytes: int

    def __post_init__(self) -> None:
        Header.__post_init__(self)  # super() finds no class made with slots=True
        check_integer("jobs", self.jobs, 1, MAX_JOBS)
        check_integer("pad_bytes", self.pad_bytes, 0, MAX_JOB_BYTES)
        check_integer("correction_bytes", self.correction_bytes, 0, MAX_JOB_BYTES)

    @property
    def dealer_command(self) -> str:
        """The command that deals more of the same."""
        command = self.dealing("score", "dim", "reveal", "tile", "max_norm", "min_norm")
        proof = " --norm-proof" if self.program.get("norm_proof") else ""
        return f"{command}{proof} --count N --out FOLDER"


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
        slots = round_up(len(encoded), SECTOR)
        corrections = slots + 2 * SECTOR
        stride = round_up(header.correction_bytes, 16)
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
    return encode_envelope(JOBS, header)


def read_header(descriptor: int, path: Path) -> tuple[TapeHeader, Layout]:
    """Read and verify the header, and the file's size against it.

    Raises:
        TapeMismatch: A tape of another kind.
        TapeDamaged: Not a tape, another format version, a wrong digest, or the wrong size.
    """
    header, encoded = read_envelope(descriptor, path, JOBS, TapeHeader)
    layout = Layout.of(header, encoded)
    check_size(descriptor, path, layout.end)
    return header, layout
