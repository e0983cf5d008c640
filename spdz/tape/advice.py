"""What to do about a tape that cannot be opened or is damaged.

A tape that was used must never be replaced by an older copy of itself: its jobs would be used twice. Only
one that nobody used may be copied again.
"""

from __future__ import annotations

import errno
from pathlib import Path

from spdz.foundations.errors import TapeError

_READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)


def replacement(used: bool | None) -> str:
    """Where another tape comes from; ``used`` is None where the damage hides it."""
    if used is None:
        return (
            "If this tape was never used, copy it again from where it was dealt; otherwise deal anew for "
            "both robots, and never copy an old one back"
        )
    if used:
        return "This tape has been used: deal anew for both robots, never copy an old one back"
    return (
        "Nothing of this tape was used: copy it again from where it was dealt, or deal anew for both robots"
    )


def cannot_open(path: Path, error: OSError, *, writing: bool) -> TapeError:
    """What to raise for a tape that the system does not open."""
    if path.is_dir():
        tapes = sorted(path.glob("*.tape")) or sorted(path.glob("*/*.tape"))
        example = tapes[0] if tapes else path / "PEER.tape"
        return TapeError(f"{path}: is a folder: give the tape in it, such as {example}")
    if error.errno == errno.ENOENT:
        return TapeError(f"{path}: no such file: give a tape that was dealt, such as mission/alice/bob.tape")
    if writing and error.errno in _READ_ONLY:
        return TapeError(
            f"{path}: cannot open the tape for reading and writing ({error.strerror}). "
            "It must be writable, because every use is recorded in it"
        )
    return TapeError(f"{path}: cannot open the tape ({error.strerror})")
