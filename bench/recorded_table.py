"""What was printed and recorded of the paper's table, from ``recorded_table.json``.

Two parts, each with its source: the table as the paper prints it; and an earlier commit's jobs, many against
many. MP-SPDZ's own figures are in ``recorded.json``, its ratios to that commit in ``recorded_ratios.json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Printed:
    """One protocol's figures in a row of the paper.

    Attributes:
        mean: Of ten trials; ms, of the baseline us.
        std: Their standard deviation.
        comms: MB, of the baseline KB; what one party sent, as the recorded figures show.
        messages: As the paper counts them.
    """

    mean: float
    std: float
    comms: float
    messages: int


@dataclass(frozen=True, slots=True)
class PrintedRow:
    """One row of the paper's table.

    Attributes:
        n: Length of a descriptor.
        score: S1 to S10.
        name: The paper's name of the score.
        malicious: MASCOT.
        semi_honest: Hemi.
        baseline: C++, insecure.
    """

    n: int
    score: str
    name: str
    malicious: Printed
    semi_honest: Printed
    baseline: Printed

    def of(self, security: str) -> Printed:
        """The figures of a security model."""
        return self.malicious if security == "malicious" else self.semi_honest


@dataclass(frozen=True, slots=True)
class Jobs:
    """The earlier commit's jobs, many descriptors against many."""

    security: str
    n: int
    rows: int
    columns: int
    us_per_pair: float
    bytes_per_pair: float
    tape_bytes_per_pair: float


@dataclass(frozen=True, slots=True)
class RecordedTable:
    """All of it.

    Attributes:
        printed: The paper's rows, in its order.
        printed_how: Source and circumstances.
        base: The earlier commit.
        jobs: Its jobs, by security model.
        jobs_how: Source and circumstances.
    """

    printed: tuple[PrintedRow, ...]
    printed_how: str
    base: str
    jobs: dict[str, Jobs]
    jobs_how: str


@cache
def recorded_table() -> RecordedTable:
    """The recorded table."""
    data = json.loads(files("bench").joinpath("recorded_table.json").read_text(encoding="utf-8"))
    if data["format"] != FORMAT:
        raise ValueError(f"bench/recorded_table.json has format {data['format']}, expected {FORMAT}")
    printed, jobs = data["printed"], data["jobs"]
    return RecordedTable(
        tuple(map(_printed_row, printed["rows"])),
        f"{printed['source']}. {printed['how']}",
        jobs["base"],
        {row["security"]: Jobs(**row) for row in jobs["rows"]},
        jobs["how"],
    )


def _printed_row(row: dict[str, Any]) -> PrintedRow:
    def figures(protocol: str, unit: str) -> Printed:
        one = row[protocol]
        return Printed(one["mean"], one["std"], one[unit], one["messages"])

    return PrintedRow(
        row["n"],
        row["score"],
        row["name"],
        figures("mascot", "mb"),
        figures("hemi", "mb"),
        figures("baseline", "kb"),
    )
