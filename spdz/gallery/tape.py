"""A gallery's tape: one party's half of what was dealt for slots of descriptors and all their pairs.

Slots of party 0 are rows and slots of party 1 are columns. They come in bands of at most 16; a tile is a row
band and a column band with a dealt record for each of their pairs, and is read as a whole. Unlike the jobs of
:class:`spdz.tape.Tape` records stay readable: what keeps them from being used twice is whoever keeps count of
the slots that were filled. What is done with is erased band by band.

- *One process.* The tape is locked, against copies of it as well; a fork is noticed.
- *Destroying.* Wipes alpha and all keys, and leaves a mark that refuses every copy on this machine.

Cost of a read: one system call, then unsealing and expanding outside the lock, so that threads do it at the
same time.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError
from spdz.foundations.types import Block
from spdz.gallery import keys
from spdz.gallery.format import GalleryHeader, GalleryLayout, read_gallery_header
from spdz.gallery.table import KeyTable
from spdz.tape.advice import replacement
from spdz.tape.high_water import HighWater, Mark
from spdz.tape.hold import Hold
from spdz.tape.state import State, StateSlots


@dataclass(frozen=True, slots=True)
class SlotRecord:
    """One party's share of what was dealt for a slot.

    Attributes:
        pad: ``uint8`` of shape (slot_pad[owner],).
        correction: ``slot_correction[owner]`` bytes, read-only.
        hash_key: 16 public bytes, the same for both parties.
    """

    pad: npt.NDArray[np.uint8] = field(repr=False)
    correction: memoryview = field(repr=False)
    hash_key: bytes


@dataclass(frozen=True, slots=True)
class TileRecord:
    """One party's share of what was dealt for all pairs of a row band and a column band.

    Attributes:
        delta: A block, shape (2,).
        pad: ``uint8`` of shape (rows, columns, pair_pad), contiguous, 16-byte blocks of one stream.
        correction: ``uint8`` of shape (rows, columns, pair_correction), contiguous, read-only.
        hash_key: 16 public bytes, the same for both parties.
    """

    delta: Block = field(repr=False)
    pad: npt.NDArray[np.uint8] = field(repr=False)
    correction: npt.NDArray[np.uint8] = field(repr=False)
    hash_key: bytes


class GalleryTape:
    """An open tape of a gallery. Use :meth:`open`; a context manager; safe to share between threads.

    Attributes:
        header: What the tape is for.
    """

    def __init__(self, hold: Hold, header: GalleryHeader, layout: GalleryLayout, mark: HighWater) -> None:
        self.header = header
        self._hold = hold
        self._path = hold.path
        self._layout = layout
        self._mark = mark
        self._descriptor = hold.file.fileno()
        self._slots = StateSlots(self._descriptor, layout.state, layout.digest)
        self._table = KeyTable(self._descriptor, layout, hold.path, header.dealer_command)
        self._state: State | None = None

    @classmethod
    def open(cls, path: str | os.PathLike[str], *, state_dir: Path | None = None) -> GalleryTape:
        """Open and lock a tape.

        Args:
            path: The tape.
            state_dir: Where it is remembered that a tape was destroyed; by default ``$XDG_STATE_HOME/spdz``
                or ``~/.local/state/spdz``. Always give the same one for a tape.

        Raises:
            TapeInUse: It, or a copy of it, is open already.
            TapeMismatch: It is a tape of another kind.
            TapeDamaged: It is not a whole tape; the message says where. Keys and records are checked when
                they are used.
            TapeDestroyed: It was destroyed, or is a copy of a tape that was.
            TapeError: It, or its high-water mark, cannot be read or written.
        """
        hold = Hold(Path(path))
        try:
            with hold.one_at_a_time():
                header, layout = read_gallery_header(hold.file.fileno(), hold.path)
                tape = cls(hold, header, layout, hold.lock_copies(header, state_dir))
                tape._recover()
        except BaseException:
            with hold.closing():
                pass
            raise
        return tape

    @property
    def alpha(self) -> bytes:
        """This party's share of the MAC key, 16 bytes."""
        return self._usable().alpha

    def slot(self, owner: int, index: int) -> SlotRecord:
        """Read a slot.

        Args:
            owner: Whose descriptor it is for: party 0 (rows) or 1 (columns).
            index: Which, below ``header.capacity[owner]``.

        Raises:
            ValueError: There is no such slot.
            TapeExhausted: Its band was erased.
            TapeDamaged: Its record or its band's key is damaged or of another place; the message says where.
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, destroyed, or cannot be read.
        """
        layout = self._layout
        offset, what = layout.slot_at(owner, index), f"slot {index} of party {owner}"
        band, place = divmod(index, layout.bands.sizes[owner])
        with self._hold.one_at_a_time():
            self._usable()
            band_key = self._table.key(owner, band)
            record = self._read(offset, layout.slot_bytes[owner], what)
        key = keys.slot_keys(band_key, place)
        correction = keys.unseal(key.seal, record, keys.slot_place(layout.digest, owner, index))
        if correction is None:
            raise self._damaged(what, offset)
        pad = keys.slot_pad(key.pad, self.header.slot_pad[owner])
        return SlotRecord(pad, memoryview(correction), keys.slot_hash_key(self.header.tape, owner, index))

    def tile(self, row_band: int, column_band: int) -> TileRecord:
        """Read a tile.

        Raises:
            ValueError: There is no such tile.
            TapeExhausted: One of its bands was erased.
            TapeDamaged: It or a band's key is damaged or of another place; the message says where.
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, destroyed, or cannot be read.
        """
        layout, header = self._layout, self.header
        offset, what = layout.tile_at(row_band, column_band), f"tile ({row_band}, {column_band})"
        with self._hold.one_at_a_time():
            self._usable()
            row_key, column_key = self._table.key(0, row_band), self._table.key(1, column_band)
            record = self._read(offset, layout.tile_bytes, what)
        key = keys.tile_keys(row_key, column_key)
        sealed = keys.unseal(key.seal, record, keys.tile_place(layout.digest, row_band, column_band))
        if sealed is None:
            raise self._damaged(what, offset)
        rows, columns = layout.bands.sizes
        correction = np.frombuffer(sealed, np.uint8).reshape(rows, columns, header.pair_correction)
        delta, pad = keys.tile_pad(key.pad, rows, columns, header.pair_pad)
        return TileRecord(delta, pad, correction, keys.tile_hash_key(header.tape, row_band, column_band))

    def erase(self, rows: Sequence[int] = (), columns: Sequence[int] = ()) -> None:
        """Erase the keys of bands, and with them all of their slots and tiles. Erasing twice does nothing.

        On return the keys are nowhere in the file; a copy that was made earlier still has them. After an
        error erase them again.

        Raises:
            ValueError: There is no such band; nothing was erased.
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, destroyed, or the disk failed.
        """
        bands = [(0, band) for band in rows] + [(1, band) for band in columns]
        for band in bands:
            self._layout.check_band(*band)
        with self._hold.one_at_a_time():
            self._usable()
            self._table.erase(bands)

    def destroy(self) -> None:
        """Overwrite alpha and all keys and mark the tape destroyed, here and in its high-water mark.

        For a failed MAC check: alpha must not be used again. A second call does nothing.

        Raises:
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, or the disk failed.
        """
        with self._hold.one_at_a_time():
            if self._hold.file.closed:
                raise TapeError(f"{self._path}: the tape is closed")
            if self._state is None or not self._state.destroyed:
                self._destroy()

    def close(self) -> None:
        """Unlock the tape. A second call does nothing; in a fork the lock stays the parent's."""
        with self._hold.closing():
            self._state = None
            self._table.forget()

    def __repr__(self) -> str:
        rows, columns = self.header.slots
        return f"<gallery tape of {self.header.name} for {self.header.peer}: {rows} x {columns} slots>"

    def __enter__(self) -> GalleryTape:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _usable(self) -> State:
        if self._state is None:
            raise TapeError(f"{self._path}: the tape is closed, or destroying it failed: open it again")
        if self._state.destroyed:
            raise TapeDestroyed(f"{self._path}: the tape was destroyed. Deal a new pair of tapes")
        return self._state

    def _recover(self) -> None:
        """Load state and keys, or destroy what was destroyed before: a copy, or one interrupted at it."""
        mark = self._mark.read()
        state = self._slots.load()
        if (mark is not None and mark.destroyed) or (state is not None and state.destroyed):
            self._destroy()
            raise TapeDestroyed(
                f"{self._path}: the tape was destroyed, because a MAC check failed. "
                "A copy of it cannot be used either. Deal a new pair of tapes"
            )
        if state is None:
            raise TapeDamaged(
                f"{self._path}: the checksums of the state at byte {self._layout.state} do not hold. "
                f"{replacement(None)}"
            )
        self._table.load()
        self._state = state

    def _destroy(self) -> None:
        self._state = None
        wiped = State.wiped(0)
        try:
            self._mark.write(Mark(0, destroyed=True))
        finally:
            try:
                self._table.wipe()
            finally:
                self._slots.store(wiped)
        self._state = wiped

    def _read(self, offset: int, size: int, what: str) -> bytes:
        record = os.pread(self._descriptor, size, offset)
        if len(record) != size:
            raise TapeDamaged(
                f"{self._path}: the tape ends before {what}, which is at byte {offset}: truncated. "
                f"{replacement(None)}"
            )
        return record

    def _damaged(self, what: str, offset: int) -> TapeDamaged:
        return TapeDamaged(
            f"{self._path}: {what} at byte {offset} is not what was dealt: damaged, or of another place or "
            f"tape. {replacement(None)}"
        )
