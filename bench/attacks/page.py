"""The attacks as one HTML page that needs no other file and no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from bench.attacks import panels
from bench.attacks.report import Table, tables
from bench.attacks.run import Findings, Panel

_CAPTIONS = {
    "paths": "Where Alice was, and where Bob puts her. With the exchange alone he joins the places that he "
    "knows by straight lines, also through walls: of what lies between he was told nothing.",
    "scans": "Occupied cells around six keyframes that match none of Bob's. From left to right: as Alice saw "
    "them; as Bob rebuilds them from a broadcast descriptor; all that he has with the exchange, which is no "
    "descriptor, so a constant.",
    "probes": "The cosine of the best guess with the hidden descriptor, after so many bits.",
}
_PATHS = (
    (panels.TRUE, "Alice's keyframes"),
    (panels.GUESS, "where Bob puts them, joined to where they are"),
    (panels.BOB, "Bob's own path"),
    (panels.WALL, "walls"),
)
_STANDS_ABOVE = {"paths": "Paths", "scans": "Scans", "probes": "Probes"}
"""Which table a picture stands above: the one whose title begins so."""


def write_page(folder: Path, found: Findings) -> Path:
    """Write ``attacks.html``.

    Args:
        folder: Where to write; it must exist.
        found: What the attacks brought, with the panels that were drawn.
    """
    style = (resources.files("bench.attacks") / "style.css").read_text(encoding="utf-8")
    body = [
        "<h1>What a compromised robot gains</h1>",
        "<p>Bob's software was changed, Alice's was not. Both drove MIT's corridors; their descriptors are "
        "Scan Context of laser submaps. This page shows what Bob makes of descriptors that Alice broadcasts, "
        f"of private comparisons, and of vectors of his own choice. Seed {found.seed}.</p>",
    ]
    for table in tables(found):
        body.append(f"<h2>{escape(table.title)}</h2>")
        for name, parts in found.panels.items():
            if table.title.startswith(_STANDS_ABOVE[name]):
                body.append(_picture(name, parts, _legend(name, found)))
        body.append(_table(table))
    page = folder / "attacks.html"
    page.write_text(
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>What a compromised robot gains</title><style>{style}</style></head>"
        f"<body>{''.join(body)}</body></html>\n",
        encoding="utf-8",
    )
    return page


def _legend(name: str, found: Findings) -> str:
    entries: Sequence[tuple[str, str, str]] = []
    if name == "paths":
        entries = [(colour, "solid", words) for colour, words in _PATHS]
    elif name == "probes":
        *names, rule = panels.curve_names(found)
        priors = ("solid" if one.row.prior != "nothing" else "dashed" for one in found.probes)
        entries = [*zip(panels.CURVES, priors, names, strict=True), (panels.INK, "dotted", rule)]
    items = "".join(
        f'<li><i style="border-top: 3px {style} {colour}"></i>{escape(words)}</li>'
        for colour, style, words in entries
    )
    return f'<ul class="legend">{items}</ul>' if items else ""


def _picture(name: str, parts: Sequence[Panel], legend: str) -> str:
    images = "".join(
        f'<figure><img alt="{escape(panel.words)}" src="data:image/png;base64,'
        f'{base64.b64encode(panel.png).decode("ascii")}"><figcaption>{escape(panel.words)}</figcaption></figure>'
        for panel in parts
    )
    kind = "panels" if len(parts) > 1 else "panels one"
    return f'<p class="note">{escape(_CAPTIONS[name])}</p>{legend}<div class="{kind}">{images}</div>'


def _table(table: Table) -> str:
    """A table whose cells know their column: on a narrow screen they stand under each other."""
    head = "".join(f"<th>{escape(name)}</th>" for name in table.head)
    rows = "".join(
        f"<tr><th>{escape(first)}</th>"
        + "".join(
            f'<td data-column="{escape(name)}">{escape(cell)}</td>'
            for name, cell in zip(table.head[1:], rest, strict=True)
        )
        + "</tr>"
        for first, *rest in table.rows
    )
    key = "".join(f"<dt>{escape(name)}</dt><dd>{escape(meaning)}</dd>" for name, meaning in table.key)
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    return (
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        f"{f'<dl>{key}</dl>' if key else ''}{notes}"
    )
