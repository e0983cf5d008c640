"""A disk that the machine stops at, with every fate of the writes that were not synced yet."""

import fcntl
import os

FATES = ("kept", "lost", "torn", "reordered")
WRITE, RENAME = os.pwrite, os.replace


class Crash(BaseException):
    """The machine stops."""


class Disk:
    """Counts writes, syncs and renames below ``folder``, and stops the machine at one of them.

    What is not synced then is ``kept`` or ``lost``, or only the last of it is kept (``reordered``); a write
    that is under way may be ``torn``. ``killed`` stops the process only: what is not synced is still to come.
    """

    def __init__(self, monkeypatch, folder, stop_at, fate, pending=()):
        self.folder, self.steps, self.stop_at, self.fate = folder, 0, stop_at, fate
        self.pending = list(pending)  # (what to sync: device and inode of a file or folder, undo)
        monkeypatch.setattr(os, "pwrite", self.pwrite)
        monkeypatch.setattr(os, "replace", self.replace)
        monkeypatch.setattr(os, "fsync", self.fsync)
        monkeypatch.setattr(os, "fdatasync", self.fsync, raising=False)
        monkeypatch.delattr(fcntl, "F_FULLFSYNC", raising=False)

    def step(self, under_way=lambda: None):
        self.steps += 1
        if self.steps == self.stop_at:
            if self.fate == "torn":
                under_way()
            lost = {"lost": self.pending, "reordered": self.pending[:-1]}.get(self.fate, [])
            for _, undo in reversed(lost):
                undo()
            raise Crash

    def pwrite(self, descriptor, data, offset):
        self.step(lambda: WRITE(descriptor, data[: len(data) // 100], offset))
        file, size = identity(os.fstat(descriptor)), os.fstat(descriptor).st_size
        old = os.pread(descriptor, len(data), offset) if size else b""

        def undo():
            for path in self.folder.rglob("*"):
                if identity(path.stat()) == file:
                    with path.open("r+b") as found:
                        found.seek(offset)
                        found.write(old)
                        found.truncate(size)

        self.pending.append((file, undo))
        return WRITE(descriptor, data, offset)

    def replace(self, source, target):
        self.step()
        old = target.read_bytes() if target.exists() else None
        undo = target.unlink if old is None else (lambda: target.write_bytes(old))
        self.pending.append((identity(target.parent.stat()), undo))
        RENAME(source, target)

    def fsync(self, descriptor):
        self.step()
        synced = identity(os.fstat(descriptor))
        self.pending = [entry for entry in self.pending if entry[0] != synced]


def identity(status):
    return status.st_dev, status.st_ino
