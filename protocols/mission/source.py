"""A TOML file, and on which line of it something stands.

The standard library's reader keeps no positions. They are found when an error needs one: the file is cut into
statements, each as few lines as parse by themselves, and what a statement parses to says what it is about.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from protocols.mission.errors import PlanError

FieldPath: TypeAlias = tuple[str | int, ...]
"""Keys and places in lists, from the outermost."""

_TWICE = re.compile(r"Cannot declare \((.*)\) twice")
_MOST_BYTES = 1 << 20
_MOST_LINES = 400
"""Lines of one statement; behind a longer one no positions are told."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where a plan comes from, for messages.

    Attributes:
        name: The file, for people.
        text: Its text; None of one that is not valid TOML, or that has no lines to tell.
    """

    name: str
    text: str | None = None

    def error(self, path: FieldPath, message: str) -> PlanError:
        """An error at a field, or at what it should be in."""
        return PlanError(message, file=self.name, line=self.line_of(path), field=dotted(path))

    def line_of(self, path: FieldPath) -> int | None:
        """The line of a field, or of the nearest thing around it that has a line of its own."""
        if self.text is None:
            return None
        lines = _positions(self.text)
        return next((lines[path[:end]] for end in range(len(path), 0, -1) if path[:end] in lines), None)


def dotted(path: FieldPath) -> str:
    """``agents[1].name``: places in lists count from 0, as in Python."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def read_toml(path: Path) -> tuple[dict[str, Any], Source]:
    """Read a TOML file.

    Raises:
        PlanError: It cannot be read, is too large, or is not valid TOML: with the line.
    """
    source = Source(str(path))
    try:
        with path.open("rb") as file:
            octets = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise source.error((), f"cannot be read: {error.strerror or error}") from error
    if len(octets) > _MOST_BYTES:
        raise source.error((), f"a plan has at most {_MOST_BYTES >> 20} MB; this is another file")
    try:
        text = octets.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = octets.count(b"\n", 0, error.start) + 1
        raise PlanError("a plan is text in UTF-8; this is not", file=str(path), line=line) from error
    try:
        return tomllib.loads(text), Source(str(path), text)
    except tomllib.TOMLDecodeError as error:
        where, message = _line_in(str(error), text)
        raise PlanError(f"not valid TOML: {message}", file=str(path), line=where) from error
    except RecursionError as error:
        raise source.error((), "no plan: brackets within brackets without end") from error


def _line_in(message: str, text: str) -> tuple[int | None, str]:
    """The reader's own message, or a plainer one, and the line that it names at its end."""
    what, found, place = message.rpartition(" (at ")
    if not found:
        return None, message
    if (twice := _TWICE.fullmatch(what)) is not None:
        table = ".".join(re.findall(r"'([^']*)'", twice[1]))
        what = f"the table [{table}] is there twice"
        what += "; write [[agents]], once for each robot" if table == "agents" else ""
    if place.startswith("line "):
        number = place.removeprefix("line ").partition(",")[0]
        return (int(number), what) if number.isdigit() else (None, message)
    return text.count("\n") + 1, f"{what} at the end of the file"


def _positions(text: str) -> dict[FieldPath, int]:
    """The first line of every table and every field of a valid file."""
    found: dict[FieldPath, int] = {}
    counts: dict[FieldPath, int] = {}
    table: FieldPath = ()
    lines = text.split("\n")
    at = 0
    while at < len(lines):
        for end in range(at + 1, min(at + _MOST_LINES, len(lines)) + 1):
            statement = "\n".join(lines[at:end])
            try:
                parsed = tomllib.loads(statement)
            except tomllib.TOMLDecodeError:
                continue
            break
        else:
            return found
        if statement.lstrip().startswith("["):
            table = _numbered(parsed, counts, is_list=statement.lstrip().startswith("[["))
            for depth in range(1, len(table) + 1):
                found.setdefault(table[:depth], at + 1)
        else:
            for path in _paths(parsed):
                found.setdefault((*table, *path), at + 1)
        at = end
    return found


def _numbered(parsed: dict[str, Any], counts: dict[FieldPath, int], *, is_list: bool) -> FieldPath:
    """The path of a header's table, with the place of each list's last table."""
    path: FieldPath = ()
    value: Any = parsed
    while isinstance(value, dict) and value:
        (key, value), *_ = value.items()
        path = (*path, key)
        last = isinstance(value, list) or not value
        if is_list and last:
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
        if isinstance(value, list):
            value = value[0]
    return path


def _paths(value: Any) -> list[FieldPath]:
    """Every key of a statement, the outer ones as well."""
    if not isinstance(value, dict):
        return []
    return [(key, *rest) for key, inner in value.items() for rest in ((), *_paths(inner))]
