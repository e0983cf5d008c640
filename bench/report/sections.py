"""The report as sections: words, plots and tables, in one order for the page and for Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from bench.report import floor, gallery, paper, phases, plots, ratios
from bench.report.cells import MODELS
from bench.report.folder import Results
from bench.report.gaps import gap_words, product_words, run_words
from bench.report.plots import Plot
from bench.report.standing import paragraphs
from bench.report.table import Table, mean_ratio, times

_PREFERRED = 1536
"""The length of plots that show one: the paper's own descriptors."""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the report.

    Attributes:
        title: Its heading.
        words: Paragraphs at its beginning.
        plots: Before the tables.
        tables: After the plots.
    """

    title: str
    words: Sequence[str]
    plots: Sequence[Plot] = field(default=(), repr=False)
    tables: Sequence[Table] = ()


def sections(results: Results) -> Iterator[Section]:
    """All sections of a results folder."""
    yield Section("In short", [run_words(results), *gap_words(results)], tables=list(_summary(results)))
    yield Section("Which model stands for which protocol", list(paragraphs()))
    yield Section(
        "The paper's table",
        ["The rows that the paper prints; all that was run is folded below them."],
        tables=list(paper.tables(results)),
    )
    yield Section(
        "Times and bytes against N",
        [],
        [*plots.over_lengths(results, "time"), *plots.over_lengths(results, "bytes")],
    )
    yield Section(
        f"Ratios to {paper.ENGINE}", list(product_words(results)), tables=list(ratios.tables(results))
    )
    yield from _floor(results)
    yield from _phases(results)
    yield from _tape(results)
    yield _batches(results)


def mean_factors(results: Results, model: str) -> dict[str, float | None]:
    """Geometric means of a security model: MP-SPDZ's by ours, and ours above the floor."""
    found = ratios.besides(results, model)
    cells = [cell for cell in results.cells.values() if cell.protocol == model]
    machine = [one.ratio for one in ratios.products(results, model)]
    return {
        "time": mean_ratio(one.ms for one in found),
        "time_with_ahead": mean_ratio(one.with_ahead for one in found),
        "bytes": mean_ratio(one.sent for one in found),
        "rounds": mean_ratio(one.rounds for one in found),
        "one_machine": mean_ratio(machine),
        "one_machine_smallest": min(machine, default=None),
        "above_socket": mean_ratio(floor.above_socket(cell) for cell in cells),
        "above_clear": mean_ratio(floor.above_clear(results, cell) for cell in cells),
    }


def _summary(results: Results) -> Iterator[Table]:
    rows = []
    for model in MODELS:
        found = mean_factors(results, model)
        if any(one is not None for one in found.values()):
            rows.append((model, *map(times, found.values())))
    if rows:
        yield Table(
            "Geometric means",
            (
                *("security", "time", "time with ahead", "bytes", "rounds"),
                *("time, one machine", "smallest", "x socket", "x clear"),
            ),
            rows,
            1,
            (("", 1), (f"{paper.ENGINE}'s by ours", 6), ("ours above the floor", 2)),
            notes=(
                "time, bytes, rounds: against what was recorded on another machine. time with ahead, the "
                "stricter: our time and what is done ahead, together. time, one machine, and its "
                "smallest cell: see the ratios below. x socket, x clear: our time by that of the same "
                "frames over a bare socket, and by that of the exchange in the clear.",
            ),
        )


def _floor(results: Results) -> Iterator[Section]:
    tables = list(floor.tables(results))
    if tables:
        n = _one_length(results)
        words = [
            "How far each time is from what the network alone takes, and from no security at all.",
            *floor.ahead_words(results),
        ]
        yield Section("The floor", words, list(plots.security_against_time(results, n)), tables)


def _phases(results: Results) -> Iterator[Section]:
    tables = list(phases.tables(results))
    words = [] if tables else ["No cell was profiled."]
    drawn = list(plots.where_time_goes(results, _one_length(results))) if tables else []
    yield Section("Where the time goes", words, drawn, tables)


def _tape(results: Results) -> Iterator[Section]:
    drawn = list(plots.tape_against_sent(results))
    if drawn:
        words = ["What a party stores for a comparison before the mission, against what it sends in it."]
        yield Section("Tape against online bytes", words, drawn)


def _batches(results: Results) -> Section:
    tables = list(gallery.tables(results))
    command = "python -m bench gallery --security malicious semi-honest --compare --json > gallery.jsonl"
    words = [] if tables else [f"Not measured: run `{command}` in this folder."]
    return Section("Galleries beside batched engines", words, tables=tables)


def _one_length(results: Results) -> int:
    """The length that single-length plots show: the preferred one, or the one with the most cells."""
    counts = Counter(n for protocol, _, n in results.cells if protocol in MODELS)
    return _PREFERRED if _PREFERRED in counts else max(counts or {0: 0}, key=lambda n: (counts[n], n))
