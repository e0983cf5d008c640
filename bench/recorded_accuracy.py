"""Accuracy on inputs that another engine has computed, beside that engine's accuracy."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bench.exact import ONE, units
from bench.vectors import Record, load_vectors
from protocols.scores import SCORES
from spdz.console.progress import Report
from spdz.foundations.types import Security
from spdz.local import run_local


@dataclass(frozen=True, slots=True)
class RecordedRow:
    """Largest errors of one score over the recorded pairs, in units of 2^-16.

    ``ours`` is by security model. ``theirs`` is over all runs and protocols of the other engine.
    ``apart`` is the largest difference between a result of ours and one of theirs.
    """

    score: str
    engine: str
    version: str
    pairs: int
    outputs: int
    ours: dict[str, float]
    theirs: float
    apart: float


def compute(record: Record, security: Security) -> float:
    """Our score of a recorded pair, with the score's own largest norm."""
    x, y = (np.array(vector) / ONE for vector in (record.pair.x, record.pair.y))
    return float(run_local(SCORES[record.score], x, y, security).value)


def compare_with_recorded(
    path: Path, scores: Sequence[str], securities: Sequence[Security], report: Report
) -> Iterator[RecordedRow]:
    """Run our scores on the recorded pairs; those of which nothing was recorded are left out."""
    vectors = load_vectors(path)
    for done, score in enumerate(scores):
        report(done, len(scores))
        records = [r for r in vectors.records if (r.score, r.variant) == (score, "division")]
        if not records:
            continue
        one_a_pair = {record.pair: record for record in records}
        ours: dict[str, float] = {}
        apart = 0.0
        for security in securities:
            values = {pair: compute(record, security) for pair, record in one_a_pair.items()}
            ours[security] = max(units(values[pair], record.exact) for pair, record in one_a_pair.items())
            differences = (abs(values[r.pair] * ONE - value) for r in records for value in r.raw)
            apart = max(apart, *differences)
        outputs = sum(len(record.raw) for record in records)
        yield RecordedRow(
            score,
            vectors.engine,
            vectors.version,
            len(one_a_pair),
            outputs,
            {security: round(error, 4) for security, error in ours.items()},
            round(vectors.worst(score), 4),
            round(apart, 4),
        )


def print_recorded(rows: Sequence[RecordedRow], *, as_json: bool) -> None:
    """A Markdown table, or one JSON object a line."""
    if as_json:
        for row in rows:
            print(json.dumps(asdict(row)))
        return
    if not rows:
        print("nothing was recorded for these scores")
        return
    first = rows[0]
    print(f"Largest error on {first.pairs} recorded pairs, in units of 2^-16.")
    print(f"Recorded: {first.engine} {first.version}.\n")
    header = ["score", *(f"ours, {security}" for security in first.ours), first.engine, "apart"]
    print("| " + " | ".join(header) + " |\n|" + "---|" * len(header))
    for row in rows:
        shown = [row.score, *(f"{error:.2f}" for error in row.ours.values())]
        print("| " + " | ".join([*shown, f"{row.theirs:.2f}", f"{row.apart:.2f}"]) + " |")
