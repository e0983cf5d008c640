"""A new tape's file: hidden and private until it is whole, then named without ever replacing another."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from spdz.tape.durable import create_private, make_private_folder, partial_name, sync, sync_folder

_BUFFER = 1 << 18


class NewFile:
    """A file under a temporary name beside the one that it will have.

    Args:
        path: The file to make; its folder is created with mode 0700 if missing. Mode 0600.

    Attributes:
        file: Open for writing, buffered.

    Raises:
        FileExistsError: There is a file of that name. A dealt tape is never overwritten.
        OSError: It cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._refuse_to_overwrite()
        make_private_folder(path.parent)
        self._partial = partial_name(path)
        self.file: BinaryIO = os.fdopen(create_private(self._partial), "wb", _BUFFER)

    def publish(self) -> None:
        """Make the file durable and give it its name.

        Raises:
            FileExistsError: Somebody else made a file of that name meanwhile.
            OSError: The file cannot be written.
        """
        try:
            self.file.flush()
            sync(self.file.fileno())
            self._link()
        finally:
            self.discard()
        sync_folder(self._path.parent)

    def discard(self) -> None:
        """Close the file and remove its temporary name; a published file stays. May be called twice."""
        try:
            self.file.close()
        finally:
            self._partial.unlink(missing_ok=True)

    def _link(self) -> None:
        """Give the file its real name: a hard link, because that never replaces a file as a rename does."""
        try:
            os.link(self._partial, self._path)
        except FileExistsError:
            self._refuse_to_overwrite()
            raise
        except OSError:  # no hard links (FAT, some network file systems)
            self._refuse_to_overwrite()
            self._partial.rename(self._path)

    def _refuse_to_overwrite(self) -> None:
        if os.path.lexists(self._path):
            raise FileExistsError(
                f"{self._path} exists: a dealt tape is never overwritten. Choose another folder"
            )
