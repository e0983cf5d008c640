"""File operations that survive a power failure, for the few bytes that must never go back in time.

A write counts only once the disk has it, a new name only once its folder has it. Linux and macOS.
"""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
import sys
import time
from pathlib import Path

from spdz.foundations.types import Buffer

PRIVATE_FILE = 0o600
PRIVATE_FOLDER = 0o700
_LOCK_ATTEMPTS, _LOCK_PAUSE = 10, 0.01


def sync(descriptor: int) -> None:
    """Return only when everything written to a file is on the disk.

    On macOS ``fsync`` leaves data in the drive's own cache; ``F_FULLFSYNC`` does not (fsync(2)).
    """
    full_sync = getattr(fcntl, "F_FULLFSYNC", None)
    if full_sync is not None:
        try:
            fcntl.fcntl(descriptor, full_sync)
            return
        except OSError:  # not supported by every file system
            pass
    os.fsync(descriptor)


def sync_data(descriptor: int) -> None:
    """As :func:`sync`, for bytes that were overwritten in place: the file's times may stay behind."""
    if sys.platform == "linux":
        os.fdatasync(descriptor)
    else:
        sync(descriptor)


def sync_folder(folder: Path) -> None:
    """Make names created, replaced or removed in ``folder`` durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems sync names by themselves
            raise
    finally:
        os.close(descriptor)


def make_private_folder(folder: Path) -> None:
    """Create ``folder`` and its missing parents with mode 0700, durably."""
    if folder.is_dir():
        return
    if folder.parent != folder:
        make_private_folder(folder.parent)
    folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)
    sync_folder(folder.parent)


def create_private(path: Path) -> int:
    """Create a new 0600 file for writing and return its descriptor.

    Raises:
        FileExistsError: The file is there already.
    """
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, PRIVATE_FILE)


def partial_name(path: Path) -> Path:
    """A fresh hidden name beside ``path`` for a file that is not complete yet."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")


def write_at(descriptor: int, offset: int, data: Buffer) -> None:
    """Write all of ``data`` at ``offset``, without syncing."""
    view = memoryview(data)
    while view:
        written = os.pwrite(descriptor, view, offset)
        view, offset = view[written:], offset + written


def replace_file(path: Path, data: bytes) -> None:
    """Give ``path`` new content so that a crash leaves all of the old or all of the new, durably."""
    partial = partial_name(path)
    descriptor = create_private(partial)
    try:
        try:
            write_at(descriptor, 0, data)
            sync(descriptor)
        finally:
            os.close(descriptor)
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def try_lock(descriptor: int) -> bool:
    """Take the file's exclusive lock; False if somebody else holds it.

    The lock goes with the last descriptor of this open file, so a dead process never leaves one behind. It is
    tried for a moment, because :func:`is_locked` in another process holds it for an instant.
    """
    for attempt in range(_LOCK_ATTEMPTS):
        if attempt:
            time.sleep(_LOCK_PAUSE)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            continue
        return True
    return False


def is_locked(descriptor: int) -> bool:
    """Whether somebody holds the file's exclusive lock; it may be open for reading only."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False


def unlock(descriptor: int) -> None:
    """Give a lock back for all who have inherited this open file."""
    fcntl.flock(descriptor, fcntl.LOCK_UN)
