"""One cell of the sweep, and its trials: a protocol, a score, a length."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field

from bench.sweep.results import Trial
from spdz.foundations.types import SECURITIES

MODELS = SECURITIES
"""The protocols that keep descriptors secret."""
Key = tuple[str, str, int]
"""Protocol, score, length."""


@dataclass(frozen=True, slots=True)
class Cell:
    """The trials of one protocol, score and length.

    Attributes:
        trials: Counted ones.
        profiled: The one with phases, whose time does not count; None without.
    """

    protocol: str
    score: str
    n: int
    trials: Sequence[Trial] = field(repr=False)
    profiled: Trial | None = None

    @property
    def mean_ms(self) -> float:
        """Mean time."""
        return statistics.fmean(trial.ms for trial in self.trials)

    @property
    def std_ms(self) -> float | None:
        """Standard deviation (n - 1) of the time; None of a single trial."""
        return statistics.stdev(trial.ms for trial in self.trials) if len(self.trials) > 1 else None

    @property
    def median_ms(self) -> float:
        """Median time."""
        return statistics.median(trial.ms for trial in self.trials)

    @property
    def bytes_party(self) -> int:
        """Bytes that the larger party sent."""
        return max(max(trial.bytes_sent) for trial in self.trials)

    @property
    def tape_bytes(self) -> int:
        """Bytes of the larger party's tape for one comparison; 0 without."""
        return max(max(trial.tape_bytes, default=0) for trial in self.trials)

    @property
    def rounds(self) -> int:
        """Exchanges."""
        return self.trials[0].rounds

    @property
    def messages(self) -> int:
        """Frames of both parties."""
        return self.trials[0].messages

    @property
    def floor_ms(self) -> float | None:
        """Median time of the same frames over a bare socket; None where it was not measured."""
        found = [trial.floor_ms for trial in self.trials if trial.floor_ms is not None]
        return statistics.median(found) if found else None

    @property
    def ahead_ms(self) -> float | None:
        """What is done ahead of a comparison, by the number of jobs; None where nothing is."""
        return self.trials[0].ahead_ms

    @property
    def compile_ms(self) -> float | None:
        """Compiling the program, once a session; None where nothing is compiled."""
        return self.trials[0].compile_ms

    @property
    def whole_ms(self) -> float | None:
        """The median time and what is done ahead; None where that was not measured."""
        return None if self.ahead_ms is None else self.median_ms + self.ahead_ms

    @property
    def error(self) -> float | None:
        """The largest deviation from the clear score; None where there is none to have."""
        return max((trial.error for trial in self.trials if trial.error is not None), default=None)
