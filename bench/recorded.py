"""Recorded figures of compiled engines, from ``recorded.json``, to print beside a measurement.

They come from another machine than the one that measures: bytes and rounds compare exactly, times roughly.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Recorded:
    """One engine's recorded figures for a score.

    Attributes:
        engine: Name and version.
        protocol: The engine's protocol.
        ms: Median milliseconds of a warm comparison, input, opening, and check included.
        bytes_sent: What a party sent.
        rounds: As that engine counts them; None if it was not counted.
        how: How and on what machine it was measured.
    """

    engine: str
    protocol: str
    ms: float
    bytes_sent: int
    rounds: int | None
    how: str

    def beside(self, ms: float, bytes_sent: int, rounds: int) -> dict[str, str | float | None]:
        """The figures, and how many times ours they are: above 1, ours is less."""
        return {
            "engine": self.engine,
            "protocol": self.protocol,
            "ms": self.ms,
            "bytes_sent": self.bytes_sent,
            "rounds": self.rounds,
            "ms_factor": round(self.ms / ms, 2),
            "bytes_factor": round(self.bytes_sent / bytes_sent, 2),
            "rounds_factor": None if self.rounds is None else round(self.rounds / rounds, 2),
        }


@cache
def _figures() -> dict[tuple[str, int, str], list[Recorded]]:
    """By score, length, and security: each engine's quickest protocol."""
    data = json.loads(files("bench").joinpath("recorded.json").read_text(encoding="utf-8"))
    if data["format"] != FORMAT:
        raise ValueError(f"bench/recorded.json has format {data['format']}, expected {FORMAT}")
    quickest: dict[tuple[str, int, str], dict[str, Recorded]] = {}
    for row in sorted(data["rows"], key=lambda row: -row["ms"]):
        about = data["engines"][row["engine"]]
        quickest.setdefault((row["score"], row["n"], row["security"]), {})[row["engine"]] = Recorded(
            f"{about['title']} {about['version']}",
            row["protocol"],
            row["ms"],
            row["bytes"],
            row["rounds"],
            f"{about['machine']}. {about['how']}",
        )
    return {
        cell: [found[engine] for engine in data["engines"] if engine in found]
        for cell, found in quickest.items()
    }


def recorded(score: str, n: int, security: str) -> list[Recorded]:
    """What was recorded for an opened score: one entry an engine, its quickest protocol; often none."""
    return _figures().get((score, n, security), [])
