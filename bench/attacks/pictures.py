"""The attacks' pictures: paths on the building, scans side by side, what bits tell."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from bench.attacks.probes import COSINES, ISOTROPIC, median_curve
from bench.attacks.run import Findings
from bench.attacks.world import World
from protocols.check.spread import bits_until
from spdz.foundations.types import FloatArray

# Okabe and Ito's palette: told apart with every kind of colour blindness.
_TRUE, _GUESS, _BOB, _WALL, _INK = "#0072B2", "#D55E00", "#E69F00", "#B9BEC4", "#222222"
_CURVES = ("#D55E00", "#CC79A7", "#E69F00", "#0072B2", "#56B4E9", "#009E73")
_MARGIN = 12.0
"""Metres of building shown around the paths."""
_SHOWN = 6
"""Scans side by side."""
_COLOURS = 48
"""Of a picture, shades included."""


def draw(folder: Path, found: Findings) -> None:
    """Write a PNG for each part that was run, and note them in the findings.

    Args:
        folder: Where to write; it must exist.
        found: What the attacks brought.
    """
    for name, ready, figure in (
        ("paths", bool(found.paths), _paths),
        ("scans", found.scans is not None, _scans),
        ("probes", bool(found.probes), _probes),
    ):
        if ready:
            found.pictures[name] = _written(folder / f"{name}.png", figure(found))


def _written(path: Path, figure: Figure) -> Path:
    """Write a PNG of few colours: a page that holds it stays small."""
    FigureCanvasAgg(figure)
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    picture = Image.open(drawn).convert("RGB")
    picture.quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), facecolor="white", layout="constrained", dpi=100)


def _paths(found: Findings) -> Figure:
    world = found.world
    both = _upright(world, np.concatenate([world.alice.positions, world.dense.positions]))
    low, high = both.min(axis=0) - _MARGIN, both.max(axis=0) + _MARGIN
    walls = _upright(world, world.walls)
    walls = walls[((walls > low) & (walls < high)).all(axis=1)]
    true, own = _upright(world, world.alice.positions), _upright(world, world.dense.positions)
    shown = [pair for pair in found.paths if pair[0].source != "nothing"]
    ratio = (high[1] - low[1]) / (high[0] - low[0])
    figure = _figure(13, 6.5 * ratio * 2 + 1.2)
    panels: Any = figure.subplots(2, 2)
    for axes, (row, found_path) in zip(panels.ravel(), shown, strict=True):
        guess = _upright(world, found_path.positions)
        axes.plot(*walls.T, ".", color=_WALL, markersize=1, markeredgewidth=0)
        axes.plot(*own.T, color=_BOB, linewidth=3, alpha=0.5, label="Bob's own path")
        for a, b in zip(true, guess, strict=True):
            if np.isfinite(b[0]):
                axes.plot([a[0], b[0]], [a[1], b[1]], color=_GUESS, linewidth=0.5, alpha=0.6)
        axes.plot(*true.T, "s", color=_TRUE, markersize=4, label="Alice's keyframes")
        axes.plot(*guess.T, "x", color=_GUESS, markersize=5, label="where Bob puts them")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        source = "From the broadcast" if row.source == "broadcast" else "From this exchange"
        axes.set_title(
            f"{source}: {row.attack}\n{row.localised} of {row.keyframes} within 4 m, "
            f"{row.unseen_localised} of {row.unseen} where Bob never was",
            fontsize=10,
            color=_INK,
        )
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _upright(world: World, points: FloatArray) -> FloatArray:
    """Points ``(k, 2)`` with the walls upright, turned once more: the building is longer than it is wide."""
    turned = (points[:, 0] + 1j * points[:, 1]) * np.exp(-1j * world.public.walls) * -1j
    return np.stack([turned.real, turned.imag], axis=1)


def _scans(found: Findings) -> Figure:
    scans = found.scans
    assert scans is not None
    never = np.flatnonzero(found.world.unseen & ~scans.revealed)
    often = np.flatnonzero(~found.world.unseen & ~scans.revealed)
    half = _SHOWN // 2
    chosen = [*_spread(often, half), *_spread(never, _SHOWN - half)]
    figure = _figure(13, 7)
    grid: Any = figure.subplots(3, len(chosen))
    rows = ("what Alice saw", "rebuilt from the broadcast", "from this exchange:\nno descriptor, a constant")
    columns = scans.true[chosen], scans.guessed[chosen], np.stack([scans.constant] * len(chosen))
    for axes_row, name, images in zip(grid, rows, columns, strict=True):
        for axes, image, place in zip(axes_row, images, chosen, strict=True):
            axes.imshow(np.asarray(image, dtype=float).T, origin="lower", cmap="Greys", vmin=0, vmax=0.8)
            axes.set(xticks=[], yticks=[])
            if name == rows[0]:
                where = "where Bob never was" if place in never else "on Bob's path too"
                axes.set_title(f"keyframe {place}, {where}", fontsize=8, color=_INK)
        axes_row[0].set_ylabel(name, fontsize=9, color=_INK)
    return figure


def _spread(which: Any, count: int) -> list[int]:
    """So many of an array of indices, evenly."""
    if not len(which):
        return []
    return [int(which[at]) for at in np.linspace(0, len(which) - 1, count + 2).round().astype(int)[1:-1]]


def _probes(found: Findings) -> Figure:
    figure = _figure(11, 6)
    axes: Any = figure.add_subplot()
    for curves, colour in zip(found.probes, _CURVES, strict=True):
        row, middle = curves.row, median_curve(curves.probings)
        axes.plot(
            np.arange(1, len(middle) + 1),
            middle,
            color=colour,
            linewidth=2,
            linestyle="-" if row.prior != "nothing" else "--",
            label=f"{row.descriptors}, known beforehand: {row.prior}",
        )
    threshold = found.probes[0].row.threshold
    cosines = np.linspace(threshold, np.sqrt(0.64 + 0.36 * threshold**2), 60)
    bits = [bits_until(float(cosine), threshold, ISOTROPIC) for cosine in cosines]
    axes.plot(bits, cosines, ":", color=_INK, label=f"the rule, d = {ISOTROPIC:,}")
    for cosine in COSINES:
        axes.axhline(cosine, color=_WALL, linewidth=0.8, zorder=0)
    axes.set(
        xscale="log",
        xlim=(10, None),
        ylim=(0, 1),
        xlabel="probes, one bit each, after a first match",
        ylabel="cosine of the best guess with the hidden descriptor",
        title="What unit vectors of a prober's choice tell of one descriptor",
    )
    axes.legend(frameon=False, loc="lower right", fontsize=9)
    return figure
