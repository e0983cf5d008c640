"""The attacks as one HTML page that needs no other file and no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from bench.attacks.report import Table, tables
from bench.attacks.run import Findings

_CAPTIONS = {
    "paths": "Alice's keyframes (blue) and where Bob puts them (red), on the building.",
    "scans": "Occupied cells around six keyframes that match none of Bob's: as Alice saw them, as Bob "
    "rebuilds them from broadcast descriptors, and all that he has without.",
    "probes": "What a prober's unit vectors tell, bit by bit.",
}
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 68rem; margin: 0 auto; padding: 1rem; }
img { width: 100%; height: auto; } figure { margin: 1rem 0; } figcaption, .note { color: #555; font-size:
.9rem; } .wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .85rem; } th, td {
text-align: right; padding: .2rem .6rem; border-bottom: 1px solid #ddd; vertical-align: top; } th:first-child,
td:first-child { text-align: left; min-width: 14rem; }
"""
_ENDING = {"paths": "Paths", "scans": "Scans", "probes": "Probes"}
"""Which table a picture stands above: the first whose title begins so."""


def write_page(folder: Path, found: Findings) -> Path:
    """Write ``attacks.html``.

    Args:
        folder: Where to write; it must exist.
        found: What the attacks brought, with the pictures that were drawn.
    """
    body = [
        "<h1>What a compromised robot gains</h1>",
        "<p>Bob's software was changed, Alice's was not. Both drove MIT's corridors; descriptors are Scan "
        "Context of laser submaps. What he makes of descriptors that she broadcasts, of private comparisons, "
        f"and of vectors of his own choice. Seed {found.seed}.</p>",
    ]
    for table in tables(found):
        for name, path in found.pictures.items():
            if table.title.startswith(_ENDING[name]):
                body.append(_picture(path, _CAPTIONS[name]))
        body.append(_table(table))
    page = folder / "attacks.html"
    page.write_text(
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>What a compromised robot gains</title><style>{_STYLE}</style></head>"
        f"<body>{''.join(body)}</body></html>\n",
        encoding="utf-8",
    )
    return page


def _picture(path: Path, caption: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    text = escape(caption)
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    head, rows = row(table.head, "th"), "".join(row(cells, "td") for cells in table.rows)
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    return f'<h2>{escape(table.title)}</h2><div class="wide"><table>{head}{rows}</table></div>{notes}'
