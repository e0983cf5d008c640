"""The demo's PNGs: both maps before they knew of each other, and the one that they made of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bench.demo.scene import CELL, View, seen_by_both, size
from spdz.foundations.types import FloatArray

# Okabe and Ito's palette: told apart with every kind of colour blindness.
ALICE_BLUE, BOB_ORANGE, RIGHT_GREEN = "#0072B2", "#E69F00", "#009E73"
ALICE_WALL, BOB_WALL, BOTH_WALL = "#8DBCD9", "#F1CC80", "#40464D"
INK = "#222222"

WIDTH, ABOVE, BELOW = 14.0, 1.0, 0.55
"""Inches: of a picture, of the strip for the title, of the strip for the legend."""
SCALE_BAR = 20.0
"""Length of the scale bar in metres."""
DOTS = 110
"""Dots an inch."""


def draw_merged(path: Path, shown: Sequence[View], pairs: Collection[tuple[int, int]], subtitle: str) -> None:
    """Draw the merged map as a PNG.

    Args:
        path: Where to write; the folder must exist.
        shown: Alice's and Bob's map in one frame.
        pairs: Verified pairs of Alice's and Bob's keyframes.
        subtitle: A line under the title.
    """
    figure, (axes,), height = _figure([size(shown)])
    alice, bob = shown
    by_alice, by_bob, by_both = seen_by_both(alice, bob)
    for walls, colour in ((by_alice, ALICE_WALL), (by_bob, BOB_WALL), (by_both, BOTH_WALL)):
        _walls(axes, walls, colour)
    _trail(axes, alice, ALICE_BLUE, 3.4)
    _trail(axes, bob, BOB_ORANGE, 1.7)
    middles = np.array([(alice.places[i] + bob.places[j]) / 2 for i, j in pairs]).reshape(-1, 2)
    axes.plot(
        middles[:, 0], middles[:, 1], "o", markersize=11, markerfacecolor="none", markeredgewidth=2.2,
        markeredgecolor=RIGHT_GREEN, zorder=6,
    )  # fmt: skip
    _words(figure, height, "One map of two robots that showed each other only what matched", subtitle)
    ring = Line2D(
        [], [], linestyle="none", marker="o", markerfacecolor="none", markersize=11, markeredgewidth=2.2,
        markeredgecolor=RIGHT_GREEN, label=f"places that both saw, verified ({len(pairs)})",
    )  # fmt: skip
    _legend(
        figure,
        [
            Line2D([], [], color=ALICE_BLUE, linewidth=3.4, label="Alice's path"),
            Line2D([], [], color=BOB_ORANGE, linewidth=1.7, label="Bob's path"),
            ring,
            _square(ALICE_WALL, "walls seen by Alice"),
            _square(BOB_WALL, "by Bob"),
            _square(BOTH_WALL, "by both"),
        ],
    )
    figure.savefig(path, dpi=DOTS)


def draw_before(path: Path, shown: Sequence[View], subtitle: str) -> None:
    """Draw both robots' own maps side by side as a PNG, each in a frame of its own."""
    figure, all_axes, height = _figure([size([view]) for view in shown])
    colours = (ALICE_BLUE, ALICE_WALL, "Alice"), (BOB_ORANGE, BOB_WALL, "Bob")
    for axes, view, (colour, wall, name) in zip(all_axes, shown, colours, strict=True):
        _walls(axes, view.walls, wall)
        _trail(axes, view, colour, 2.4)
        axes.set_title(name, color=colour, fontsize=15, fontweight="bold", loc="left", x=0.03)
    _words(figure, height, "Two robots, two maps, by odometry alone", subtitle)
    _legend(figure, [Line2D([], [], color=INK, linewidth=0, marker="o", markersize=4, label="keyframes")])
    figure.savefig(path, dpi=DOTS)


def _figure(sizes: Sequence[tuple[float, float]]) -> tuple[Figure, list[Axes], float]:
    """A figure with a map of each size, in metres, side by side on one scale; and its height in inches."""
    metre = WIDTH / sum(width for width, _ in sizes)
    height = max(tall for _, tall in sizes) * metre + ABOVE + BELOW
    figure = Figure(figsize=(WIDTH, height), facecolor="white")
    FigureCanvasAgg(figure)
    found, left = [], 0.0
    for width, tall in sizes:
        axes = figure.add_axes(
            (left * metre / WIDTH, BELOW / height, width * metre / WIDTH, tall * metre / height)
        )
        axes.set(xlim=(0, width), ylim=(0, tall), aspect="equal")
        axes.set_axis_off()
        left += width
        found.append(axes)
    wide, tall = sizes[-1]
    bar = [wide - 4 - SCALE_BAR, wide - 4]
    found[-1].plot(bar, [2, 2], color=INK, linewidth=3, solid_capstyle="butt", zorder=7)
    found[-1].text(sum(bar) / 2, 2.8, f"{SCALE_BAR:.0f} m", color=INK, fontsize=12, ha="center")
    return figure, found, height


def _walls(axes: Axes, corners: FloatArray, colour: str) -> None:
    """Squares, as dots of their size."""
    inches = axes.get_position().width * WIDTH / (axes.get_xlim()[1] - axes.get_xlim()[0])
    x, y = (corners + CELL / 2).T
    points = 1.35 * CELL * inches * 72
    axes.plot(x, y, "s", color=colour, markersize=points, markeredgewidth=0, zorder=1)


def _trail(axes: Axes, view: View, colour: str, width: float) -> None:
    axes.plot(view.trail[:, 0], view.trail[:, 1], color=colour, linewidth=width, alpha=0.9, zorder=3)
    axes.plot(view.places[:, 0], view.places[:, 1], "o", color=colour, markersize=3.4, zorder=4)


def _words(figure: Figure, height: float, title: str, subtitle: str) -> None:
    figure.text(0.03, 1 - 0.22 / height, title, fontsize=20, fontweight="bold", color=INK, va="top")
    figure.text(0.03, 1 - 0.66 / height, subtitle, fontsize=13, color=INK, va="top")


def _legend(figure: Figure, entries: list[Line2D]) -> None:
    figure.legend(
        handles=entries, loc="lower left", bbox_to_anchor=(0.02, 0.0), ncols=6, frameon=False, fontsize=12
    )


def _square(colour: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="none", marker="s", color=colour, markersize=9, label=label)
