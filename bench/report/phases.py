"""Where the time goes: mask, network, field, AES, MAC check, and what none of them is."""

from __future__ import annotations

from collections.abc import Iterator

from bench.report.cells import MODELS, Cell
from bench.report.folder import Results
from bench.report.table import Table, milliseconds
from bench.sweep.phases import PHASES
from protocols.scores import SCORES

NAMES = {**dict(zip(PHASES, PHASES, strict=True)), "aes": "AES", "mac_check": "MAC check"}


def parts(cell: Cell | None) -> dict[str, float] | None:
    """Milliseconds by phase of the profiled trial; None where none was profiled, or nothing was found."""
    if cell is None or cell.profiled is None or cell.profiled.phases is None:
        return None
    found = {NAMES[name]: cell.profiled.phases[name] for name in PHASES}
    return found if sum(found.values()) else None


def tables(results: Results) -> Iterator[Table]:
    """A table a security model of all cells that were profiled."""
    for model in MODELS:
        rows = []
        for n in results.sizes():
            for score in SCORES:
                found = parts(results.cell(model, score, n))
                if found is not None:
                    times = (sum(found.values()), *found.values())
                    rows.append((str(n), score, *map(milliseconds, times)))
        if rows:
            yield Table(
                f"Where the time goes, {model} [ms]",
                ("N", "ID", "whole", *NAMES.values()),
                rows,
                2,
                notes=(
                    "One trial more a cell, under a profiler, its shares taken of the median time. It slows "
                    "short functions down more than long ones: shares are rough. network: sending, and "
                    "waiting for the other party. rest: reading the program, agreeing, bookkeeping.",
                ),
                folded=True,
            )
