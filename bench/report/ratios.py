"""Ratios to MP-SPDZ: of what was recorded, of what the paper prints, and of one machine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bench.recorded_ratios import recorded_ratios
from bench.recorded_table import recorded_table
from bench.report.cells import MODELS, Cell
from bench.report.folder import Results, VersusRow
from bench.report.paper import ENGINE, recorded_mp_spdz
from bench.report.table import Table, mean_ratio, milliseconds, ratio, times, whole

STRICTER = (
    f"{ENGINE}'s recorded time by our ms and ahead ms together. It is the stricter ratio: all that we do "
    "once the tapes are there is on our side of it but compiling, once a session, which neither side's time "
    f"has. {ENGINE} was recorded reading its preprocessing from files. A cell has few jobs, so that a "
    "disk's sync, one for all of them, can be most of ahead: of hundreds reserved at once it is little."
)
"""What the second ratio of times is."""


@dataclass(frozen=True, slots=True)
class Beside:
    """Our cell beside MP-SPDZ's recorded one and the paper's printed one: times ours, or None.

    Attributes:
        cell: Ours.
        ms: MP-SPDZ's recorded median by our median.
        with_ahead: The same by our median with what is done ahead: stricter.
        sent: Its bytes a party by ours.
        rounds: Its rounds by ours.
        printed_ms: The paper's mean by our mean.
        printed_mb: The paper's MB by ours, of one party.
    """

    cell: Cell
    ms: float | None
    with_ahead: float | None
    sent: float | None
    rounds: float | None
    printed_ms: float | None
    printed_mb: float | None


@dataclass(frozen=True, slots=True)
class Product:
    """The ratio to MP-SPDZ on one machine.

    Attributes:
        row: This tree against the earlier commit, in one run.
        before: MP-SPDZ against that commit, in one run.
        ratio: The product: MP-SPDZ's time by this tree's.
    """

    row: VersusRow
    before: float
    ratio: float


def besides(results: Results, model: str) -> list[Beside]:
    """Every cell of a security model that has a counterpart, by length and score."""
    printed = {(row.score, row.n): row.of(model) for row in recorded_table().printed}
    found = []
    for cell in _cells(results, model):
        one = recorded_mp_spdz(cell.score, cell.n, model)
        paper = printed.get((cell.score, cell.n))
        if one is None and paper is None:
            continue
        found.append(
            Beside(
                cell,
                None if one is None else ratio(one.ms, cell.median_ms),
                None if one is None else ratio(one.ms, cell.whole_ms),
                None if one is None else ratio(one.bytes_sent, cell.bytes_party),
                None if one is None else ratio(one.rounds, cell.rounds),
                None if paper is None else ratio(paper.mean, cell.mean_ms),
                None if paper is None else ratio(paper.comms * 1e6, cell.bytes_party),
            )
        )
    return found


def _cells(results: Results, model: str) -> list[Cell]:
    """The cells of a model by length, then by score."""
    found = [cell for cell in results.cells.values() if cell.protocol == model]
    return sorted(found, key=lambda cell: (cell.n, int(cell.score[1:])))


def products(results: Results, model: str) -> list[Product]:
    """The cells that both runs have; none where the earlier commit is another than the recorded one."""
    if not same_base(results):
        return []
    found = []
    for row in sorted(results.versus, key=lambda row: (row.n, int(row.score[1:]))):
        before = recorded_ratios().ratios.get((row.score, row.n, row.security))
        if before is not None and row.security == model:
            found.append(Product(row, before, before * row.speedup))
    return found


def same_base(results: Results) -> bool:
    """Whether ``versus.json`` compares with the commit that was measured beside MP-SPDZ."""
    named = results.versus_base
    return named is not None and len(named) >= 7 and recorded_ratios().base.startswith(named)


def tables(results: Results) -> Iterator[Table]:
    """A table a security model, then the product."""
    for model in MODELS:
        found = besides(results, model)
        if found:
            yield _beside(model, found)
    if any(products(results, model) for model in MODELS):
        yield _products(results)


def _beside(model: str, found: list[Beside]) -> Table:
    rows: list[tuple[str, ...]] = []
    for one in found:
        theirs = recorded_mp_spdz(one.cell.score, one.cell.n, model)
        rows.append(
            (
                str(one.cell.n),
                one.cell.score,
                milliseconds(one.cell.median_ms),
                milliseconds(one.cell.ahead_ms),
                whole(one.cell.bytes_party),
                whole(one.cell.rounds),
                milliseconds(None if theirs is None else theirs.ms),
                times(one.ms),
                times(one.with_ahead),
                whole(None if theirs is None else theirs.bytes_sent),
                times(one.sent),
                whole(None if theirs is None else theirs.rounds),
                times(one.rounds),
                times(one.printed_ms),
                times(one.printed_mb),
            )
        )
    means = [mean_ratio(one) for one in zip(*map(_factors, found), strict=True)]
    ms, strict, sent, rounds, printed_ms, printed_mb = map(times, means)
    rows.append(("", "mean", *[""] * 5, ms, strict, "", sent, "", rounds, printed_ms, printed_mb))
    return Table(
        f"How many times ours, {model}",
        (
            *("N", "ID", "ms", "ahead ms", "B", "rounds"),
            *("ms", "x", "x with ahead", "B", "x", "rounds", "x", "t x", "MB x"),
        ),
        rows,
        2,
        (("", 2), ("ours", 4), (f"{ENGINE}, recorded", 7), ("paper, printed", 2)),
        frozenset({len(rows) - 1}),
        (
            "x: theirs by ours; above 1, ours is less. Medians by medians of what was recorded, means by "
            "means of what is printed, whose MB have three decimals: rough below 0.01. B is what one party "
            "sends. The last row has geometric means.",
            f"x with ahead: {STRICTER}",
            "Their times are of other machines: x of a time is rough. A round of ours is one exchange; "
            f"{ENGINE} counts calls to send, receive or broadcast.",
        ),
    )


def _factors(one: Beside) -> tuple[float | None, ...]:
    return one.ms, one.with_ahead, one.sent, one.rounds, one.printed_ms, one.printed_mb


def _products(results: Results) -> Table:
    rows: list[tuple[str, ...]] = []
    strong = set()
    base = recorded_ratios().base[:7]
    for model in MODELS:
        found = products(results, model)
        for one in found:
            row = one.row
            before, speedup, product = times(one.before), times(row.speedup), times(one.ratio)
            rows.append((str(row.n), row.score, model, before, speedup, product))
        if found:
            strong.add(len(rows))
            means = [
                mean_ratio(one.before for one in found),
                mean_ratio(one.row.speedup for one in found),
                mean_ratio(one.ratio for one in found),
            ]
            rows.append(("", "mean", model, *map(times, means)))
    return Table(
        f"{ENGINE}'s time by ours, each factor within one run on one machine",
        ("N", "ID", "security", f"{ENGINE} by {base}", f"{base} by ours", "product"),
        rows,
        3,
        strong=frozenset(strong),
        notes=(
            f"{ENGINE} by {base}: {recorded_ratios().how}",
            f"{base} by ours: `python -m bench versus {base}`, this tree against that commit, in turn, cell "
            f"by cell. {smallest(results)} mean: geometric means.",
        ),
    )


def smallest(results: Results) -> str:
    """A sentence on the cell with the smallest product; nothing without any."""
    found = [one for model in MODELS for one in products(results, model)]
    if not found:
        return ""
    least = min(found, key=lambda one: one.ratio)
    row = least.row
    return f"The smallest product is {times(least.ratio)}, of {row.score} at N = {row.n}, {row.security}."
