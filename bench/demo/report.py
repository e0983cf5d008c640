"""The demo's report for a person: found, merged, cost, leaked."""

from __future__ import annotations

from rich import table
from rich.console import Console

from bench.demo.result import Report
from bench.demo.tables import tables


def show(report: Report, width: int) -> None:
    """Print the report to standard output."""
    console = Console(width=max(80, min(width, 110)), highlight=False)
    console.print()
    for shown in tables(report):
        drawn = table.Table(title=shown.title, title_justify="left")
        for name in shown.columns:
            drawn.add_column(name, justify="right" if name and shown.numbers else "left")
        for row in shown.rows:
            drawn.add_row(*row)
        console.print(drawn)
    console.print(f"\nthe story, with both maps and the merged one: [bold]{report.page}[/bold]")
    console.print(f"and in the same folder: {', '.join(report.files)}")
