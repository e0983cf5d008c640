"""Many against many: our galleries beside engines that compare in batches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bench.recorded_batch import RecordedBatch, recorded_batches
from bench.recorded_table import recorded_table
from bench.report.folder import Results
from bench.report.table import NOTHING, Table, times, whole


def tables(results: Results) -> Iterator[Table]:
    """One table of all galleries that were measured."""
    rows: list[tuple[str, ...]] = []
    strong = set()
    for found in results.galleries:
        if "pairs_per_s" in found:
            strong.add(len(rows))
            rows += _rows(found)
    if not rows:
        return
    engines = dict.fromkeys(f"{one.engine}, {one.protocol}: {one.how}" for one in recorded_batches())
    yield Table(
        "Pairs in batches",
        ("engine", "security", "N", "pairs", "us a pair", "pairs/s", "B a pair", "t x", "B x"),
        rows,
        2,
        strong=frozenset(strong),
        notes=(
            "Bits alone are opened. x: theirs by ours in the same security model; above 1, ours is less. B "
            "is what a party sends. Theirs were recorded on other machines: bytes compare exactly, times "
            "roughly. A gallery's masked descriptors stand already; what a descriptor costs is not in these "
            "rows.",
            f"Jobs at {recorded_table().base}: {recorded_table().jobs_how}",
            *engines,
        ),
    )


def _rows(found: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    us, sent, security = 1e6 / found["pairs_per_s"], found["bytes_per_pair"], found["security"]
    name = f"ours, gallery, {found.get('resolution', '')}".rstrip(", ")
    yield _row(name, security, found["n"], _pairs(found["rows"], found["columns"]), us, sent)
    tiles = found.get("tiles")
    if tiles:
        tile, theirs = _pairs(*tiles["tile"]), 1e6 / tiles["pairs_per_s"]
        yield _row(
            "ours, jobs, same run", security, found["n"], tile, theirs, tiles["bytes_per_pair"], us, sent
        )
    jobs = recorded_table().jobs.get(security)
    if jobs is not None and jobs.n == found["n"]:
        name, pairs = f"ours, jobs at {recorded_table().base}", _pairs(jobs.rows, jobs.columns)
        yield _row(name, security, jobs.n, pairs, jobs.us_per_pair, jobs.bytes_per_pair, us, sent)
    for one in recorded_batches():
        if one.security == security and (one.n == found["n"] or one.rows is None):
            yield _peer(one, us, sent)


def _peer(one: RecordedBatch, us: float, sent: float) -> tuple[str, ...]:
    name = f"{one.engine}, {one.protocol}"
    pairs = _pairs(one.rows, one.columns)
    return _row(name, one.security, one.n, pairs, one.us_per_pair, one.bytes_per_pair, us, sent)


def _pairs(rows: int | None, columns: int | None) -> str:
    return NOTHING if rows is None else f"{rows} x {columns}"


def _row(
    name: str,
    security: str,
    n: int,
    pairs: str,
    us: float,
    sent: float | None,
    our_us: float | None = None,
    our_sent: float | None = None,
) -> tuple[str, ...]:
    """One row; without ours to compare with, it is ours."""
    per_pair = f"{us:,.2f}"
    bytes_of = NOTHING if sent is None else f"{sent:,.2f}".rstrip("0").rstrip(".")
    time_factor = times(None if our_us is None else us / our_us)
    bytes_factor = times(None if our_sent is None or sent is None else sent / our_sent)
    return (name, security, str(n), pairs, per_pair, whole(1e6 / us), bytes_of, time_factor, bytes_factor)
