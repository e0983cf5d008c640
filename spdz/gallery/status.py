"""What a gallery's tape is for and what was used of it, read without opening it for use.

Nothing is written and no lock of the gallery is taken: it may be looked at while a robot uses it. The mark is
read whole; the ledger is opened read-only and left at once (a robot that writes waits for so long). What is
seen may be out of date at once. :func:`verify_gallery` unseals every record with the keys on the tape, and
keeps none of what it reads.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery import keys
from spdz.gallery.format import GalleryHeader, GalleryLayout, read_gallery_header
from spdz.gallery.mark import Mark
from spdz.gallery.mark_file import MarkFile
from spdz.gallery.runs import slots_in
from spdz.gallery.strip import Rectangle, Strip
from spdz.gallery.table import KeyTable
from spdz.tape.advice import cannot_open, replacement
from spdz.tape.high_water import default_state_dir, read_mark
from spdz.tape.status import is_in_use, read_state

Report = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class GalleryStatus:
    """A gallery at one moment; public facts only.

    Attributes:
        header: What the tape is for.
        size: Bytes of the tape's file.
        filled: Slots used for ever, of party 0 and of party 1.
        void: Those among them that hold nothing.
        done: The rectangle of pairs that were used, burnt ones included.
        burnt: Pairs that were given up: they have no result. None where the ledger cannot be read without
            mending it: a robot was stopped while it wrote, and will mend it when it opens it.
        pinned: What the gallery answers and nothing else, in words; None while that is open.
        flight: The strip that was begun and neither finished nor given up.
        has_ledger: Whether there is a ledger beside the tape.
        in_use: Whether a process has the tape, or a copy of it, open.
        destroyed: Whether it was destroyed after a failed MAC check.
        rolled_back: Whether the ledger is behind its mark, or missing although there is one: it was copied
            back from a backup, or lost.
    """

    header: GalleryHeader
    size: int
    filled: tuple[int, int]
    void: tuple[int, int]
    done: Rectangle
    burnt: int | None
    pinned: str | None
    flight: Strip | None
    has_ledger: bool
    in_use: bool
    destroyed: bool
    rolled_back: bool

    @property
    def left(self) -> tuple[int, int]:
        """Slots that can still be filled, of party 0 and of party 1."""
        if self.destroyed:
            return 0, 0
        capacity = self.header.capacity
        return capacity[0] - self.filled[0], capacity[1] - self.filled[1]


def gallery_status(path: Path, state_dir: Path | None = None) -> GalleryStatus:
    """Look at a gallery's tape, and at the ledger beside it.

    Args:
        path: The tape.
        state_dir: Where its marks are kept; the user's state folder if not given.

    Raises:
        TapeMismatch: It is a tape of another kind.
        TapeDamaged: Tape, ledger or mark is not whole, or they are not of one gallery.
        TapeError: One of them cannot be read.
    """
    with _reading(path) as descriptor:
        return _status(descriptor, path, state_dir or default_state_dir())


def verify_gallery(path: Path, progress: Report = lambda done, total: None) -> None:
    """Unseal every slot and tile whose keys were not erased.

    Args:
        path: The tape.
        progress: Called with bytes verified and bytes in all.

    Raises:
        TapeDamaged: A record or key is not what was dealt; the message names the first and its byte.
        TapeError: The file cannot be read.
    """
    with _reading(path) as descriptor:
        header, layout = read_gallery_header(descriptor, path)
        table = KeyTable(descriptor, layout, path, header.dealer_command)
        table.load()
        first = layout.slots[0]
        for what, offset, size, seal, place in _records(layout, table):
            if keys.unseal(seal, os.pread(descriptor, size, offset), place) is None:
                raise TapeDamaged(
                    f"{path}: {what} at byte {offset} is not what was dealt: damaged, or of another place or "
                    f"tape. {replacement(None)}"
                )
            progress(offset + size - first, layout.end - first)


def _records(layout: GalleryLayout, table: KeyTable) -> Iterator[tuple[str, int, int, bytes, bytes]]:
    """Name, offset, size, seal key and place of every record that can be read."""
    bands, digest = layout.bands, layout.digest
    there = [[band for band in range(bands.counts[i]) if not table.is_erased(i, band)] for i in (0, 1)]
    for owner in (0, 1):
        for band in there[owner]:
            band_key = table.key(owner, band)
            for place in range(bands.sizes[owner]):
                slot = band * bands.sizes[owner] + place
                seal = keys.slot_keys(band_key, place).seal
                where = keys.slot_place(digest, owner, slot)
                size = layout.slot_bytes[owner]
                yield f"slot {slot} of party {owner}", layout.slot_at(owner, slot), size, seal, where
    for row in there[0]:
        for column in there[1]:
            seal = keys.tile_keys(table.key(0, row), table.key(1, column)).seal
            where = keys.tile_place(digest, row, column)
            yield f"tile ({row}, {column})", layout.tile_at(row, column), layout.tile_bytes, seal, where


@contextmanager
def _reading(path: Path) -> Iterator[int]:
    """The tape, open for reading."""
    try:
        # O_NONBLOCK: a named pipe must not make this wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise cannot_open(path, error, writing=False) from error
    try:
        yield descriptor
    except OSError as error:
        raise TapeError(f"{path}: cannot read the gallery ({error.strerror})") from error
    finally:
        os.close(descriptor)


def _status(descriptor: int, path: Path, folder: Path) -> GalleryStatus:
    header, layout = read_gallery_header(descriptor, path)
    in_use = is_in_use(descriptor, folder, header)
    state = read_state(descriptor, layout.state, layout.digest)
    kept = read_mark(folder, header.tape, header.party)
    # A step is in the ledger first: read last it is never behind the mark, unless it was restored.
    marked = MarkFile(folder, header.tape, header.party).read()
    ledger = path.with_suffix(".ledger")
    has_ledger = ledger.exists() and ledger.stat().st_size > 0
    written, burnt = _read_ledger(ledger, header) if has_ledger else (None, 0)
    known = [one for one in (marked, written) if one is not None]
    now = max(known, key=lambda one: one.sequence, default=Mark.first(header.tape, header.party))
    destroyed = any(one is not None and one.destroyed for one in (state, kept, marked, written))
    if state is None and not destroyed:
        raise TapeDamaged(
            f"{path}: the checksums of the state at byte {layout.state} do not hold. {replacement(None)}"
        )
    behind = marked is not None and burnt is not None and (written is None or written != now)
    return GalleryStatus(
        header=header,
        size=layout.end,
        filled=(now.sides[0].filled, now.sides[1].filled),
        void=(len(slots_in(now.sides[0].void)), len(slots_in(now.sides[1].void))),
        done=now.done,
        burnt=burnt,
        pinned=None if now.text is None else now.text.decode(errors="replace").partition(" ")[2],
        flight=now.flight,
        has_ledger=has_ledger,
        in_use=in_use,
        destroyed=destroyed,
        rolled_back=behind and not destroyed,
    )


def _read_ledger(path: Path, header: GalleryHeader) -> tuple[Mark | None, int | None]:
    """The ledger's record, and how many pairs were burnt; neither if a commit was cut off."""
    # A log is beside it while it is open, or was cut off; without one, nothing beside it is to be made.
    has_log = any(path.with_name(f"{path.name}-{log}").exists() for log in ("wal", "journal"))
    where = f"{path.absolute().as_uri()}?mode=ro{'' if has_log else '&immutable=1'}"
    try:
        with closing(sqlite3.connect(where, uri=True, isolation_level=None)) as base:
            base.execute("BEGIN")  # both at one moment
            [(line,)] = base.execute("SELECT mark FROM record").fetchall()
            burnt = "SELECT sum((row_end - row) * (col_end - col)) FROM strips WHERE results IS NULL"
            [(pairs,)] = base.execute(burnt).fetchall()
            base.execute("COMMIT")
        record = Mark.decode(line)
        if (record.tape, record.party) != (header.tape, header.party):
            raise ValueError("it is of another gallery or party")
    except sqlite3.OperationalError as error:
        if "readonly" in str(error):
            return None, None
        raise TapeError(f"{path}: cannot read the ledger ({error})") from error
    except (sqlite3.DatabaseError, ValueError) as error:
        raise TapeDamaged(f"{path}: the ledger is damaged, or not of this tape ({error})") from error
    return record, int(pairs or 0)
