"""What is known of a pair that was dealt: which dealing it is of, and how large its tapes are."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from protocols.mission.mission import canonical
from spdz.foundations.types import Json
from spdz.gallery.format import GalleryHeader, read_gallery_header
from spdz.tape.durable import replace_file

RECORD = "record.json"
HALVES = ("0.tape", "1.tape")
_ID = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class Record:
    """One dealing of a gallery.

    Attributes:
        tape: Hex id that is drawn for each dealing, and is in both tapes' headers.
        sizes: Bytes of party 0's and of party 1's tape.
    """

    tape: str
    sizes: tuple[int, int]

    @classmethod
    def of(cls, folder: Path) -> Record:
        """That of the two tapes that one dealing wrote into a folder.

        Raises:
            TapeError: if they were not written as they should be.
            OSError: if they cannot be read.
        """
        first, second = (folder / half for half in HALVES)
        return cls(read_header(first).tape, (first.stat().st_size, second.stat().st_size))

    @classmethod
    def read(cls, folder: Path) -> Record | None:
        """That which was written into a folder, or None.

        Raises:
            ValueError: if it is damaged.
        """
        file = folder / RECORD
        if (values := read_json(file)) is None:
            return None
        tape, sizes = values.get("tape"), values.get("bytes")
        if not isinstance(tape, str) or not _ID.fullmatch(tape):
            raise damaged(file)
        if not isinstance(sizes, list) or [type(size) for size in sizes] != [int, int]:
            raise damaged(file)
        return cls(tape, (sizes[0], sizes[1]))

    def write(self, folder: Path) -> None:
        """Write it into a folder, durably."""
        replace_file(folder / RECORD, canonical({"tape": self.tape, "bytes": list(self.sizes)}))


def read_header(path: Path) -> GalleryHeader:
    """A tape's header; its size is held against it.

    Raises:
        TapeError: if it is damaged.
        OSError: if it cannot be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return read_gallery_header(descriptor, path)[0]
    finally:
        os.close(descriptor)


def read_json(file: Path) -> dict[str, Json] | None:
    """A JSON object from a file of the dealer's own, or None if there is no such file.

    Raises:
        ValueError: if it is damaged.
    """
    try:
        values = json.loads(file.read_bytes())
    except FileNotFoundError:
        return None
    except ValueError:
        values = None
    if not isinstance(values, dict):
        raise damaged(file)
    return values


def damaged(file: Path) -> ValueError:
    """The error for a file that the dealer did not write so."""
    return ValueError(f"{file} is damaged: begin again with another --out")
