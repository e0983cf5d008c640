"""The attacks' figures as tables: once, for the terminal and for the page."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bench.attacks.paths import LOCALISED
from bench.attacks.probes import COSINES, SLOTS, STRIKES, Curves, ProbeRow, median_curve, most_information
from bench.attacks.run import Findings
from protocols.check.percent import percent

WIDTH = 100
"""Columns that the text takes at most."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        head: Names of the columns; the first column is words, the others are numbers.
        rows: Cells.
        key: Of columns whose names do not say all: the name, and what is in the column.
        notes: Sentences below it.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    key: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()


def tables(found: Findings) -> Iterator[Table]:
    """All tables of what was run."""
    if found.paths:
        yield _paths(found)
    if found.scans is not None:
        yield _scans(found)
    if found.probes:
        yield _probes(found)
        yield _after(found)
        yield _matches(found)
    if found.refusals:
        yield _refusals(found)


def show(found: Findings) -> Iterator[str]:
    """The tables as lines of text, of at most WIDTH columns."""
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
        name_width = max((len(name) for name, _ in table.key), default=0)
        for name, meaning in table.key:
            yield from _wrapped(meaning, f"    {name.ljust(name_width)}  ")
        for note in table.notes:
            yield from _wrapped(note, "  ")


def _wrapped(text: str, first: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=" " * len(first))


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
            str(row.unseen_localised),
            _metres(row.unseen_median_m),
        )
        for row, _ in found.paths
    ]
    knows = {
        source: "; or ".join(dict.fromkeys(row.knows for row, _ in found.paths if row.source == source))
        for source in ("broadcast", "exchange")
    }
    return Table(
        f"Paths: where Alice's {first.keyframes} keyframes were taken",
        ("attack", "source", "claims", "found", "median", "mean", "new", "new median"),
        rows,
        (
            ("source", f"broadcast: {knows['broadcast']}. exchange: {knows['exchange']}"),
            (
                "the paper's",
                "places a keyframe at the mean of the scans, or keyframes, of Bob's that match it",
            ),
            ("claims", "keyframes that Bob gives a place for"),
            ("found", f"keyframes that he places within {LOCALISED:.0f} m of where they were taken"),
            ("median, mean", "errors of what he claims, in metres"),
            (
                "new",
                f"found of the {first.unseen} keyframes that are more than {LOCALISED:.0f} m from his own "
                "path; new median: the error of what he claims of these",
            ),
        ),
        (
            "Bob always has his own scans and knows where he took them, and how descriptors are made. With "
            "the exchange alone he knows nothing of a keyframe that matched none of his: between those that "
            "did he draws straight lines, also through walls.",
            "The bits of the exchange tell where both have been. That is what they are for, and Alice learns "
            "them as well. Of a broadcast she does not learn who listens, nor what he makes of it.",
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
            f"{row.overlap:.0%}",
            f"{row.correlation:.2f}",
            f"{row.overlap_unseen:.0%}",
        )
        for row in found.scans.rows
    ]
    return Table(
        "Scans: what Alice saw, rebuilt on cells of 0.5 m",
        ("attack", "source", "descriptors", "overlap", "correlation", "new overlap"),
        rows,
        (
            ("regression", "a ridge regression from the descriptor to the cells, fitted on Bob's own scans"),
            ("constant", "how often a cell is occupied in Bob's scans: the same guess for every keyframe"),
            ("overlap", "cells occupied in both, of those occupied in either; median over keyframes"),
            ("correlation", "of the guess with the cells; median over keyframes"),
            ("new overlap", f"of the keyframes that are more than {LOCALISED:.0f} m from Bob's own path"),
        ),
    )


def _probes(found: Findings) -> Table:
    def until(bits: int | None, curves: Curves) -> str:
        return f"> {len(median_curve(curves.probings)):,}" if bits is None else f"{bits:,}"

    rows = [
        (
            curves.row.descriptors,
            curves.row.prior,
            f"{curves.row.effective_dimension:,.0f}",
            f"{curves.row.cosine_before:.2f}" if curves.row.cosine_before else "-",
            *(
                until(bits, curves)
                for bits in (curves.row.bits_090, curves.row.bits_095, curves.row.bits_099)
            ),
            f"{curves.row.rule_090:,.0f}",
        )
        for curves in found.probes
    ]
    first = found.probes[0].row
    return Table(
        f"Probes: bits until a descriptor is guessed, by unit vectors; threshold {first.threshold:g}",
        ("descriptors", "known", "dimension", "start", *(f"to {one:.2f}" for one in COSINES), "by the rule"),
        rows,
        (
            ("known", "what the prober knows beforehand"),
            ("dimension", "effective dimension: in how many directions these descriptors differ"),
            ("start", "cosine of the best guess with the descriptor before any probe"),
            (
                "to 0.90",
                "bits, one a probe, until the best guess has that cosine; >: not after so many",
            ),
            (
                "by the rule",
                "bits to 0.90 by cos^2 = t^2 + 0.64 (1 - t^2) bits / d, with t the threshold, and d the "
                "effective dimension, or all numbers where nothing is known; about 28 bits go before it",
            ),
        ),
        (
            f"{_medians(first.targets)} Simulated, on quantised vectors and a resolution of 2^-16. The first "
            "match is not counted.",
        ),
    )


def _medians(targets: int) -> str:
    if targets == 1:
        return "One descriptor of Alice's was probed: a rough figure."
    return f"Medians over {targets} descriptors of Alice's."


def _after(found: Findings) -> Table:
    counts = sorted({bits for curves in found.probes for bits in curves.row.cosine_after})
    rows = [
        (
            row.descriptors,
            row.prior,
            *(f"{row.cosine_after[bits]:.2f}" if bits in row.cosine_after else "-" for bits in counts),
        )
        for row in (curves.row for curves in found.probes)
    ]
    return Table(
        "Cosine of the prober's best guess after so many bits",
        ("descriptors", "known", *(f"{bits:,}" for bits in counts)),
        rows,
    )


def _matches(found: Findings) -> Table:
    seen: dict[str, ProbeRow] = {}
    for curves in found.probes:
        seen.setdefault(curves.row.descriptors, curves.row)
    rows = [
        (
            row.descriptors,
            percent(row.equal),
            "-" if row.foreign is None else percent(row.foreign),
            percent(row.random),
            row.first,
            "-" if row.third_match is None else f"{row.third_match:.2f}",
        )
        for row in seen.values()
    ]
    bits = most_information(STRIKES, SLOTS)
    return Table(
        "The first match, and strikes",
        ("descriptors", "all-equal", "foreign", "random", "first match", "at the third"),
        rows,
        (
            ("all-equal", "how many of Alice's descriptors a vector of equal numbers matches"),
            ("foreign", "pairs of a public place, in any quarter turn, and a place of Alice's that match"),
            ("random", "the same with random unit vectors"),
            ("first match", "how this prober came by it"),
            ("at the third", "cosine that this prober has reached when its third probe matches"),
        ),
        (
            f"An agent (protocols.agent) stops with a peer at {STRIKES} strikes: matches that the peer does "
            "not follow with a keyframe that verifies. It looks at them between steps. A prober that brings "
            "one vector a step is stopped by its third match; however it chooses, the answers of "
            f"{SLOTS} slots with at most {STRIKES} matches tell at most {bits:.1f} bits about a descriptor "
            "(log2 of how many such answers there are). One step may bring many vectors, and opens a bit for "
            "each of its pairs, whatever matches: slots bound that, and a second's share of the budget.",
            f"What Alice shows is bounded throughout: at most {STRIKES} descriptors that the prober has no "
            "verified keyframe for, over all galleries and restarts, matches without a verdict included, "
            "until her user forgives.",
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
    errors = sorted({row.error for row in found.refusals if row.error})
    return Table(
        "The real protocol, malicious mode: what a modified robot brought",
        ("probe", "norm", "score", "outcome", "bits it got", "matches"),
        rows,
        (("outcome", "refused by name: Alice's robot named the slot and its owner, and compared nothing"),),
        [f"Alice's robot said: {error}." for error in errors],
    )
