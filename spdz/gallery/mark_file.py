"""The file of a gallery's mark: two alternating slots, of which a step overwrites one in place.

A step writes its mark over the older of the two and syncs that. Crash cases, for a crash anywhere (a slot may
hold old, new or torn bytes until it is synced): the slot that is not written holds the step before, and that
is what counts where the other is torn. That step was durable before the slot was touched, since opening syncs
what it has read: what a killed process wrote may be in memory only.

A slot is torn only by a crash within a step, which the ledger has already. So a mark with a torn slot counts
for a ledger that is ahead of it, and for no other: there the slot was damaged later, and an older mark must
not come back. Hence both slots are written when the file is made, and it is made anew, all or nothing, when
a mark outgrows its slot: then the file and its folder are synced.

File: two slots of equal size, a multiple of 4,096 bytes, each a mark's line (:mod:`spdz.gallery.mark`) and
line feeds to fill it.
"""

from __future__ import annotations

import os
from pathlib import Path

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery.mark import Mark
from spdz.tape.durable import make_private_folder, replace_file, sync, sync_data, sync_folder, write_at
from spdz.tape.envelope import SECTOR

_LONGEST = 1 << 26  # bytes read of a mark file


class MarkFile:
    """The mark of one gallery and party. The gallery tape's lock keeps copies apart, not this.

    Args:
        folder: The state folder; created with mode 0700 if missing.
        tape: The gallery tape's hex id.
        party: Whose ledger it is.

    Attributes:
        path: The file.
        torn: Whether one of the two slots was not whole when they were read.
    """

    def __init__(self, folder: Path, tape: str, party: int) -> None:
        self.path = folder / f"{tape}-{party}.gallery"
        self.torn = False
        self._of = (tape, party)
        self._size = 0  # bytes of a slot; 0: there is no file
        self._current = 0  # the slot of the mark

    def read(self) -> Mark | None:
        """The mark, or None for a gallery that was never used here. What is read is on the disk.

        Raises:
            TapeDamaged: The file holds no whole mark of this gallery.
            TapeError: It cannot be read.
        """
        try:
            with self.path.open("rb") as file:
                content = file.read(_LONGEST)
                sync(file.fileno())
            sync_folder(self.path.parent)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._unusable(error) from error
        size = len(content) // 2
        marks = [self._decoded(slot) for slot in (content[:size], content[size:])]
        whole = [
            (mark.destroyed, mark.sequence, which) for which, mark in enumerate(marks) if mark is not None
        ]
        if not whole or size % SECTOR:
            raise self.damaged()
        self._size, self.torn = size, len(whole) < 2
        self._current = max(whole)[2]
        return marks[self._current]

    def write(self, mark: Mark) -> None:
        """Replace the mark; on return it is on the disk.

        Raises:
            TapeError: It cannot be written.
        """
        line = mark.encode()
        try:
            if len(line) > self._size or not self._overwrite(line):
                self._make(line)
        except OSError as error:
            raise self._unusable(error) from error

    def damaged(self) -> TapeDamaged:
        """The error for a file that does not tell which slots were used."""
        return TapeDamaged(
            f"{self.path}: the gallery's mark is damaged, so it is unknown which slots were used. "
            "Deal new tapes for both robots"
        )

    def _decoded(self, slot: bytes) -> Mark | None:
        try:
            mark = Mark.decode(slot.rstrip(b"\n") + b"\n")
        except ValueError:
            return None
        return mark if (mark.tape, mark.party) == self._of else None

    def _overwrite(self, line: bytes) -> bool:
        """Step in place; False if the file is gone."""
        try:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            return False
        target = 1 - self._current
        try:
            write_at(descriptor, target * self._size, line.ljust(self._size, b"\n"))
            sync_data(descriptor)
        finally:
            os.close(descriptor)
        self._current = target
        return True

    def _make(self, line: bytes) -> None:
        """Make the file with room for a mark that is twice as long."""
        size = -(-2 * len(line) // SECTOR) * SECTOR
        make_private_folder(self.path.parent)
        replace_file(self.path, line.ljust(size, b"\n") * 2)
        self._size, self._current = size, 0

    def _unusable(self, error: OSError) -> TapeError:
        return TapeError(
            f"cannot keep the gallery's mark {self.path} ({error.strerror}), which is what notices a ledger "
            "copied back from a backup. Nothing was sent. Pass a state_dir that can be written, or set "
            "XDG_STATE_HOME to one"
        )
