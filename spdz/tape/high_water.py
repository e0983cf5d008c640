"""The second high-water mark: how far a tape was used, kept outside the tape's folder.

A tape copied back from a backup has forgotten which jobs were used, and a job used twice reveals x - x'
to the peer. This small file remembers: one a tape and party, in the user's state folder. It is written
*before* the tape's own state, so it is never behind it on the machine where the tape was used. It cannot
help on another machine; there the peer's cursor does (``Tape.resume``).

A lock file beside the mark keeps two *copies* of one tape from being open at the same time: the lock on
the tape itself does not see a copy.

File: one line of ASCII, ``spdz-high-water 1 <tape> <party> <cursor> <live|destroyed> <blake2b-16>``.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from spdz.foundations.errors import TapeDamaged, TapeError, TapeInUse
from spdz.tape.durable import PRIVATE_FILE, make_private_folder, replace_file, try_lock, unlock

_LONGEST = 1024  # bytes read of a mark file: a whole one has at most 240


@dataclass(frozen=True, slots=True)
class Mark:
    """What is remembered of a tape.

    Attributes:
        cursor: The first job that was never reserved.
        destroyed: Whether the tape was destroyed.
    """

    cursor: int
    destroyed: bool = False


def default_state_dir() -> Path:
    """``$XDG_STATE_HOME/spdz``, else ``~/.local/state/spdz`` (XDG Base Directory Specification 0.8).

    Raises:
        TapeError: There is no home folder.
    """
    configured = Path(os.environ.get("XDG_STATE_HOME", ""))
    if configured.is_absolute():  # the specification has relative values ignored
        return configured / "spdz"
    try:
        return Path.home() / ".local" / "state" / "spdz"
    except RuntimeError as error:
        raise TapeError(
            "no home folder to remember used jobs in: pass state_dir or set XDG_STATE_HOME"
        ) from error


class HighWater:
    """The mark of one tape and party, locked while this object is open.

    Args:
        folder: The state folder; created with mode 0700 if missing.
        tape: The tape's hex id.
        party: Whose tape it is.

    Raises:
        TapeInUse: This tape, or a copy of it, is open already.
        TapeError: The folder cannot be written.
    """

    def __init__(self, folder: Path, tape: str, party: int) -> None:
        self._of = (folder, tape, party)
        self._path = mark_path(*self._of)
        try:
            make_private_folder(folder)
            lock = self._path.with_suffix(".lock")
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PRIVATE_FILE)
        except OSError as error:
            raise _unusable(self._path, error) from error
        try:
            if not try_lock(self._lock):
                raise TapeInUse(f"tape {tape} of party {party}, or a copy of it, is open elsewhere ({lock})")
        except BaseException:
            os.close(self._lock)
            raise

    def read(self) -> Mark | None:
        """The mark, or None for a tape that was never open here.

        Raises:
            TapeDamaged: The file is not a whole mark of this tape.
            TapeError: The file cannot be read.
        """
        return read_mark(*self._of)

    def write(self, mark: Mark) -> None:
        """Replace the mark; on return it is on the disk.

        Raises:
            TapeError: It cannot be written.
        """
        try:
            replace_file(self._path, _encode(mark, *self._of[1:]))
        except OSError as error:
            raise _unusable(self._path, error) from error

    def unlock(self) -> None:
        """Give the lock back for forks as well, which hold the same open file."""
        unlock(self._lock)

    def close(self) -> None:
        """Close the lock's file."""
        os.close(self._lock)


def mark_path(folder: Path, tape: str, party: int) -> Path:
    """The file of a tape and party; its lock has the suffix ``.lock``."""
    return folder / f"{tape}-{party}.mark"


def read_mark(folder: Path, tape: str, party: int) -> Mark | None:
    """Read a mark without its lock, for those who only look; otherwise as :meth:`HighWater.read`."""
    path = mark_path(folder, tape, party)
    try:
        with path.open("rb") as file:
            content = file.read(_LONGEST)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unusable(path, error) from error
    fields = content.split()
    if len(fields) == 7 and fields[4].isdigit() and len(fields[4]) <= 20:
        mark = Mark(int(fields[4]), fields[5] == b"destroyed")
        if content == _encode(mark, tape, party):
            return mark
    raise TapeDamaged(
        f"{path}: the high-water mark is damaged, so it is unknown which jobs were used. "
        "Deal a new pair of tapes"
    )


def _encode(mark: Mark, tape: str, party: int) -> bytes:
    line = f"spdz-high-water 1 {tape} {party} {mark.cursor} {'destroyed' if mark.destroyed else 'live'}"
    return f"{line} {hashlib.blake2b(line.encode(), digest_size=16).hexdigest()}\n".encode()


def _unusable(path: Path, error: OSError) -> TapeError:
    return TapeError(
        f"cannot keep the high-water mark {path} ({error.strerror}), which is what notices a tape "
        "copied back from a backup. Pass a state_dir that can be written, or set XDG_STATE_HOME to one"
    )
