"""Pages in a real browser: what one has become there, and how wide it is; and what it is made of."""

import json
import re
import shutil
import subprocess
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--hide-scrollbars", "--virtual-time-budget=5000",
)  # fmt: skip
WIDTHS = (360, 1280)

# A window is not made narrower than 500 pixels, a frame is; the page in it is the page as it was written.
MEASURE = """<!doctype html><iframe style="border: 0; width: WIDTHpx; height: 900px" srcdoc="PAGE"></iframe>
<script>addEventListener("load", () => {
  const page = document.querySelector("iframe").contentDocument, width = page.documentElement.clientWidth;
  const wide = [...page.querySelectorAll("body *")].filter(element => {
    const box = element.getBoundingClientRect();
    if (element.ownerSVGElement || element.closest(".scroll *")) return false;
    return box.right > width + 0.5 || box.left < -0.5;
  });
  const pictures = [...page.querySelectorAll("svg")].map(svg => {
    const inside = svg.getBBox(), box = svg.getBoundingClientRect();
    return [Math.min(inside.width, inside.height, box.height), box.width];
  });
  const broken = [...page.images].filter(image => !image.naturalWidth).length;
  const scroll = page.documentElement.scrollWidth;
  const told = {width, scroll, wide: wide.map(element => element.tagName), pictures, broken};
  document.body.textContent = JSON.stringify(told);
});</script>"""


class Elements(HTMLParser):
    """Collects what a page is made of; a tag that is closed by another is an error."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links += [
            value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "srcset")
        ]
        if tag not in ("meta", "link", "circle", "path", "polyline"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def browse(page: Path, width: int, tmp_path: Path, *more: str) -> "subprocess.CompletedProcess[str]":
    """Open a page in a fresh browser and return what it has become."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    size, profile = f"--window-size={width},900", f"--user-data-dir={tmp_path / 'profile'}"
    command = [CHROMIUM, *FLAGS, size, profile, *more, page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    assert run.returncode == 0, run.stderr
    return run


def measure(text: str, width: int, tmp_path: Path) -> dict[str, Any]:
    """What a page of so many pixels holds: its width, what sticks out, and its pictures."""
    page = tmp_path / "frame.html"
    inside = escape(text, quote=True)
    page.write_text(MEASURE.replace("WIDTH", str(width)).replace("PAGE", inside), encoding="utf-8")
    told = re.search(r"<body>(\{.*?\})</body>", browse(page, 1400, tmp_path, "--dump-dom").stdout, re.DOTALL)
    assert told is not None
    return dict(json.loads(told.group(1)))
