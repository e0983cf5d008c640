"""The floor: beside every time, the same frames over a bare socket, and the exchange in the clear.

And what is done ahead, which is in none of these times.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from bench.report.cells import MODELS, Cell
from bench.report.folder import Results
from bench.report.table import Table, mean_ratio, milliseconds, ratio, times
from bench.sweep.ahead import ABOUT
from protocols.scores import SCORES


def above_socket(cell: Cell | None) -> float | None:
    """How many times the bare socket's time a cell takes."""
    return None if cell is None else ratio(cell.median_ms, cell.floor_ms)


def above_clear(results: Results, cell: Cell | None) -> float | None:
    """How many times the exchange in the clear a cell takes."""
    clear = None if cell is None else results.cell("numpy", cell.score, cell.n)
    return None if cell is None or clear is None else ratio(cell.median_ms, clear.median_ms)


def ahead_words(results: Results) -> Iterator[str]:
    """What is done ahead, and how long programs took to compile; nothing where it was not measured."""
    cells = [cell for cell in results.cells.values() if cell.protocol in MODELS]
    compiled = [cell.compile_ms for cell in cells if cell.compile_ms is not None]
    if any(cell.ahead_ms is not None for cell in cells):
        yield " ".join(ABOUT.split())
    if compiled:
        yield (
            "Neither that nor a comparison's time holds reading and compiling the program, once a session: "
            f"{milliseconds(min(compiled))} to {milliseconds(max(compiled))} ms, the median "
            f"cell's {milliseconds(median(compiled))} ms."
        )


def tables(results: Results) -> Iterator[Table]:
    """One table of all cells of both models."""
    rows: list[tuple[str, ...]] = []
    factors: list[tuple[float | None, ...]] = []
    for n in results.sizes():
        for score in SCORES:
            cells = [results.cell(model, score, n) for model in MODELS]
            clear = results.cell("numpy", score, n)
            if not any(cells):
                continue
            figures: list[str] = []
            for cell in cells:
                ours, floor = (None, None) if cell is None else (cell.median_ms, cell.floor_ms)
                figures += [milliseconds(ours), milliseconds(floor), times(above_socket(cell))]
                figures.append(times(above_clear(results, cell)))
                figures.append(milliseconds(None if cell is None else cell.ahead_ms))
            rows.append(
                (str(n), score, milliseconds(None if clear is None else clear.median_ms), *figures)
            )  # fmt: skip
            factors.append(
                tuple(one for cell in cells for one in (above_socket(cell), above_clear(results, cell)))
            )
    if not rows:
        return
    means = [times(mean_ratio(one)) for one in zip(*factors, strict=True)]
    rows.append(("", "mean", "", "", "", *means[:2], "", "", "", *means[2:], ""))
    yield Table(
        "Times above the floor",
        ("N", "ID", "ms", *("ms", "socket ms", "x socket", "x clear", "ahead ms") * len(MODELS)),
        rows,
        2,
        (("", 2), ("clear", 1), *((model, 5) for model in MODELS)),
        frozenset({len(rows) - 1}),
        (
            "Medians. socket: the same frames, in their sizes and order, over the same kind of socket in "
            "bare Python, with nothing computed. clear: the descriptors themselves are sent and compared by "
            "NumPy. x: ours by that. mean: geometric means. ahead: done before the inputs are known, in none "
            "of the other figures.",
        ),
    )
