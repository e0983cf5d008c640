"""What a tape is for and how much is left, read without opening it for use.

Nothing is written, nothing is locked for longer than an instant, and no secret leaves the file: a tape may be
looked at while a robot uses it. What is seen then may be out of date at once.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.tape.advice import cannot_open, replacement
from spdz.tape.durable import is_locked
from spdz.tape.envelope import SECTOR
from spdz.tape.format import TapeHeader, read_header
from spdz.tape.header import Header
from spdz.tape.high_water import default_state_dir, mark_path, read_mark
from spdz.tape.state import State, latest_slot

_READ_ATTEMPTS, _READ_PAUSE = 20, 0.01


@dataclass(frozen=True, slots=True)
class TapeStatus:
    """A tape at one moment; public facts only.

    Attributes:
        header: What the tape is for.
        size: Bytes of the file.
        used: Jobs used, as tape or mark says, whichever is further.
        in_use: Whether a process has the tape, or a copy of it, open.
        destroyed: Whether it was destroyed after a failed MAC check.
        rolled_back: Whether the file is behind its high-water mark: it was copied back from a backup, or a
            crash interrupted it. The jobs in between count as used. Unknown, hence False, while in use.
    """

    header: TapeHeader
    size: int
    used: int
    in_use: bool
    destroyed: bool
    rolled_back: bool

    @property
    def left(self) -> int:
        """Jobs that can still be run."""
        return 0 if self.destroyed else self.header.jobs - self.used


def tape_status(path: Path, state_dir: Path | None = None) -> TapeStatus:
    """Look at a tape.

    Args:
        path: The tape.
        state_dir: Where its high-water mark is kept; the user's state folder if not given.

    Raises:
        TapeMismatch: It is a tape of another kind.
        TapeDamaged: It is not a whole tape, or its mark is damaged.
        TapeError: It cannot be read.
    """
    try:
        # O_NONBLOCK: a named pipe must not make this wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise cannot_open(path, error, writing=False) from error
    try:
        return _status(descriptor, path, state_dir or default_state_dir())
    except OSError as error:
        raise TapeError(f"{path}: cannot read the tape ({error.strerror})") from error
    finally:
        os.close(descriptor)


def _status(descriptor: int, path: Path, folder: Path) -> TapeStatus:
    header, layout = read_header(descriptor, path)
    in_use = is_in_use(descriptor, folder, header)
    state = read_state(descriptor, layout.slots, layout.digest)
    mark = read_mark(folder, header.tape, header.party)
    destroyed = (mark is not None and mark.destroyed) or (state is not None and state.destroyed)
    used = max(mark.cursor if mark else 0, state.cursor if state else 0)
    if (state is None and not destroyed) or used > header.jobs:
        raise TapeDamaged(
            f"{path}: the tape's state (at byte {layout.slots}) or its high-water mark makes no sense. "
            f"{replacement(None if mark is None else mark.cursor > 0)}"
        )
    rolled_back = not in_use and state is not None and state.cursor < used
    return TapeStatus(header, layout.end, used, in_use, destroyed, rolled_back)


def is_in_use(descriptor: int, folder: Path, header: Header) -> bool:
    """Whether a process has this tape open, or a copy of it; ``folder`` is the state folder."""
    return is_locked(descriptor) or _mark_is_locked(mark_path(folder, header.tape, header.party))


def read_state(descriptor: int, offset: int, binding: bytes) -> State | None:
    """The latest whole state of those at ``offset``; ``binding`` is the header's digest.

    Between two reads a writer may move on, so that neither is whole: then once more.
    """
    for attempt in range(_READ_ATTEMPTS):
        if attempt:
            time.sleep(_READ_PAUSE)
        slots = [os.pread(descriptor, SECTOR, offset + place * SECTOR) for place in (0, 1)]
        latest = latest_slot(slots, binding)
        if latest is not None:
            return latest[1]
    return None


def _mark_is_locked(mark: Path) -> bool:
    try:
        descriptor = os.open(mark.with_suffix(".lock"), os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    try:
        return is_locked(descriptor)
    finally:
        os.close(descriptor)
