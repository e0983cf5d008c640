"""Run the attacks: which parts, on what, and what came of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

from bench.attacks.insider import RefusalRow, refusals
from bench.attacks.paths import PathRow, Reconstruction, judged, reconstructions
from bench.attacks.probes import SLOTS, STRIKES, Curves, measure, most_information
from bench.attacks.scans import Rebuilt, rebuild
from bench.attacks.world import DENSE, World, build
from bench.demo import dataset

PARTS = ("paths", "scans", "probes")
_BROUGHT = 6
"""Descriptors of Alice's that the real protocol is run with."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is run.

    Attributes:
        dense: Metres of travel between the attacker's own places.
        turns: Quarter turns of each of them that the regression learns from.
        targets: Hidden vectors of each kind that are probed.
        bits: Probes that each gets.
    """

    dense: float
    turns: int
    targets: int
    bits: int


class Panel(NamedTuple):
    """A panel of a picture: a PNG, and what it shows."""

    png: bytes
    words: str


FULL, QUICK = Effort(DENSE, 4, 7, 1600), Effort(2 * DENSE, 1, 1, 150)


@dataclass(slots=True)
class Findings:
    """What the attacks brought; of parts that were not run there is nothing.

    Attributes:
        world: Who attacked whom.
        seed: Of everything random.
        paths: Rows and what they were made of.
        scans: The rebuilt scans.
        probes: Rows and curves.
        refusals: What the real protocol did with probes.
        panels: The pictures that were drawn, panel by panel.
    """

    world: World = field(repr=False)
    seed: int
    paths: list[tuple[PathRow, Reconstruction]] = field(default_factory=list)
    scans: Rebuilt | None = None
    probes: list[Curves] = field(default_factory=list)
    refusals: list[RefusalRow] = field(default_factory=list)
    panels: dict[str, list[Panel]] = field(default_factory=dict)

    def rows(self) -> Iterator[dict[str, Any]]:
        """JSON-ready, one for each figure of a table."""
        for row, _ in self.paths:
            yield {"part": "paths", **asdict(row)}
        for scan in [] if self.scans is None else self.scans.rows:
            yield {"part": "scans", **asdict(scan)}
        for curves in self.probes:
            yield {"part": "probes", **asdict(curves.row)}
        if self.probes:
            bits = most_information(STRIKES, SLOTS)
            yield {"part": "strikes", "strikes": STRIKES, "slots": SLOTS, "most_bits": round(bits, 2)}
        for refusal in self.refusals:
            yield {"part": "refusals", **asdict(refusal)}


def run_attacks(parts: tuple[str, ...], effort: Effort, seed: int) -> Findings:
    """Run parts of the attacks.

    Args:
        parts: Of ``PARTS``.
        effort: How much.
        seed: Of everything random.

    Raises:
        ImportError: the laser scans are not installed.
    """
    _say("reading the laser scans of both robots")
    world = build(dataset.load(), effort.dense)
    found = Findings(world, seed)
    if "paths" in parts:
        _say("paths: where Alice was, from her descriptors")
        found.paths = [(judged(one, world), one) for one in reconstructions(world)]
    if "scans" in parts:
        _say("scans: what Alice saw, from her descriptors")
        found.scans = rebuild(world, seed, effort.turns)
    if "probes" in parts:
        _say("probes: unit vectors, in the clear; then longer ones, by the real protocol")
        found.probes = list(measure(world, seed, effort.targets, effort.bits))
        found.refusals = refusals(world.alice.descriptors[:_BROUGHT], world.threshold)
    return found


def _say(text: str) -> None:
    print(f"... {text}", file=sys.stderr, flush=True)
