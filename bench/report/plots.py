"""The plots, each one SVG that takes the colours of the page around it.

Matplotlib writes fixed colours; ink and grid are drawn in two colours that occur nowhere else and are then
replaced by the page's variables, so that one plot serves light and dark. Names inside an SVG get a prefix,
since several stand in one document.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FixedLocator, FuncFormatter, NullLocator

from bench.report import phases
from bench.report.cells import MODELS, Cell
from bench.report.folder import Results
from bench.report.paper import ENGINE, recorded_mp_spdz
from protocols.scores import SCORES

_INK, _GRID = "#010203", "#040506"
_VARIABLES = {_INK: "var(--ink)", _GRID: "var(--line)"}
_PALETTE = (
    "#b8860b", "#8a5a44", "#cc79a7", "#d55e00", "#9467bd",
    "#56b4e9", "#7f8c8d", "#00a087", "#5f9e2f", "#0072b2",
)  # fmt: skip
COLOURS = dict(zip(SCORES, _PALETTE, strict=True))
MARKERS = dict(zip(SCORES, "oPXs*^vD<h", strict=True))
_TICKS = (16, 64, 256, 1024, 4096)
_KINDS = (
    ("cpp", "C++ alone", "D", "#7f8c8d"),
    ("numpy", "in the clear", "s", "#00a087"),
    ("semi-honest", "semi-honest", "o", "#56b4e9"),
    ("malicious", "malicious", "o", "#d55e00"),
)
_PARTS = ("#0072b2", "#56b4e9", "#e69f00", "#d55e00", "#cc79a7", "#9aa5ae")


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot: SVG text, and what it shows."""

    svg: str
    words: str


def over_lengths(results: Results, what: str) -> Iterator[Plot]:
    """Time or bytes against N by score: one plot a security model.

    Args:
        results: What to draw.
        what: ``time`` or ``bytes``.
    """
    for model in MODELS:
        cells = cells_of(results, model)
        if cells:
            figure, axes = _figure(5.0, 4.4)
            _lines(axes, cells, lambda cell: (cell.n, _value(cell, what)))
            for cell in cells:
                one = recorded_mp_spdz(cell.score, cell.n, model)
                if one is not None:
                    value = one.ms if what == "time" else one.bytes_sent
                    axes.plot(cell.n, value, MARKERS[cell.score], mfc="none", mec=COLOURS[cell.score], ms=6)
            lengths(axes)
            _value_axis(axes, what)
            axes.set_title(model, fontsize=10, color=_INK)
            _legend(figure, axes)
            whose = f"{what} against N by score, {model}; hollow: {ENGINE}, recorded"
            yield Plot(_svg(figure, f"{what}-{model}"), whose[0].upper() + whose[1:])


def _value(cell: Cell, what: str) -> float:
    return cell.median_ms if what == "time" else cell.bytes_party


def tape_against_sent(results: Results) -> Iterator[Plot]:
    """What is stored against what is sent: one plot a security model, a point a length."""
    for model in MODELS:
        cells = [cell for cell in cells_of(results, model) if cell.tape_bytes]
        if cells:
            figure, axes = _figure(5.0, 4.4)
            _lines(axes, cells, lambda cell: (cell.bytes_party, cell.tape_bytes))
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(EngFormatter("B", sep=" "))
            axes.set_xlabel("sent online by a party")
            _value_axis(axes, "tape")
            axes.set_title(model, fontsize=10, color=_INK)
            _legend(figure, axes)
            yield Plot(_svg(figure, f"tape-{model}"), f"Tape against online bytes, {model}; a point a length")


def security_against_time(results: Results, n: int) -> Iterator[Plot]:
    """At one length: each score's time malicious, semi-honest, in the clear and in C++."""
    shown = [score for score in SCORES if any(results.cell(kind, score, n) for kind, *_ in _KINDS)]
    figure, axes = _figure(5.4, 0.9 + 0.32 * len(shown))
    for row, score in enumerate(shown):
        for kind, words, marker, colour in _KINDS:
            cell = results.cell(kind, score, n)
            if cell is not None:
                axes.plot(cell.median_ms, row, marker, color=colour, ms=7, label=words)
    for row, score in enumerate(shown):
        for kind, words, marker, colour in _KINDS:
            one = recorded_mp_spdz(score, n, kind)
            if one is not None:
                axes.plot(one.ms, row, marker, mfc="none", mec=colour, ms=7, label=f"{ENGINE}, {words}")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel("ms")
    axes.grid(axis="x", color=_GRID)
    _score_rows(axes, shown)
    _legend(figure, axes, columns=2)
    yield Plot(
        _svg(figure, "security"), f"Security against performance at N = {n}; hollow: {ENGINE}, recorded"
    )


def where_time_goes(results: Results, n: int) -> Iterator[Plot]:
    """At one length: shares of the phases, stacked, one plot a security model."""
    for model in MODELS:
        found = {score: phases.parts(results.cell(model, score, n)) for score in SCORES}
        shown = {score: parts for score, parts in found.items() if parts}
        if not shown:
            continue
        figure, axes = _figure(5.0, 0.9 + 0.32 * len(shown))
        for row, parts in enumerate(shown.values()):
            left, whole = 0.0, sum(parts.values())
            for (name, value), colour in zip(parts.items(), _PARTS, strict=True):
                axes.barh(row, 100 * value / whole, left=left, color=colour, label=name, height=0.7)
                left += 100 * value / whole
        axes.set(xlim=(0, 100))
        axes.set_xlabel("% of a profiled comparison")
        _score_rows(axes, list(shown))
        axes.set_title(f"{model}, N = {n}", fontsize=10, color=_INK)
        _legend(figure, axes, columns=3)
        yield Plot(_svg(figure, f"phases-{model}"), f"Where the time goes at N = {n}, {model}")


# --- what the plots share ---------------------------------------------------------------------------------


def cells_of(results: Results, model: str) -> list[Cell]:
    """The cells of a model, by score and length."""
    found = [cell for cell in results.cells.values() if cell.protocol == model]
    return sorted(found, key=lambda cell: (int(cell.score[1:]), cell.n))


def _figure(width: float, height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height + 0.6), layout="constrained")
    axes: Any = figure.subplots()
    axes.tick_params(colors=_INK, labelsize=10, which="both")
    axes.xaxis.label.set_color(_INK)
    axes.yaxis.label.set_color(_INK)
    axes.spines[["top", "right"]].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_INK)
    return figure, axes


def _lines(axes: Any, cells: Sequence[Cell], point: Callable[[Cell], tuple[float, float]]) -> None:
    for score in SCORES:
        points = [point(cell) for cell in cells if cell.score == score]
        if points:
            across, up = zip(*points, strict=True)
            axes.plot(across, up, MARKERS[score], ls="-", lw=1.3, ms=4.5, color=COLOURS[score], label=score)


def lengths(axes: Any) -> None:
    """The axis of N, of powers of two."""
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_locator(FixedLocator(_TICKS))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0f}"))
    axes.set_xlabel("N")


def _value_axis(axes: Any, what: str) -> None:
    axes.set_yscale("log")
    axes.grid(color=_GRID)
    if what == "time":
        axes.set_ylabel("ms")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axes.set_ylabel("tape of a party" if what == "tape" else "sent by a party")
        axes.yaxis.set_major_formatter(EngFormatter("B", sep=" "))


def _score_rows(axes: Any, scores: Sequence[str]) -> None:
    axes.set_yticks(range(len(scores)), scores)
    axes.set_ylim(len(scores) - 0.5, -0.5)
    axes.set_axisbelow(True)


def _legend(figure: Figure, axes: Any, columns: int = 5) -> None:
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(
        named.values(),
        named,
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        fontsize=10,
        labelcolor=_INK,
    )


def _svg(figure: Figure, name: str) -> str:
    """The figure as an ``svg`` element without background, in the colours of the page."""
    drawn = StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(drawn, format="svg", transparent=True, metadata=nothing)
    text = drawn.getvalue()
    text = text[text.index("<svg") :]
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, variable)
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", text)
    return re.sub(r'<svg [^>]*?viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1" role="img">', text, count=1)
