"""What a sweep measures: cells, each a protocol, a score, and a length."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from protocols.scores import SCORES
from spdz.foundations.types import SECURITIES

PROTOCOLS = (*SECURITIES, "numpy", "cpp")
"""The engine's two security models and two insecure baselines."""

SIZES = (16, 256, 512, 768, 1024, 1536, 2048, 4096, 8192)
"""The paper's lengths."""

TRIALS, QUICK_TRIALS = 10, 5

_FEW = ("S2", "S4", "S6", "S10")
PRINTED: dict[int, Sequence[str]] = {
    n: tuple(SCORES) if n == 16 else _FEW if n in (1536, 8192) else ("S10",) for n in SIZES
}
"""The scores that the paper's table prints for each length: what ``--quick`` measures."""


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """One cell of the sweep."""

    n: int
    score: str
    protocol: str

    def __str__(self) -> str:
        return f"{self.protocol} {self.score} N = {self.n}"


def cells(
    scores: Sequence[str], sizes: Sequence[int], protocols: Collection[str], *, quick: bool = False
) -> Iterator[Cell]:
    """The cells in the order in which they are measured: what is compared lies side by side in time.

    Args:
        scores: Names of scores.
        sizes: Lengths.
        protocols: Some of :data:`PROTOCOLS`.
        quick: Of all these, only what the paper's table prints.
    """
    for n in sizes:
        for score in scores:
            if quick and score not in PRINTED.get(n, ()):
                continue
            for protocol in PROTOCOLS:
                if protocol in protocols:
                    yield Cell(n, score, protocol)
