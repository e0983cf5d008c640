"""What was printed and recorded of the paper's table, from ``recorded_table.json``.

Three parts, each with its source: the table as the paper prints it; MP-SPDZ beside an earlier commit of this
project, cell by cell in one run; the same commit's jobs, many against many.
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
class SideBySide:
    """MP-SPDZ and an earlier commit of this project, measured in turn.

    Attributes:
        ratio: MP-SPDZ's time over that commit's, the median of ``len(ours_ms)`` repetitions.
        mp_spdz_ms: Its medians.
        ours_ms: That commit's.
        mp_spdz_bytes: What a party sent.
        mp_spdz_rounds: Calls to send, receive or broadcast.
    """

    score: str
    n: int
    security: str
    ratio: float
    mp_spdz_ms: tuple[float, ...]
    ours_ms: tuple[float, ...]
    mp_spdz_bytes: int
    mp_spdz_rounds: int


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
        side_by_side: By score, length and security model.
        side_by_side_how: Source and circumstances.
        jobs: By security model.
        jobs_how: Source and circumstances.
    """

    printed: tuple[PrintedRow, ...]
    printed_how: str
    base: str
    side_by_side: dict[tuple[str, int, str], SideBySide]
    side_by_side_how: str
    jobs: dict[str, Jobs]
    jobs_how: str


@cache
def recorded_table() -> RecordedTable:
    """The recorded table."""
    data = json.loads(files("bench").joinpath("recorded_table.json").read_text(encoding="utf-8"))
    if data["format"] != FORMAT:
        raise ValueError(f"bench/recorded_table.json has format {data['format']}, expected {FORMAT}")
    printed, side, jobs = data["printed"], data["side_by_side"], data["jobs"]
    return RecordedTable(
        tuple(map(_printed_row, printed["rows"])),
        f"{printed['source']}. {printed['how']}",
        side["base"],
        {(row["score"], row["n"], row["security"]): _side_row(row) for row in side["rows"]},
        f"{side['source']}. {side['how']}",
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


def _side_row(row: dict[str, Any]) -> SideBySide:
    return SideBySide(
        row["score"],
        row["n"],
        row["security"],
        row["ratio"],
        tuple(row["mp_spdz_ms"]),
        tuple(row["ours_ms"]),
        row["mp_spdz_bytes"],
        row["mp_spdz_rounds"],
    )
