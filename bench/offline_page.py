"""The frame of an HTML page that is whole in one file: no script, and nothing loaded from anywhere."""

from __future__ import annotations

from html import escape

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a browser may load for the page: what is in it, and nothing else."""


def document(title: str, style: str, body: str) -> str:
    """A document that fits phones.

    Args:
        title: Of the window, as text.
        style: CSS.
        body: HTML, what is inside ``main``.
    """
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""
