"""The scores of one's own descriptors as a picture: neighbours, others, foreign ones, and the threshold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from protocols.check.clear_scores import score_table
from protocols.check.spread import evenly, thinned
from protocols.check.standing import Standing
from spdz.foundations.types import FloatArray

_ROWS = 600
"""Rows that scores are drawn of."""
_BINS = 80


def draw(
    path: Path, own: npt.ArrayLike, foreign: npt.ArrayLike | None, standing: Standing, neighbours: int
) -> None:
    """Write a picture; the format goes by the file's name.

    Args:
        path: Where to write.
        own: The descriptors that were described.
        foreign: Those of another place, if any.
        standing: What was found.
        neighbours: Rows at most so far apart may show one place.

    Raises:
        ImportError: matplotlib is not installed.
        OSError: the file cannot be written.
        ValueError: the file's name has no ending that stands for a format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    everything = _finite(own)
    index = evenly(len(everything) - 1, _ROWS)
    rows = everything[index]
    scores = score_table(standing.score, rows, rows)
    near = np.diagonal(score_table(standing.score, rows, everything[index + 1]))
    apart = np.abs(np.subtract.outer(np.arange(len(rows)), np.arange(len(rows))))
    others = scores[apart > thinned(neighbours, len(everything), len(rows))]
    groups = [("direct neighbours", near, "#009E73"), ("others", others, "#0072B2")]
    if foreign is not None:
        strangers = _finite(foreign)
        theirs = score_table(standing.score, strangers[evenly(len(strangers), _ROWS)], rows)
        groups.append(("foreign", theirs.ravel(), "#E69F00"))
    figure = Figure(figsize=(8, 4.5), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    low, high = (float(end(values)) for end, values in ((np.min, scores), (np.max, scores)))
    for name, values, colour in groups:
        axes.hist(
            values, _BINS, (low, high), density=True, histtype="step", color=colour, label=name, linewidth=2
        )
    if standing.threshold is not None:
        label = f"threshold {standing.threshold:.3g}"
        axes.axvline(standing.threshold, color="#222222", linestyle="--", label=label)
    axes.set(xlabel=f"{standing.score} of two descriptors", ylabel="how often", yscale="log")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=130)


def _finite(array: npt.ArrayLike) -> FloatArray:
    rows = np.asarray(array, dtype=np.float64)
    return rows[np.isfinite(rows).all(axis=1)]
