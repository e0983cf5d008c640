"""A table of the report, and how its numbers are written."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

NOTHING = "–"  # noqa: RUF001
"""Stands where there is no figure."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        head: Names of the columns.
        rows: Cells.
        words: How many of the first columns are words, not numbers.
        groups: Above the head: a name, and how many columns it spans.
        strong: Rows that stand out.
        notes: Sentences below it.
        folded: Whether a page shows its title alone until it is opened.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    groups: Sequence[tuple[str, int]] = ()
    strong: frozenset[int] = frozenset()
    notes: Sequence[str] = ()
    folded: bool = False


def milliseconds(value: float | None) -> str:
    """Three decimals of small times, fewer of larger ones."""
    if value is None:
        return NOTHING
    return f"{value:.3f}" if value < 10 else f"{value:.2f}" if value < 100 else f"{value:,.1f}"


def amount(value: float | None) -> str:
    """MB or KB as the paper has them, to three decimals; smaller ones to two digits."""
    if value is None:
        return NOTHING
    if 0 < value < 0.01:
        return f"{value:.{1 - math.floor(math.log10(value))}f}"
    return f"{value:,.3f}"


def whole(value: int | float | None) -> str:
    """A count."""
    return NOTHING if value is None else f"{value:,.0f}"


def times(factor: float | None) -> str:
    """A ratio to two decimals, fewer where it is large."""
    if factor is None:
        return NOTHING
    return f"{factor:,.0f}" if factor >= 100 else f"{factor:.1f}" if factor >= 10 else f"{factor:.2f}"


def ratio(theirs: float | None, ours: float | None) -> float | None:
    """How many times ours theirs is; None where either is missing, or ours is 0."""
    return theirs / ours if theirs is not None and ours else None


def mean_ratio(factors: Iterable[float | None]) -> float | None:
    """The geometric mean of those that there are; None of none."""
    found = [factor for factor in factors if factor is not None]
    return statistics.geometric_mean(found) if found else None
