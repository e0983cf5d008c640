"""A folder that is watched for keyframes: each file is read once, when it is whole.

``17.npz`` has an array a descriptor, perhaps ``stamp`` and ``payload`` (uint8); ``17.npy`` is the only
descriptor of a plan that has one; ``*.json`` and ``*.jsonl`` have the lines of :mod:`protocols.agent.lines`.
The name is the keyframe's number, perhaps after letters (``kf_17``). Files may be renamed into the folder or
written in place: one that cannot be read is tried again when it has changed, and named when it has not.
"""

from __future__ import annotations

import os
import re
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from protocols.agent.lines import MAX_LINE, Given, read_line

PATIENCE = 5.0
"""Seconds without a change after which a file that cannot be read is refused by name."""
_ENDINGS = (".npz", ".npy", ".json", ".jsonl")
_NAME = re.compile(r"[A-Za-z_-]*?(\d+)")
_MAX_FILE = 256 << 20


class NotWhole(ValueError):
    """A file that cannot be read, perhaps because it is being written."""


@dataclass(slots=True)
class _Seen:
    size: int
    changed: int
    since: float
    done: bool = False


class FolderWatch:
    """What is new in a folder.

    Args:
        folder: The folder; it need not be there yet.
        descriptor: What the array of an ``.npy`` file is, if there is but one descriptor.
        add: Takes a keyframe; its ValueError refuses that file.
        refuse: Called with a sentence that names a file that is not taken, or not yet.
    """

    def __init__(
        self,
        folder: Path,
        descriptor: str | None,
        add: Callable[[Given], None],
        refuse: Callable[[str], None],
    ) -> None:
        self._folder, self._descriptor, self._add, self._refuse = folder, descriptor, add, refuse
        self._seen: dict[str, _Seen] = {}

    def look(self) -> int:
        """Read what is new and whole; returns how many files were read."""
        return sum(self._look_at(path) for path in self._candidates())

    def _candidates(self) -> Iterator[Path]:
        try:
            entries = sorted(os.scandir(self._folder), key=lambda entry: _order(entry.name))
        except FileNotFoundError:
            return
        for entry in entries:
            if entry.name.endswith(_ENDINGS) and not entry.name.startswith("."):
                yield Path(entry.path)

    def _look_at(self, path: Path) -> bool:
        try:
            state = path.stat()
        except FileNotFoundError:
            return False
        now, known = time.monotonic(), self._seen.get(path.name)
        if known is None or (known.size, known.changed) != (state.st_size, state.st_mtime_ns):
            known = self._seen[path.name] = _Seen(state.st_size, state.st_mtime_ns, now)
        if known.done:
            return False
        try:
            for given in read_file(path, self._descriptor):
                self._add(given)
        except NotWhole as error:
            if now - known.since < PATIENCE:
                return False
            self._refuse(f"{path.name} cannot be read and is tried again when it changes: {error}")
        except ValueError as error:
            self._refuse(f"{path.name} is left out: {error}")
        known.done = True
        return True


def read_file(path: Path, descriptor: str | None) -> list[Given]:
    """Read a file's keyframes.

    Raises:
        NotWhole: if it cannot be read, perhaps yet.
        ValueError: if what it says can never be a keyframe.
    """
    if path.stat().st_size > _MAX_FILE:
        raise ValueError(f"it is larger than {_MAX_FILE >> 20} MiB")
    if path.suffix in (".json", ".jsonl"):
        text = path.read_bytes()
        if not text.endswith((b"\n", b"}")) or len(text) > MAX_LINE:
            raise NotWhole("its last line does not end")
        return [read_line(line) for line in text.splitlines() if line.strip()]
    number = _NAME.fullmatch(path.stem)
    if number is None:
        raise ValueError(f"its name is not a number: call it NUMBER{path.suffix} or NAME_NUMBER{path.suffix}")
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            whole = isinstance(loaded, np.ndarray)
            arrays = {None: loaded} if whole else {name: loaded[name] for name in loaded.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        reason = str(error).partition(" If you trust")[0].partition("\n")[0].rstrip(".")
        raise NotWhole(f"it is no whole {path.suffix} file of numbers ({reason:.80})") from None
    if None in arrays:
        if descriptor is None:
            raise ValueError("the plan has several descriptors: write NUMBER.npz with an array for each")
        arrays = {descriptor: arrays[None]}
    payload, stamp = arrays.pop("payload", None), arrays.pop("stamp", None)
    if any(array.dtype.kind not in "if" for array in arrays.values()):
        raise ValueError("its descriptors are not numbers")
    if stamp is not None and (stamp.size != 1 or stamp.dtype.kind not in "iuf"):
        raise ValueError("its stamp is not one number")
    return [
        Given(
            int(number[1]),
            {str(name): array.astype(np.float64) for name, array in arrays.items()},
            b"" if payload is None else payload.astype(np.uint8).tobytes(),
            None if stamp is None else float(stamp.reshape(())),
        )
    ]


def _stamp(array: Any) -> float:
    if array.size != 1 or array.dtype.kind not in "iuf":
        raise ValueError("its stamp is not a number of seconds")
    return float(array.reshape(-1)[0])


def _order(name: str) -> tuple[int, str]:
    """Files in the order of their numbers."""
    number = _NAME.fullmatch(Path(name).stem)
    return (int(number[1]) if number else -1, name)
