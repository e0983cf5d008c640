"""One panel of a picture, drawn onto axes: a path on the building, a scan, the probers' curves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bench.attacks.paths import PathRow, Reconstruction
from bench.attacks.probes import COSINES, ISOTROPIC, median_curve
from bench.attacks.run import Findings
from bench.attacks.world import World
from protocols.check.spread import bits_until
from spdz.foundations.types import FloatArray

# Okabe and Ito's palette: told apart with every kind of colour blindness.
TRUE, GUESS, BOB, WALL, INK = "#0072B2", "#D55E00", "#E69F00", "#B9BEC4", "#222222"
CURVES = ("#D55E00", "#CC79A7", "#E69F00", "#0072B2", "#56B4E9", "#009E73")
_MARGIN = 12.0
"""Metres of building shown around the paths."""


class Building(NamedTuple):
    """What every path is drawn on: walls and Bob's path upright, and the corners of what is shown."""

    walls: FloatArray
    own: FloatArray
    low: FloatArray
    high: FloatArray

    @staticmethod
    def of(world: World) -> Building:
        """The building around both paths."""
        own = upright(world, world.dense.positions)
        both = np.concatenate([upright(world, world.alice.positions), own])
        low, high = both.min(axis=0) - _MARGIN, both.max(axis=0) + _MARGIN
        walls = upright(world, world.walls)
        return Building(walls[((walls > low) & (walls < high)).all(axis=1)], own, low, high)

    @property
    def ratio(self) -> float:
        """Height by width."""
        return float((self.high[1] - self.low[1]) / (self.high[0] - self.low[0]))


def upright(world: World, points: FloatArray) -> FloatArray:
    """Points ``(k, 2)`` with the walls upright, turned once more: the building is longer than it is wide."""
    turned = (points[:, 0] + 1j * points[:, 1]) * np.exp(-1j * world.public.walls) * -1j
    return np.stack([turned.real, turned.imag], axis=1)


def path(axes: Any, building: Building, world: World, found: Reconstruction) -> None:
    """Where Bob puts Alice's keyframes, each joined to where it was taken."""
    true, guess = upright(world, world.alice.positions), upright(world, found.positions)
    low, high = building.low, building.high
    axes.plot(*building.walls.T, ".", color=WALL, markersize=1, markeredgewidth=0)
    axes.plot(*building.own.T, color=BOB, linewidth=3, alpha=0.5, label="Bob's own path")
    for a, b in zip(true, guess, strict=True):
        if np.isfinite(b[0]):
            axes.plot([a[0], b[0]], [a[1], b[1]], color=GUESS, linewidth=0.5, alpha=0.6)
    axes.plot(*true.T, "s", color=TRUE, markersize=4, label="Alice's keyframes")
    axes.plot(*guess.T, "x", color=GUESS, markersize=5, label="where Bob puts them")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()


def path_words(row: PathRow) -> tuple[str, str]:
    """What a path was made of, and how good it is."""
    source = "From the broadcast" if row.source == "broadcast" else "From this exchange"
    return f"{source}: {row.attack}", (
        f"{row.localised} of {row.keyframes} within 4 m, {row.unseen_localised} of {row.unseen} where Bob "
        "never was"
    )


def scan(axes: Any, image: FloatArray) -> None:
    """Occupied cells around a place."""
    axes.imshow(np.asarray(image, dtype=float).T, origin="lower", cmap="Greys", vmin=0, vmax=0.8)
    axes.set(xticks=[], yticks=[])


def curve_names(found: Findings) -> list[str]:
    """Whose curve is which, in their order, and the rule's."""
    rows = (curves.row for curves in found.probes)
    names = [f"{row.descriptors}, known beforehand: {row.prior}" for row in rows]
    return [*names, f"the rule, d = {ISOTROPIC:,}"]


def curves(axes: Any, found: Findings) -> None:
    """The median cosine of a prober's best guess after each bit, by kind of descriptor; and the rule."""
    *names, rule = curve_names(found)
    for one, name, colour in zip(found.probes, names, CURVES, strict=True):
        middle = median_curve(one.probings)
        style = "-" if one.row.prior != "nothing" else "--"
        axes.plot(
            np.arange(1, len(middle) + 1), middle, style, color=colour, linewidth=2, label=name
        )  # fmt: skip
    threshold = found.probes[0].row.threshold
    cosines = np.linspace(threshold, np.sqrt(0.64 + 0.36 * threshold**2), 60)
    bits = [bits_until(float(cosine), threshold, ISOTROPIC) for cosine in cosines]
    axes.plot(bits, cosines, ":", color=INK, label=rule)
    for cosine in COSINES:
        axes.axhline(cosine, color=WALL, linewidth=0.8, zorder=0)
    axes.set(
        xscale="log",
        xlim=(10, None),
        ylim=(0, 1),
        xlabel="probes, one bit each, after a first match",
        ylabel="cosine of the best guess",
    )
