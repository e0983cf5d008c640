"""What the demo measured."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from bench.demo.merged import Errors
from bench.demo.places import Quality


@dataclass(frozen=True, slots=True)
class Report:
    """What the demo measured. Times are milliseconds, sizes bytes, errors metres; pairs are Alice's, Bob's.

    ``candidates`` are pairs that match, ``verified`` those of them whose submaps fit each other; ``shown`` is
    of how many keyframes a submap was shown. ``same_places`` are all pairs at most 1 m apart, which recall is
    of; ``disagreements`` are decisions unlike in the clear, those within the resolution of the threshold left
    out. ``errors`` are those of :class:`bench.demo.merged.Errors`.
    """

    security: str
    keyframes: tuple[int, int]
    dimension: int
    threshold: float
    pairs: int
    candidates: int
    clear_candidates: int
    verified: int
    private_quality: Quality
    clear_quality: Quality
    verified_quality: Quality
    same_places: int
    disagreements: int
    errors: Errors
    dealt_slots: tuple[int, int]
    dealing_seconds: float
    folder_bytes: tuple[int, int]
    bytes_sent: tuple[int, int]
    rounds: int
    milliseconds: float
    shown: tuple[int, int]
    payload_bytes: tuple[int, int]
    verifying_milliseconds: float
    clear_bytes: tuple[int, int]
    clear_milliseconds: float
    page: str
    picture: str
    files: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        named = ("private_quality", "clear_quality", "verified_quality", "errors")
        return asdict(self) | {name: getattr(self, name)._asdict() for name in named}
