"""What has been compared is a rectangle of slots, and it grows by strips beside it.

The rectangle ``(R, C)`` is ``[0, R) x [0, C)``: rows are slots of party 0, columns slots of party 1. It is
``(0, 0)`` or has an area. Any order in which two robots fill slots keeps it a rectangle, so that two numbers
say which pairs were used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

Rectangle: TypeAlias = tuple[int, int]
"""(R, C): rows and columns done."""


@dataclass(frozen=True, slots=True)
class Strip:
    """Pairs that one step compares: every row with every column.

    Attributes:
        rows: Slots of party 0, consecutive.
        columns: Slots of party 1, consecutive.

    Raises:
        ValueError: A range is empty, negative or not of consecutive slots.
    """

    rows: range
    columns: range

    def __post_init__(self) -> None:
        for slots in (self.rows, self.columns):
            if slots.step != 1 or not 0 <= slots.start < slots.stop:
                raise ValueError(f"a strip needs consecutive slots, not {self.rows} x {self.columns}")

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return len(self.rows) * len(self.columns)

    def __str__(self) -> str:
        rows, columns = self.rows, self.columns
        return f"rows {rows.start} to {rows.stop - 1} x columns {columns.start} to {columns.stop - 1}"


def grown(done: Rectangle, strip: Strip) -> Rectangle:
    """The rectangle with a strip beside it.

    Raises:
        ValueError: Together they are no rectangle, or they overlap.
    """
    after = max(done[0], strip.rows.stop), max(done[1], strip.columns.stop)
    if between(done, after) != [strip]:
        raise ValueError(f"{strip} are not beside the {done[0]} x {done[1]} pairs that are done")
    return after


def between(done: Rectangle, later: Rectangle) -> list[Strip]:
    """The strips, at most two, that make a rectangle into a larger one.

    Raises:
        ValueError: ``later`` does not hold ``done``.
    """
    (rows, columns), (more_rows, more_columns) = done, later
    if rows > more_rows or columns > more_columns:
        raise ValueError(f"{more_rows} x {more_columns} pairs do not hold {rows} x {columns}")
    if 0 in done:
        return [] if 0 in later else [Strip(range(more_rows), range(more_columns))]
    strips = []
    if rows < more_rows:
        strips.append(Strip(range(rows, more_rows), range(columns)))
    if columns < more_columns:
        strips.append(Strip(range(more_rows), range(columns, more_columns)))
    return strips
