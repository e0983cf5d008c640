"""How far a dealing is, from the files that it writes: on this machine and on a cluster alike."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from dealer.team.record import HALVES
from dealer.team.room import Room
from dealer.team.tasks import Size, Task


class Watch:
    """Counts pairs of descriptors.

    Args:
        room: The room.
        sizes: All tasks of the mission, and what they take.
        report: Called with pairs dealt and pairs in all.
    """

    def __init__(self, room: Room, sizes: Mapping[Task, Size], report: Callable[[int, int], None]) -> None:
        self._room, self._report = room, report
        self._sizes = {task.key: size for task, size in sizes.items()}
        self._total = sum(size.pairs for size in self._sizes.values())
        self._done = {task.key for task in sizes if room.record(task) is not None}
        self._most = 0

    def dealt(self, task: Task) -> None:
        """A task is published."""
        self._done.add(task.key)
        self.look()

    def look(self) -> None:
        """Report, never less than before."""
        at_work: dict[str, int] = {}
        with suppress(OSError):
            for folder in self._room.work.iterdir():
                key = folder.name.rpartition(".")[0]
                if key in self._sizes and key not in self._done:
                    pairs = self._sizes[key].pairs_in(_written(folder))
                    at_work[key] = max(at_work.get(key, 0), pairs)
        done = sum(self._sizes[key].pairs for key in self._done) + sum(at_work.values())
        self._most = max(self._most, done)
        self._report(self._most, self._total)


def _written(folder: Path) -> int:
    """Bytes of the first half, under whatever name it has."""
    with suppress(OSError), os.scandir(folder) as entries:
        return max((entry.stat().st_size for entry in entries if HALVES[0] in entry.name), default=0)
    return 0
