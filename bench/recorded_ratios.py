"""How many times MP-SPDZ's time was this engine's at one commit, from ``recorded_ratios.json``.

Both were measured in one run on one machine. So newer code is placed without MP-SPDZ at hand: measured
against that commit in one run (``python -m bench versus``), its speed-up times the recorded ratio is its own.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

FORMAT = 1

Cell = tuple[str, int, str]
"""Score, length and security."""


@dataclass(frozen=True, slots=True)
class Ratios:
    """What was recorded.

    Attributes:
        base: The commit that was measured beside MP-SPDZ.
        how: How and on what machine.
        ratios: By cell, MP-SPDZ's time over this engine's: above 1, this engine was quicker.
    """

    base: str
    how: str
    ratios: dict[Cell, float]

    def of(self, commit: str) -> dict[Cell, float]:
        """The ratios, if they were recorded for a commit (its full hash); else none."""
        return self.ratios if commit == self.base else {}


@cache
def recorded_ratios() -> Ratios:
    """Read ``bench/recorded_ratios.json``, in the order of its rows."""
    data = json.loads(files("bench").joinpath("recorded_ratios.json").read_text(encoding="utf-8"))
    if data["format"] != FORMAT:
        raise ValueError(f"bench/recorded_ratios.json has format {data['format']}, expected {FORMAT}")
    ratios = {(row["score"], row["n"], row["security"]): row["ratio"] for row in data["rows"]}
    return Ratios(data["base"], data["how"], ratios)
