"""The attacks' pictures: whole ones as files, and each panel by itself for the page."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from bench.attacks import panels
from bench.attacks.run import Findings, Panel
from spdz.foundations.types import FloatArray

_SHOWN = 6
"""Scans side by side."""
_COLOURS = 48
"""Of a picture, shades included."""
_KINDS = ("what Alice saw", "rebuilt from the broadcast", "from this exchange:\nno descriptor, a constant")


def draw(folder: Path, found: Findings) -> None:
    """Write a PNG for each part that was run, and note its panels in the findings.

    Args:
        folder: Where to write; it must exist.
        found: What the attacks brought.
    """
    for name, ready, whole, parts in (
        ("paths", bool(found.paths), _paths, _path_panels),
        ("scans", found.scans is not None, _scans, _scan_panels),
        ("probes", bool(found.probes), _probes, _probe_panels),
    ):
        if ready:
            (folder / f"{name}.png").write_bytes(_png(whole(found)))
            found.panels[name] = list(parts(found))


def _png(figure: Figure) -> bytes:
    """A PNG of few colours: a page that holds it stays small."""
    FigureCanvasAgg(figure)
    drawn, small = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png")
    picture = Image.open(drawn).convert("RGB")
    picture.quantize(_COLOURS, dither=Image.Dither.NONE).save(small, "png", optimize=True)
    return small.getvalue()


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), facecolor="white", layout="constrained", dpi=100)


def _paths(found: Findings) -> Figure:
    building = panels.Building.of(found.world)
    figure = _figure(13, 6.5 * building.ratio * 2 + 1.2)
    grid: Any = figure.subplots(2, 2)
    shown = [pair for pair in found.paths if pair[0].source != "nothing"]
    for axes, (row, one) in zip(grid.ravel(), shown, strict=True):
        panels.path(axes, building, found.world, one)
        axes.set_title("\n".join(panels.path_words(row)), fontsize=10, color=panels.INK)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _path_panels(found: Findings) -> Iterator[Panel]:
    building = panels.Building.of(found.world)
    for row, one in found.paths:
        if row.source != "nothing":
            figure = _figure(6.5, 6.5 * building.ratio)
            panels.path(figure.subplots(), building, found.world, one)
            yield Panel(_png(figure), ". ".join(panels.path_words(row)))


def _scans(found: Findings) -> Figure:
    chosen = _chosen(found)
    figure = _figure(13, 7)
    grid: Any = figure.subplots(len(_KINDS), len(chosen))
    for column, (place, words, images) in enumerate(chosen):
        grid[0, column].set_title(f"keyframe {place}, {words}", fontsize=8, color=panels.INK)
        for axes, image in zip(grid[:, column], images, strict=True):
            panels.scan(axes, image)
    for axes, name in zip(grid[:, 0], _KINDS, strict=True):
        axes.set_ylabel(name, fontsize=9, color=panels.INK)
    return figure


def _scan_panels(found: Findings) -> Iterator[Panel]:
    for place, words, images in _chosen(found):
        figure = _figure(6.5, 2.2)
        for axes, image in zip(figure.subplots(1, len(images)), images, strict=True):
            panels.scan(axes, image)
        yield Panel(_png(figure), f"Keyframe {place}, {words}")


def _chosen(found: Findings) -> list[tuple[int, str, list[FloatArray]]]:
    """Keyframes that match none of Bob's: number, where, and as seen, as rebuilt, and the constant."""
    scans = found.scans
    assert scans is not None
    half = _SHOWN // 2
    often = _spread(np.flatnonzero(~found.world.unseen & ~scans.revealed), half)
    never = _spread(np.flatnonzero(found.world.unseen & ~scans.revealed), _SHOWN - half)
    return [
        (place, words, [scans.true[place].astype(float), scans.guessed[place], scans.constant])
        for places, words in ((often, "on Bob's path too"), (never, "where Bob never was"))
        for place in places
    ]


def _spread(which: Any, count: int) -> list[int]:
    """So many of an array of indices, evenly."""
    if not len(which):
        return []
    return [int(which[at]) for at in np.linspace(0, len(which) - 1, count + 2).round().astype(int)[1:-1]]


def _probes(found: Findings) -> Figure:
    figure = _figure(11, 6)
    axes: Any = figure.subplots()
    panels.curves(axes, found)
    axes.set_title("What unit vectors of a prober's choice tell of one descriptor")
    axes.legend(frameon=False, loc="lower right", fontsize=9)
    return figure


def _probe_panels(found: Findings) -> Iterator[Panel]:
    figure = _figure(6.5, 5)
    axes: Any = figure.subplots()
    panels.curves(axes, found)
    for words in (axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()):
        words.set_fontsize(15)
    yield Panel(_png(figure), "What unit vectors of a prober's choice tell of one descriptor, bit by bit")
