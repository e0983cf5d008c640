"""What a run cost, counted by the engine itself, and what it returned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from typing import Any


def copied(counter: Counter[str]) -> Counter[str]:
    """A copy, in a quarter of the time that ``Counter.copy`` takes."""
    copy: Counter[str] = Counter.__new__(Counter)
    dict.update(copy, counter)
    return copy


@dataclass(slots=True)
class Stats:
    """One party's online cost.

    Attributes:
        rounds: Exchanges, both directions at once; MAC checks included, the handshake not.
        bytes_sent: Bytes handed to the transport for those rounds, frame headers included, TLS and TCP
            overhead not.
        field_elements_sent: Field elements among them.
        correlations: Dealt correlations used, by kind ("input mask" counts coordinates).
    """

    rounds: int = 0
    bytes_sent: int = 0
    field_elements_sent: int = 0
    correlations: Counter[str] = dataclass_field(default_factory=Counter)

    def book(self, kind: str, number: int) -> None:
        """Count correlations used."""
        self.correlations[kind] += number

    def add(self, other: Stats) -> None:
        """Add another run's costs to these."""
        self.rounds += other.rounds
        self.bytes_sent += other.bytes_sent
        self.field_elements_sent += other.field_elements_sent
        self.correlations.update(other.correlations)

    def as_dict(self) -> Mapping[str, Any]:
        """The counters as JSON-ready numbers."""
        return {
            "rounds": self.rounds,
            "bytes_sent": self.bytes_sent,
            "field_elements_sent": self.field_elements_sent,
            "correlations": dict(self.correlations),
        }


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run returns.

    Attributes:
        value: The opened result: float or bool, or an array of them.
        stats: One :class:`Stats` a party, indexed by party number.
    """

    value: Any
    stats: tuple[Stats, Stats]
