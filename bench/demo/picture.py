"""The picture of the demo: the building, both robots' paths, and what the private comparison found."""

from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bench.demo.dataset import Run
from bench.demo.places import DIFFERENT, SAME, Robot
from bench.demo.scan_context import scan_points, wall_direction
from spdz.foundations.types import FloatArray

# Okabe and Ito's palette: told apart with every kind of colour blindness.
ALICE_BLUE, BOB_ORANGE, RIGHT_GREEN, WRONG_PURPLE = "#0072B2", "#E69F00", "#009E73", "#CC79A7"
INK, WALL_GREY, MISSED_GREY = "#222222", "#8F959C", "#6B7075"

RIGHT_RING, NEAR_RING, MISSED_RING = (12.0, 2.4), (11.0, 0.9), (9.0, 0.9)
"""Diameter and line width of the rings, in points."""
WIDTH, ABOVE, BELOW = 14.0, 1.0, 0.85
"""Inches: of the picture, of the strip for the title, of the strip for the legend."""
MARGIN = 9.0
"""Metres of building shown around the robots' paths."""
WALL_SQUARE = 0.15
"""Side of a wall point, in metres: nearer points are drawn once."""
SCALE_BAR = 20.0
"""Length of the scale bar in metres."""

Ends: TypeAlias = tuple[FloatArray, FloatArray]
"""Alice's and Bob's keyframes, ``(n, 2)`` each, metres on the picture's axes."""


def draw_map(
    path: Path,
    run: Run,
    alice: Robot,
    bob: Robot,
    decisions: npt.NDArray[np.bool_],
    truth: npt.NDArray[np.int8],
) -> None:
    """Draw one PNG, turned so that the walls are upright and the paths lie lengthwise.

    Args:
        path: Where to write; the folder must exist.
        run: The whole run; all its scans draw the building.
        alice: From :func:`bench.demo.places.robots`.
        bob: From :func:`bench.demo.places.robots`.
        decisions: ``(n_alice, n_bob)``, folded: which pairs the robots were told match.
        truth: ``(n_alice, n_bob)`` from :func:`bench.demo.places.truth`.
    """
    points = scan_points(run.ranges, run.bearings, run.poses)
    upright = np.exp(-1j * wall_direction(points, 0.0))
    span = np.ptp(_turn(np.concatenate([alice.trajectory, bob.trajectory]), upright), axis=0)
    if span[1] > span[0]:
        upright *= -1j
    paths = _turn(alice.trajectory, upright), _turn(bob.trajectory, upright)
    ends = _turn(alice.positions, upright), _turn(bob.positions, upright)
    low = np.min([p.min(axis=0) for p in paths], axis=0) - MARGIN
    high = np.max([p.max(axis=0) for p in paths], axis=0) + MARGIN

    map_height = WIDTH * (high[1] - low[1]) / (high[0] - low[0])
    height = map_height + ABOVE + BELOW
    figure = Figure(figsize=(WIDTH, height), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, BELOW / height, 1.0, map_height / height))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()

    walls = _turn(points[np.isfinite(points[..., 0])], upright)
    walls = walls[((walls > low) & (walls < high)).all(axis=1)]
    walls = np.unique(np.round(walls / WALL_SQUARE), axis=0) * WALL_SQUARE
    axes.plot(walls[:, 0], walls[:, 1], ".", color=WALL_GREY, markersize=1.6, markeredgewidth=0, zorder=1)
    # Alice's path is the broader one, so that it shows on both sides of Bob's where they share a corridor.
    for trail, keyframes, colour, line in zip(paths, ends, (ALICE_BLUE, BOB_ORANGE), (3.6, 1.6), strict=True):
        axes.plot(trail[:, 0], trail[:, 1], color=colour, linewidth=line, alpha=0.85, zorder=2)
        axes.plot(keyframes[:, 0], keyframes[:, 1], "o", color=colour, markersize=3.2, zorder=3)

    right, wrong = decisions & (truth == 1), decisions & (truth == 0)
    near, missed = decisions & (truth == -1), ~decisions & (truth == 1)
    _lines(axes, ends, wrong, "--", WRONG_PURPLE, 4)
    _lines(axes, ends, near | right, "-", RIGHT_GREEN, 5)
    _rings(axes, ends, missed, MISSED_GREY, *MISSED_RING)
    _rings(axes, ends, near, RIGHT_GREEN, *NEAR_RING)
    _rings(axes, ends, right, RIGHT_GREEN, *RIGHT_RING)
    _scale_bar(axes, low, high)
    subtitle = (
        f"Laser scans from MIT's corridors. {len(alice.positions)} places of Alice against "
        f"{len(bob.positions)} of Bob: {truth.size * bob.turns:,} private comparisons, one bit each."
    )
    _words(figure, height, subtitle, [int(np.count_nonzero(m)) for m in (right, wrong, near, missed)])
    figure.savefig(path, dpi=130)


def _turn(points: FloatArray, by: complex) -> FloatArray:
    turned = (points[:, 0] + 1j * points[:, 1]) * by
    return np.stack([turned.real, turned.imag], axis=1)


def _lines(
    axes: Axes, ends: Ends, which: npt.NDArray[np.bool_], style: str, colour: str, zorder: int
) -> None:
    """Lines from Alice's keyframes to Bob's."""
    i, j = np.nonzero(which)
    lines = list(np.stack([ends[0][i], ends[1][j]], axis=1))
    axes.add_collection(LineCollection(lines, linestyles=style, colors=colour, linewidths=2.2, zorder=zorder))


def _rings(
    axes: Axes, ends: Ends, which: npt.NDArray[np.bool_], colour: str, size: float, width: float
) -> None:
    """Rings half-way between the two keyframes: on the map, 1 m is too short for a line to be seen."""
    i, j = np.nonzero(which)
    middle = (ends[0][i] + ends[1][j]) / 2
    axes.plot(
        middle[:, 0], middle[:, 1], "o", markersize=size, markerfacecolor="none", markeredgecolor=colour,
        markeredgewidth=width, zorder=6,
    )  # fmt: skip


def _scale_bar(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    x, y = high[0] - MARGIN - SCALE_BAR, high[1] - 5.0
    axes.plot([x, x + SCALE_BAR], [y, y], color=INK, linewidth=3, solid_capstyle="butt", zorder=7)
    axes.text(x + SCALE_BAR / 2, y + 1.2, f"{SCALE_BAR:.0f} m", color=INK, fontsize=12, ha="center")


def _words(figure: Figure, height: float, subtitle: str, counts: list[int]) -> None:
    """Title above, legend below."""
    right, wrong, near, missed = counts
    title = "Where two robots have both been, found without showing each other a scan"
    figure.text(0.03, 1 - 0.22 / height, title, fontsize=20, fontweight="bold", color=INK, va="top")
    figure.text(0.03, 1 - 0.66 / height, subtitle, fontsize=13, color=INK, va="top")
    entries = [
        Line2D([], [], color=ALICE_BLUE, linewidth=3.6, marker="o", label="Alice's path and places"),
        Line2D([], [], color=BOB_ORANGE, linewidth=1.6, marker="o", label="Bob's path and places"),
        _ring(RIGHT_GREEN, *RIGHT_RING, f"match, right ({right}): within {SAME:.0f} m"),
        _ring(RIGHT_GREEN, *NEAR_RING, f"match, near ({near}): {SAME:.0f} to {DIFFERENT:.0f} m, not counted"),
        Line2D([], [], color=WRONG_PURPLE, linewidth=2, linestyle="--", label=f"match, wrong ({wrong})"),
        _ring(MISSED_GREY, *MISSED_RING, f"same place, missed ({missed})"),
    ]
    corner = (0.02, 0.1 / height)
    figure.legend(
        handles=entries, loc="lower left", bbox_to_anchor=corner, ncols=3, frameon=False, fontsize=12
    )


def _ring(colour: str, size: float, width: float, label: str) -> Line2D:
    return Line2D(
        [], [], linestyle="none", marker="o", markerfacecolor="none", markersize=size, markeredgewidth=width,
        markeredgecolor=colour, label=label,
    )  # fmt: skip
