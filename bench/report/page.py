"""The report as one HTML page: no script, no network, every plot in the file itself."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from html import escape
from importlib import resources

from bench.offline_page import document
from bench.report.plots import Plot
from bench.report.sections import Section
from bench.report.table import Table


def page(title: str, parts: Sequence[Section]) -> str:
    """The whole page."""
    style = (resources.files("bench.report") / "style.css").read_text(encoding="utf-8")
    body = "\n".join(line for part in parts for line in _section(part))
    return document(title, style, f"<h1>{escape(title)}</h1>\n{body}")


def _section(part: Section) -> Iterator[str]:
    yield f"<h2>{escape(part.title)}</h2>"
    for words in part.words:
        yield f"<p>{_words(words)}</p>"
    if part.plots:
        yield f'<div class="plots">{"".join(map(_plot, part.plots))}</div>'
    for table in part.tables:
        yield _table(table)


def _words(text: str) -> str:
    """Escaped, with what stands between backticks as code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(text))


def _plot(plot: Plot) -> str:
    named = plot.svg.replace("<svg ", f'<svg aria-label="{escape(plot.words)}" ', 1)
    return f"<figure>{named}<figcaption>{escape(plot.words)}</figcaption></figure>"


def _table(table: Table) -> str:
    """The table in a box of its own that scrolls; notes below it."""
    kinds = [_kind(name) if at < table.words else "" for at, name in enumerate(table.head)]
    groups = ""
    if table.groups:
        cells = "".join(f'<th colspan="{span}">{escape(name)}</th>' for name, span in table.groups)
        groups = f'<tr class="groups">{cells}</tr>'
    head = "".join(
        f"<th{_class(kind)}>{escape(name)}</th>" for name, kind in zip(table.head, kinds, strict=True)
    )
    rows = "\n".join(
        f"<tr{_class('strong' if at in table.strong else '')}>"
        + "".join(f"<td{_class(kind)}>{escape(cell)}</td>" for cell, kind in zip(cells, kinds, strict=True))
        + "</tr>"
        for at, cells in enumerate(table.rows)
    )
    label = escape(table.title)
    box = (
        f'<div class="scroll" role="region" aria-label="{label}" tabindex="0"><table>'
        f"<thead>{groups}<tr>{head}</tr></thead><tbody>\n{rows}</tbody></table></div>"
    )
    notes = "".join(f'<p class="note">{_words(note)}</p>' for note in table.notes)
    if table.folded:
        return f"<details><summary>{label}</summary>{box}{notes}</details>"
    return f"<h3>{label}</h3>{box}{notes}"


def _kind(name: str) -> str:
    """Classes of a column of words; what a row is of stays in sight while its numbers scroll."""
    return {"ID": "w id", "figures": "w whose"}.get(name, "w")


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""
