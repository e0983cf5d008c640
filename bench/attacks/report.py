"""The attacks' figures as tables: once, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bench.attacks.probes import COSINES, SLOTS, STRIKES, ProbeRow, most_information
from bench.attacks.run import Findings


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        head: Names of the columns; the first column is words, the others are numbers.
        rows: Cells.
        notes: Sentences below it.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]


def tables(found: Findings) -> Iterator[Table]:
    """All tables of what was run."""
    if found.paths:
        yield _paths(found)
    if found.scans is not None:
        yield _scans(found)
    if found.probes:
        yield _probes(found)
        yield _matches(found)
    if found.refusals:
        yield _refusals(found)


def show(found: Findings) -> Iterator[str]:
    """The tables as lines of text."""
    for table in tables(found):
        widths = [max(map(len, column)) for column in zip(table.head, *table.rows, strict=True)]
        yield ""
        yield table.title
        for cells in (table.head, *table.rows):
            first, *rest = (
                cell.ljust(width) if not at else cell.rjust(width)
                for at, (cell, width) in enumerate(zip(cells, widths, strict=True))
            )
            yield "  ".join(["", first, *rest]).rstrip()
        for note in table.notes:
            yield f"  {note}"


def _paths(found: Findings) -> Table:
    first = found.paths[0][0]
    rows = [
        (
            row.attack,
            row.source,
            str(row.claimed),
            f"{row.localised} ({row.share:.0%})",
            _metres(row.median_m),
            _metres(row.mean_m),
            f"{row.unseen_localised} of {row.unseen}",
            _metres(row.unseen_median_m),
        )
        for row, _ in found.paths
    ]
    sources = {row.source: row.knows for row, _ in found.paths if row.source != "nothing"}
    return Table(
        f"Paths: where Alice's {first.keyframes} keyframes were taken",
        ("attack", "fed with", "claimed", "within 4 m", "median m", "mean m", "Bob never there", "median m"),
        rows,
        (
            f"broadcast: Bob has {sources['broadcast']}; the exchange: {sources['exchange']}.",
            "always: his own scans and where he took them, and how descriptors are made. Errors are of what "
            "is claimed. Bob never there: keyframes more than 4 m from his own path.",
            "bits of the exchange tell where both have been, by design, and Alice learns them as well; who "
            "makes what of a broadcast nobody knows.",
        ),
    )


def _metres(error: float | None) -> str:
    return "-" if error is None else f"{error:.1f}"


def _scans(found: Findings) -> Table:
    assert found.scans is not None
    rows = [
        (
            row.attack,
            row.source,
            f"{row.fed} of {row.keyframes}",
            f"{row.overlap:.2f}",
            f"{row.correlation:.2f}",
            f"{row.overlap_unseen:.2f}",
        )
        for row in found.scans.rows
    ]
    return Table(
        "Scans: what Alice saw, rebuilt on cells of 0.5 m",
        ("attack", "fed with", "descriptors", "overlap", "correlation", "overlap, Bob never there"),
        rows,
        ("overlap: intersection over union of occupied cells; medians over Alice's keyframes.",),
    )


def _probes(found: Findings) -> Table:
    def until(bits: int | None) -> str:
        return "more" if bits is None else f"{bits:,}"

    rows = [
        (
            row.descriptors,
            row.prior,
            f"{row.effective_dimension:,.0f}",
            f"{row.cosine_before:.2f}",
            *(until(bits) for bits in (row.bits_090, row.bits_095, row.bits_099)),
            f"{row.rule_090:,.0f}",
            _after(row),
        )
        for row in (curves.row for curves in found.probes)
    ]
    threshold = found.probes[0].row.threshold
    return Table(
        f"Probes: bits that unit vectors need, adaptive, threshold {threshold:g}",
        (
            "descriptors",
            "known",
            "eff. dim.",
            "before",
            *(f"to {cosine:.2f}" for cosine in COSINES),
            "rule 0.90",
            "cosine after bits",
        ),
        rows,
        (
            f"medians over {found.probes[0].row.targets} descriptors of Alice's; simulated, on quantised "
            "vectors and a resolution of 2^-16. before: of the best guess without a probe.",
            "rule: cos^2 = t^2 + 0.64 (1 - t^2) bits / d, d the effective dimension, or all numbers where "
            "nothing is known; some 28 bits go before it.",
        ),
    )


def _after(row: ProbeRow) -> str:
    return ", ".join(f"{bits}: {cosine:.2f}" for bits, cosine in row.cosine_after.items())


def _matches(found: Findings) -> Table:
    seen: dict[str, ProbeRow] = {}
    for curves in found.probes:
        seen.setdefault(curves.row.descriptors, curves.row)
    rows = [
        (
            row.descriptors,
            f"{row.equal:.0%}",
            "-" if row.foreign is None else f"{row.foreign:.2g}",
            f"{row.random:.2g}",
            row.first,
            "-" if row.third_match is None else f"{row.third_match:.2f}",
        )
        for row in seen.values()
    ]
    bits = most_information(STRIKES, SLOTS)
    return Table(
        "The first match, and strikes",
        ("descriptors", "all-equal", "foreign", "random", "first match of the prober", "at third match"),
        rows,
        (
            f"shares that match. {STRIKES} strikes in {SLOTS} slots leave at most {bits:.1f} bits about a "
            "descriptor: log2 of the answers that there can be.",
            "at third match: the cosine that this prober has then. A match also reveals the descriptor that "
            f"it was with: at most {STRIKES} of those, if no more are ever outstanding.",
        ),
    )


def _refusals(found: Findings) -> Table:
    rows = [
        (
            row.probe,
            f"{row.norm:g}",
            row.score,
            "refused by name" if row.refused and row.names else "refused" if row.refused else "compared",
            str(row.bits),
            str(row.matches),
        )
        for row in found.refusals
    ]
    return Table(
        "The real protocol: what a modified robot brought, malicious mode",
        ("probe", "norm", "score", "outcome", "bits it got", "matches"),
        rows,
        tuple(sorted({row.error for row in found.refusals if row.error})),
    )
