"""Reading a plan's tables: what a field may be, and a sentence about what came instead."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from protocols.mission.errors import PlanError
from protocols.mission.source import FieldPath, Source

_LONGEST = 60


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a plan, wherever it comes from.

    Attributes:
        source: The file.
        path: Where the table stands in it.
        values: What it holds.
    """

    source: Source
    path: FieldPath
    values: dict[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, message: str, *keys: str | int) -> PlanError:
        """An error at this table, or at a field of it."""
        return self.source.error((*self.path, *keys), message)

    def only(self, *allowed: str) -> None:
        """Refuse keys that mean nothing.

        Raises:
            PlanError: naming the nearest key that does.
        """
        for key in self.values:
            if key not in allowed:
                raise self.error(f"there is no such field; {nearest(key, allowed)}", key)

    def text(self, key: str, default: str | None = None) -> str:
        """A string."""
        value = self._get(key, default)
        if not isinstance(value, str):
            raise self.error(f"expected a text in quotes, not {shown(value)}", key)
        return value

    def choice(self, key: str, allowed: Collection[str], default: str | None = None) -> str:
        """One of a few strings."""
        value = self._get(key, default)
        if not isinstance(value, str) or value not in allowed:
            raise self.error(f"expected one of {listed(allowed)}, not {shown(value)}", key)
        return value

    def whole(self, key: str, least: int, most: int, default: int | None = None) -> int:
        """An integer in a range."""
        return self.check_whole(self._get(key, default), least, most, key)

    def check_whole(self, value: Any, least: int, most: int, *keys: str | int) -> int:
        """A value that should be an integer in a range."""
        if type(value) is not int or not least <= value <= most:
            raise self.error(f"expected a whole number from {least:,} to {most:,}, not {shown(value)}", *keys)
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite real number."""
        value = self._get(key, default)
        if type(value) not in (int, float) or not math.isfinite(value) or abs(value) > 1e12:
            raise self.error(f"expected a finite number, not {shown(value)}", key)
        return float(value)

    def table(self, key: str) -> Table:
        """A table within; an empty one if it is not there."""
        value = self.values.get(key, {})
        if not isinstance(value, dict):
            raise self.error(f"expected a table, [{key}] or {{ ... }}, not {shown(value)}", key)
        return Table(self.source, (*self.path, key), value)

    def tables(self, key: str) -> Iterator[Table]:
        """The tables of a list, ``[[key]]``."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
            raise self.error(f"expected tables, each under [[{key}]], not {shown(value)}", key)
        for number, one in enumerate(value):
            yield Table(self.source, (*self.path, key, number), one)

    def named_tables(self, key: str) -> Iterator[tuple[str, Table]]:
        """The tables within a table, with their names."""
        outer = self.table(key)
        for name in outer.values:
            yield name, outer.table(name)

    def texts(self, key: str) -> list[str]:
        """A list of strings."""
        value = self._get(key, None)
        if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
            raise self.error(f"expected a list of texts, not {shown(value)}", key)
        return list(value)

    def _get(self, key: str, default: Any) -> Any:
        value = self.values.get(key, default)
        if value is None:
            raise self.error(f"{key} is missing")
        return value


def nearest(key: str, allowed: Sequence[str]) -> str:
    """Which names there are, the nearest first."""
    close = get_close_matches(key.lower(), allowed, 1)
    known = ", ".join(sorted(allowed))
    return f"did you mean {close[0]!r}? There are {known}" if close else f"there are {known}"


def listed(allowed: Collection[str]) -> str:
    """Strings for people."""
    return ", ".join(repr(one) for one in allowed)


def shown(value: Any) -> str:
    """What came, cut short."""
    if value is None:
        return "nothing"
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
