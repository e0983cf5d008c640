"""Recorded figures of other engines that compare many with many, from ``recorded_batch.json``.

They come from other machines than the one that measures, some from two shared virtual cores, one from a
paper: bytes compare exactly, times roughly. ``how`` says what each engine gives up that ours does not.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any

FORMAT = 1


@dataclass(frozen=True, slots=True)
class RecordedBatch:
    """One engine's recorded figures.

    Attributes:
        engine: Name and version.
        protocol: The engine's protocol.
        security: The security model.
        n: Length of a descriptor.
        rows: Descriptors of one side; None if it was not printed.
        columns: Of the other.
        us_per_pair: Microseconds a pair.
        bytes_per_pair: What a party sent; None if it was not printed.
        us_per_pair_one_row: Microseconds a pair of one descriptor against 4,096; None if it was not measured.
        machine: What it ran on.
        how: How it was measured.
    """

    engine: str
    protocol: str
    security: str
    n: int
    rows: int | None
    columns: int | None
    us_per_pair: float
    bytes_per_pair: float | None
    us_per_pair_one_row: float | None
    machine: str
    how: str

    def beside(self, us_per_pair: float, bytes_per_pair: float) -> dict[str, Any]:
        """The figures, and how many times ours they are: above 1, ours is less."""
        factor = None if self.bytes_per_pair is None else round(self.bytes_per_pair / bytes_per_pair, 1)
        return {
            **asdict(self),
            "time_factor": round(self.us_per_pair / us_per_pair, 1),
            "bytes_factor": factor,
        }


@cache
def recorded_batches() -> tuple[RecordedBatch, ...]:
    """All that was recorded."""
    data = json.loads(files("bench").joinpath("recorded_batch.json").read_text(encoding="utf-8"))
    if data["format"] != FORMAT:
        raise ValueError(f"bench/recorded_batch.json has format {data['format']}, expected {FORMAT}")
    return tuple(RecordedBatch(**row) for row in data["rows"])
