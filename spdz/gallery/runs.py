"""Sets of slots as sorted runs ``(start, stop)``: slots are filled in order, so a few runs say it all."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import TypeAlias

Runs: TypeAlias = tuple[tuple[int, int], ...]
"""Disjoint, ascending, not touching, none empty."""


def joined(*sets: Iterable[tuple[int, int]]) -> Runs:
    """The union of sets of slots; empty runs may be given."""
    result: list[tuple[int, int]] = []
    for start, stop in sorted(chain(*sets)):
        if start == stop:
            continue
        if result and start <= result[-1][1]:
            result[-1] = result[-1][0], max(stop, result[-1][1])
        else:
            result.append((start, stop))
    return tuple(result)


def runs_of(slots: Iterable[int]) -> Runs:
    """The runs of slot numbers in any order."""
    return joined((slot, slot + 1) for slot in slots)


def slots_in(runs: Runs) -> list[int]:
    """The slot numbers, ascending."""
    return [slot for start, stop in runs for slot in range(start, stop)]


def are_runs(runs: Runs, end: int) -> bool:
    """Whether these are the runs of a set of slots below ``end``."""
    return joined(runs) == runs and all(0 <= start < stop <= end for start, stop in runs)
