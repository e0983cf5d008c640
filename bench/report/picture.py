"""The picture for the README: time against N on white, ours beside MP-SPDZ's recorded."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bench.report.cells import MODELS, Cell
from bench.report.folder import Results
from bench.report.paper import ENGINE, recorded_mp_spdz
from bench.report.plots import COLOURS, MARKERS, cells_of, lengths
from protocols.scores import SCORES

SHOWN = ("S2", "S4", "S10")
"""Recorded at several lengths, and unlike each other."""


def picture(results: Results) -> bytes | None:
    """A PNG of one panel a security model; None where none of SHOWN was run in either."""
    panels = {model: [cell for cell in cells_of(results, model) if cell.score in SHOWN] for model in MODELS}
    panels = {model: cells for model, cells in panels.items() if cells}
    if not panels:
        return None
    figure = Figure(figsize=(9.6, 4.2), facecolor="white", layout="constrained", dpi=150)
    grid: Any = figure.subplots(1, len(panels), sharey=True, squeeze=False)
    for axes, (model, cells) in zip(grid[0], panels.items(), strict=True):
        for score in SHOWN:
            _curves(axes, [cell for cell in cells if cell.score == score])
        lengths(axes)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_title(model)
        axes.grid(color="#e3e7ea")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)
    figure.supylabel("ms a comparison", fontsize=10)
    FigureCanvasAgg(figure)
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    return drawn.getvalue()


def _curves(axes: Any, cells: Sequence[Cell]) -> None:
    """One score of one model: ours, and what was recorded at the same lengths."""
    if not cells:
        return
    score = cells[0].score
    style = {"color": COLOURS[score], "marker": MARKERS[score], "ms": 6}
    ours = [(cell.n, cell.median_ms) for cell in cells]
    axes.plot(*zip(*ours, strict=True), ls="-", label=f"{score} {SCORES[score].title}", **style)
    found = [(cell.n, recorded_mp_spdz(score, cell.n, cell.protocol)) for cell in cells]
    theirs = [(n, one.ms) for n, one in found if one is not None]
    if theirs:
        axes.plot(*zip(*theirs, strict=True), ls=":", mfc="white", label=f"{score}, {ENGINE}", **style)
