"""The demo's maps as SVG: a few hundred kilobytes for a building, and colours that a page's style gives.

One unit is the side of a square of wall, ``CELL``; y points down. Classes: ``wall``, ``trail`` and ``place``
with ``alice``, ``bob`` or ``both``; ``yes`` and ``no`` for what was verified and what rejected.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from bench.demo.scene import CELL, View, seen_by_both, size
from protocols.geometry.poses import Pose, apply
from protocols.geometry.submap import Submap
from protocols.geometry.verification import Verified
from spdz.foundations.types import FloatArray

NAMES = ("alice", "bob")
GAP = 8.0
"""Metres between two maps that are drawn one below the other."""
AROUND, FINE = 8.0, 0.1
"""Metres around a keyframe that a pair of submaps is drawn for, and the side of the squares."""


def own_map(view: View, name: str, words: str) -> str:
    """One robot's map by itself."""
    width, height = size([view])
    inside = _wall(view.walls, height, name) + _trail(view, height, name)
    return _svg(width, height, inside, words)


def merged_map(shown: Sequence[View], pairs: Iterable[tuple[int, int]], words: str) -> str:
    """Both robots' maps in one frame, and rings where both saw the same place."""
    width, height = size(shown)
    parts = [
        _wall(walls, height, name) for walls, name in zip(seen_by_both(*shown), (*NAMES, "both"), strict=True)
    ]
    parts += [_trail(view, height, name) for view, name in zip(shown, NAMES, strict=True)]
    for i, j in pairs:
        x, y = _units((shown[0].places[i] + shown[1].places[j])[None] / 2, height)[0]
        parts.append(f'<circle class="yes" cx="{x:.1f}" cy="{y:.1f}" r="5"/>')
    return _svg(width, height, "".join(parts), words)


def candidates(shown: Sequence[View], verdicts: Mapping[tuple[int, int], Verified], words: str) -> str:
    """Alice's map above Bob's, each in its own frame, with a line for every candidate."""
    sizes = [size([view]) for view in shown]
    width, height = max(wide for wide, _ in sizes), sizes[0][1] + GAP + sizes[1][1]
    above = np.array([0.0, sizes[1][1] + GAP])
    alice, bob = shown
    lifted = View(alice.walls + above, alice.trail + above, alice.places + above), bob
    parts = [
        _wall(view.walls, height, name) + _trail(view, height, name)
        for view, name in zip(lifted, NAMES, strict=True)
    ]
    # Rejected ones last, so that they are not hidden among the many.
    for (i, j), verdict in sorted(verdicts.items(), key=lambda item: not item[1].accepted):
        (x, y), (u, v) = _units(np.stack([lifted[0].places[i], lifted[1].places[j]]), height)
        kind = "yes" if verdict.accepted else "no"
        parts.append(f'<path class="{kind}" d="M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}"/>')
    return _svg(width, height, "".join(parts), words)


def two_submaps(own: bytes, other: bytes, transform: Pose, words: str) -> str:
    """Two robots' submaps, one laid upon the other where the alignment puts it."""
    first, second = Submap.from_bytes(own), Submap.from_bytes(other)
    turn, side = (0.0, 0.0, -first.walls), 2 * AROUND / FINE * CELL
    parts = []
    for points, name in (
        (apply(turn, first.points), "alice"),
        (apply(turn, apply(transform, second.points)), "bob"),
    ):
        near = points[np.abs(points).max(axis=1) < AROUND] + AROUND
        parts.append(_wall(np.floor(near / FINE) * CELL, side, name))
    return _svg(side, side, "".join(parts), words)


def shares(
    verdicts: Mapping[tuple[int, int], Verified], kinds: Mapping[tuple[int, int], str], least: float
) -> str:
    """A dot for every candidate by the share of points that agree: from 40 % to 100 %.

    Args:
        verdicts: Of the candidates.
        kinds: What each is in truth: ``"same"``, ``"near"`` or ``"wrong"``.
        least: The share from which a candidate is verified.
    """
    width, height, low = 340.0, 96.0, 0.4
    columns: dict[int, int] = {}
    parts = [f'<path class="axis" d="M10 70H330M{_place(least, low)} 8V78"/>']
    for pair, verdict in sorted(verdicts.items(), key=lambda item: item[1].weight):
        column = round((max(verdict.weight, low) - low) * 50)
        columns[column] = columns.get(column, -1) + 1
        x, y = _place(max(verdict.weight, low), low), 63 - 9 * columns[column]
        parts.append(f'<circle class="dot {kinds[pair]}" cx="{x}" cy="{y}" r="4"/>')
    for share in (low, 0.6, least, 1.0):
        parts.append(f'<text x="{_place(share, low)}" y="90">{share:.0%}</text>')
    words = "Share of points that agree, a dot a candidate"
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{words}">{"".join(parts)}</svg>'
    )


def _place(share: float, low: float) -> float:
    return round(20 + 300 * (share - low) / (1 - low), 1)


def _svg(width: float, height: float, inside: str, words: str) -> str:
    box = f"0 0 {width / CELL:.0f} {height / CELL:.0f}"
    return f'<svg viewBox="{box}" role="img" aria-label="{escape(words)}">{inside}</svg>'


def _units(points: FloatArray, height: float) -> FloatArray:
    """From metres, y up, to units, y down."""
    return np.stack([points[:, 0], height - points[:, 1]], axis=1) / CELL


def _wall(corners: FloatArray, height: float, name: str) -> str:
    """Squares as strokes: one for each run of neighbours in a row."""
    if len(corners) == 0:
        return ""
    index = np.unique(np.rint(corners[:, ::-1] / CELL).astype(np.int64), axis=0)
    begins = np.flatnonzero(np.r_[True, (np.diff(index[:, 0]) != 0) | (np.diff(index[:, 1]) != 1)])
    lengths = np.diff(np.r_[begins, len(index)])
    rows = height / CELL - index[begins, 0] - 0.5
    runs = "".join(f"M{x} {y:.1f}h{n}" for x, y, n in zip(index[begins, 1], rows, lengths, strict=True))
    return f'<path class="wall {name}" d="{runs}"/>'


def _trail(view: View, height: float, name: str) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _units(view.trail, height)[::2])
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in _units(view.places, height))
    return f'<polyline class="trail {name}" points="{points}"/><path class="place {name}" d="{dots}"/>'
