"""Where the time goes: mask, network, field, AES, MAC check, and what none of them covers."""

from __future__ import annotations

from collections.abc import Iterator

from bench.report.cells import MODELS, PHASES, Cell
from bench.report.folder import Results
from bench.report.table import Table, milliseconds
from protocols.scores import SCORES

NAMES = {"mask": "mask", "network": "network", "field": "field", "aes": "AES", "mac_check": "MAC check"}
REST = "rest"


def parts(cell: Cell | None) -> dict[str, float] | None:
    """Milliseconds by phase of the profiled trial, the rest last; None where none was profiled."""
    if cell is None or cell.profiled is None or cell.profiled.phases is None:
        return None
    found = {NAMES[name]: cell.profiled.phases[name] for name in PHASES}
    return {**found, REST: max(cell.profiled.ms - sum(found.values()), 0.0)}


def tables(results: Results) -> Iterator[Table]:
    """A table a security model of all cells that were profiled."""
    for model in MODELS:
        rows = []
        for n in results.sizes():
            for score in SCORES:
                cell = results.cell(model, score, n)
                found = parts(cell)
                if cell is not None and cell.profiled is not None and found is not None:
                    figures = [milliseconds(one) for one in found.values()]
                    rows.append((str(n), score, milliseconds(cell.profiled.ms), *figures))
        if rows:
            yield Table(
                f"Where the time goes, {model} [ms]",
                ("N", "ID", "whole", *NAMES.values(), REST),
                rows,
                2,
                notes=(
                    "One trial more a cell, under a profiler that slows it down: shares are worth more than "
                    "milliseconds. network: sending, and waiting for the other party.",
                ),
                folded=True,
            )
