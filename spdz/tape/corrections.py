"""Reading and verifying the stored corrections of a tape."""

from __future__ import annotations

import struct
from io import FileIO
from pathlib import Path

import numpy as np

from spdz.foundations.errors import TapeDamaged
from spdz.tape.advice import replacement
from spdz.tape.format import CHUNK, Layout, TapeHeader


def read_corrections(
    file: FileIO, path: Path, header: TapeHeader, layout: Layout, first: int, count: int, *, used: bool
) -> list[memoryview]:
    """The verified corrections of jobs ``first`` to ``first + count - 1``, from one contiguous read.

    ``used`` tells whether any job of the tape was ever used: what to do about damage depends on it.

    Returns:
        One writable view a job, ``correction_bytes`` long and 16-byte aligned, still sealed.

    Raises:
        TapeDamaged: A checksum does not hold; the message names the job and the byte offset.
        OSError: The file cannot be read.
    """
    size, stride, chunks = header.correction_bytes, layout.stride, layout.chunks
    if size == 0:
        return [memoryview(bytearray())] * count
    data = _aligned(count * stride)
    _fill(file, path, layout.corrections + first * stride, data, used=used)
    table = memoryview(bytearray(4 * count * chunks))
    _fill(file, path, layout.checksums + 4 * first * chunks, table, used=used)
    corrections = [data[start : start + size] for start in range(0, count * stride, stride)]
    for k, expected in enumerate(struct.unpack(f"<{count * chunks}I", table)):
        job, chunk = divmod(k, chunks)
        part = corrections[job][chunk * CHUNK : (chunk + 1) * CHUNK]
        if layout.checksum(part, first * chunks + k) != expected:
            offset = layout.corrections + (first + job) * stride + chunk * CHUNK
            raise TapeDamaged(
                f"{path}: the checksum of job {first + job} does not hold at byte {offset}. "
                f"{replacement(used)}"
            )
    return corrections


def _fill(file: FileIO, path: Path, offset: int, view: memoryview, *, used: bool) -> None:
    file.seek(offset)
    while view:  # one read returns at most 2 GB
        got = file.readinto(view)
        if not got:
            raise TapeDamaged(
                f"{path}: the tape ends at byte {offset}, before its checksums: truncated. "
                f"{replacement(used)}"
            )
        view, offset = view[got:], offset + got


def _aligned(size: int) -> memoryview:
    """A new buffer whose first byte lies at a multiple of 16."""
    memory = np.empty(size + 16, np.uint8)
    start = -memory.ctypes.data % 16
    return memory[start : start + size].data
