"""The demo's report for a person: found, cost, leaked."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from bench.demo.places import DIFFERENT, SAME, Quality
from bench.demo.run import Report


def show(report: Report, width: int) -> None:
    """Print the report to standard output."""
    console = Console(width=max(80, min(width, 110)), highlight=False)
    console.print()
    console.print(_found(report))
    console.print(_cost(report))
    console.print(_leaked(report))
    console.print(f"\nmap of both paths and the private matches: [bold]{report.picture}[/bold]")


def _found(report: Report) -> Table:
    alice, bob = report.keyframes
    table = Table(
        title=f"Found: {alice} x {bob} keyframes, {report.dimension}-D Scan Context", title_justify="left"
    )
    for name in ("", "private", "in the clear"):
        table.add_column(name, justify="left" if not name else "right")
    private, clear = report.private_quality, report.clear_quality
    table.add_row("pairs compared", f"{report.pairs:,}", f"{report.pairs:,}")
    table.add_row(
        f"candidates (score >= {report.threshold})", f"{report.candidates:,}", f"{report.clear_candidates:,}"
    )
    table.add_row("same place by the pose graph", _places(private), _places(clear))
    between = f"{SAME:.0f} to {DIFFERENT:.0f} m apart, not counted"
    table.add_row(between, _neither(report.candidates, private), _neither(report.clear_candidates, clear))
    table.add_row("another place", str(private.false_positives), str(clear.false_positives))
    table.add_row("precision", f"{private.precision:.2f}", f"{clear.precision:.2f}")
    table.add_row("recall", f"{private.recall:.2f}", f"{clear.recall:.2f}")
    table.add_row("decisions that differ by more than the resolution", str(report.disagreements), "")
    return table


def _places(quality: Quality) -> str:
    return str(quality.true_positives)


def _neither(candidates: int, quality: Quality) -> str:
    return str(candidates - quality.true_positives - quality.false_positives)


def _cost(report: Report) -> Table:
    table = Table(title=f"Cost: two processes, TLS on loopback, {report.security}", title_justify="left")
    for name in ("", "private", "descriptors in the clear"):
        table.add_column(name, justify="left" if not name else "right")
    slots = report.dealt_slots
    sent, clear = sum(report.bytes_sent), sum(report.clear_bytes)
    table.add_row("sent by both, in all", f"{sent / 1e6:.2f} MB", f"{clear / 1e6:.2f} MB (float64)")
    table.add_row("sent, a pair", f"{sent / report.pairs:,.0f} B", f"{clear / report.pairs:,.0f} B")
    table.add_row("rounds", str(report.rounds), "1")
    table.add_row("time in all", f"{report.milliseconds:,.0f} ms", f"{report.clear_milliseconds:,.1f} ms")
    table.add_row(
        "time, a pair",
        f"{report.milliseconds / report.pairs:.3f} ms",
        f"{report.clear_milliseconds / report.pairs:.6f} ms",
    )
    table.add_row("dealt before the mission", f"a gallery of {slots[0]} x {slots[1]}", "-")
    table.add_row("  in", f"{report.dealing_seconds:.1f} s", "-")
    table.add_row("  a robot's folder", f"{max(report.folder_bytes) / 1e6:.1f} MB", "-")
    return table


def _leaked(report: Report) -> Table:
    alice, bob = report.keyframes
    table = Table(title="Learned by a robot about the other", title_justify="left")
    table.add_column("")
    table.add_column("private")
    table.add_column("descriptors in the clear")
    table.add_row("number of keyframes", f"yes ({alice}, {bob})", "yes")
    table.add_row("which pairs match", f"yes ({report.candidates} of {report.pairs:,})", "yes")
    table.add_row("how alike a pair is", "no", "yes")
    proved = "at most 1, as was proved" if report.security == "malicious" else "no"
    table.add_row("a vector's norm", proved, "yes")
    table.add_row("a descriptor, hence images and paths", "no", f"yes, all {report.dimension} numbers")
    return table
