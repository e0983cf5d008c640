"""Writing a tape: the dealer's side of :mod:`spdz.tape`."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

from spdz.arithmetic import prf
from spdz.foundations.types import Buffer
from spdz.tape.envelope import SECTOR
from spdz.tape.format import CHUNK, Layout, TapeHeader, encode_header
from spdz.tape.publishing import NewFile
from spdz.tape.state import State, encode_slot


class TapeWriter:
    """Writes one tape, front to back, under a temporary name that becomes the real one when it is whole.

    A context manager: leaving it normally closes the tape, leaving it by an error removes what was written.

    Args:
        path: The tape to make; its folder is created with mode 0700 if missing. Mode 0600.
        header: What it is for.
        chain: The ratchet's 32 random bytes for job 0.
        alpha: This party's share of the MAC key, 16 bytes; any in semi-honest mode.

    Raises:
        FileExistsError: There is a file of that name. A dealt tape is never overwritten.
        ValueError: ``chain`` or ``alpha`` has the wrong length, or the header is too long.
        OSError: The file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], header: TapeHeader, chain: bytes, alpha: bytes) -> None:
        if len(chain) != 32 or len(alpha) != 16:
            raise ValueError(f"chain takes 32 bytes and alpha 16, not {len(chain)} and {len(alpha)}")
        self._path = Path(path)
        self._header = header
        self._chain = chain
        encoded = encode_header(header)
        self._layout = Layout.of(header, encoded)
        self._checksums = bytearray()
        self._appended = 0
        self._new: NewFile | None = NewFile(self._path)
        self._size = 0
        try:
            self._write(encoded.ljust(self._layout.slots, b"\0"))
            self._write(encode_slot(State(0, chain, alpha), 1, self._layout.digest))
            self._write(bytes(SECTOR))
        except BaseException:
            self.discard()
            raise

    @property
    def bytes_written(self) -> int:
        """Bytes of the tape so far; its file's size once closed."""
        return self._size

    def append(self, correction: Buffer) -> None:
        """Add the next job's correction, sealed under a key of the ratchet.

        Raises:
            ValueError: It is not exactly ``correction_bytes`` long, the tape is full, or closed.
            OSError: The file cannot be written.
        """
        view = memoryview(correction)
        if self._new is None:
            raise ValueError(f"{self._path}: the tape is closed")
        if self._appended == self._header.jobs:
            raise ValueError(f"{self._path}: all {self._header.jobs} jobs are written")
        if view.nbytes != self._header.correction_bytes:
            raise ValueError(
                f"{self._path}: a correction takes {self._header.correction_bytes} bytes, not {view.nbytes}"
            )
        if view.nbytes:
            view = memoryview(bytearray(view.cast("B")))
            prf.seal(prf.seal_key(self._chain), view)
            self._write(view)
            self._write(bytes(self._layout.stride - view.nbytes))
            first = self._appended * self._layout.chunks
            for k in range(self._layout.chunks):
                chunk = view[k * CHUNK : (k + 1) * CHUNK]
                self._checksums += self._layout.checksum(chunk, first + k).to_bytes(4, "little")
        self._appended += 1
        self._chain = prf.next_chain(self._chain)

    def close(self) -> None:
        """Write the checksums, make the file durable and give it its name. A second call does nothing.

        Raises:
            ValueError: Fewer jobs were appended than the header says; nothing is left behind.
            FileExistsError: Somebody else made a file of that name meanwhile.
            OSError: The file cannot be written.
        """
        if self._new is None:
            return
        try:
            if self._appended != self._header.jobs:
                raise ValueError(
                    f"{self._path}: {self._appended} jobs were written instead of {self._header.jobs}"
                )
            self._write(self._checksums)
            self._new.publish()
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove the unfinished file; a finished tape stays."""
        if self._new is not None:
            new, self._new = self._new, None
            new.discard()

    def __enter__(self) -> TapeWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _write(self, data: Buffer) -> None:
        if self._new is not None:
            self._size += self._new.file.write(data)
