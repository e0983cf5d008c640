"""The report as Markdown: the same words and tables as the page, and the picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.report.sections import Section
from bench.report.table import NOTHING, Table

PICTURE = "report.png"


def markdown(title: str, parts: Sequence[Section], *, pictured: bool) -> str:
    """The whole report; ``pictured``, if there is a picture beside it."""
    return "\n".join(_lines(title, parts, pictured)).rstrip() + "\n"


def _lines(title: str, parts: Sequence[Section], pictured: bool) -> Iterator[str]:
    yield f"# {title}"
    yield ""
    if pictured:
        yield f"![Time of a comparison against N, ours beside MP-SPDZ's recorded]({PICTURE})"
        yield ""
    for part in parts:
        if not part.words and not part.tables:
            continue
        yield f"## {part.title}"
        yield ""
        for words in part.words:
            yield from (words, "")
        for table in part.tables:
            yield from _table(table)


def _table(table: Table) -> Iterator[str]:
    yield f"**{table.title}**"
    yield ""
    yield _row(_head(table))
    yield _row(["---"] * table.words + ["--:"] * (len(table.head) - table.words))
    for at, cells in enumerate(table.rows):
        yield _row(
            [f"**{cell}**" if at in table.strong and cell not in ("", NOTHING) else cell for cell in cells]
        )
    yield ""
    for note in table.notes:
        yield from (note, "")


def _head(table: Table) -> list[str]:
    """One row of names: the first column of a group has the group's name before its own."""
    names = list(table.head)
    at = 0
    for group, span in table.groups:
        if group:
            names[at] = f"{group}: {names[at]}"
        at += span
    return names


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
