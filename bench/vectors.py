"""Outputs that another engine recorded, from a JSON file; the format is in ``tests/vectors/README.md``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from bench.exact import ONE, exact_score, units

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Pair:
    """Two input vectors as raw integers, and what kind of vectors they are."""

    n: int
    case: str
    x: tuple[int, ...]
    y: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Record:
    """One score of one pair, as the other engine computed it.

    Attributes:
        score: ``"S1"`` to ``"S10"``.
        variant: ``"division"``, or how else the same score was computed.
        protocol: The other engine's protocol.
        prime_bits: Bits of its modulus.
        pair: The inputs.
        raw: Its outputs of several runs, as raw integers.
    """

    score: str
    variant: str
    protocol: str
    prime_bits: int
    pair: Pair
    raw: tuple[int, ...]

    @property
    def exact(self) -> Fraction:
        """The true score of the inputs."""
        return exact_score(self.score, self.pair.x, self.pair.y)

    @property
    def errors(self) -> list[float]:
        """Distance of each output from the true score, in units of 2^-16."""
        exact = self.exact
        return [units(Fraction(value, ONE), exact) for value in self.raw]


@dataclass(frozen=True, slots=True)
class Vectors:
    """A file of records."""

    engine: str
    version: str
    records: tuple[Record, ...]

    def worst(self, score: str, variant: str = "division") -> float:
        """The other engine's largest error in a score, in units of 2^-16."""
        errors = [r.errors for r in self.records if (r.score, r.variant) == (score, variant)]
        return max(error for row in errors for error in row)


def load_vectors(path: Path) -> Vectors:
    """Read a file of records.

    Raises:
        ValueError: if it is not of this format.
        OSError: if it cannot be read.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']}, expected {FORMAT}")
        pairs = [Pair(p["n"], p["case"], tuple(p["x"]), tuple(p["y"])) for p in data["inputs"]]
        records = tuple(
            Record(
                r["score"], r["variant"], r["protocol"], r["prime_bits"], pairs[r["input"]], tuple(r["raw"])
            )
            for r in data["results"]
        )
        return Vectors(data["engine"], data["version"], records)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"{path} is not a file of recorded vectors: {error}") from error
