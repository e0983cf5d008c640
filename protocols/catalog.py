"""What a tape is dealt for, as a few numbers that fit its header."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from protocols.candidate import is_candidate
from protocols.scores import SCORES
from spdz import Program
from spdz.channels.frames import MAX_FRAME
from spdz.fixed_point import MAX_NORM, norm_bound
from spdz.types import Shape
from spdz.wire import ELEMENT_BYTES

Reveal = Literal["bit", "score"]


@dataclass(frozen=True, slots=True)
class Purpose:
    """The program of one job of a tape: every descriptor of one tile against every other.

    Attributes:
        score: Name of the score function.
        reveal: ``"bit"`` (is it a candidate?) or ``"score"`` (the number itself).
        dim: Length N of a descriptor.
        tile: Descriptors (of party 0, of party 1) in a job.
        max_norm: Largest L2 norm of a descriptor.
    """

    score: str
    dim: int
    reveal: Reveal = "bit"
    tile: tuple[int, int] = (1, 1)
    max_norm: float = MAX_NORM

    def __post_init__(self) -> None:
        if self.score not in SCORES:
            raise ValueError(f"unknown score {self.score!r}; known scores are {', '.join(SCORES)}")
        if self.reveal not in ("bit", "score"):
            raise ValueError(f"reveal must be 'bit' or 'score', not {self.reveal!r}")
        if self.dim < 1 or len(self.tile) != 2 or min(self.tile) < 1:
            raise ValueError("dimension and tile must be positive")
        if max(self.tile) * self.dim * ELEMENT_BYTES > MAX_FRAME or self.pairs * ELEMENT_BYTES > MAX_FRAME:
            raise ValueError(
                f"a job of {self.tile[0]} x {self.tile[1]} descriptors of dimension {self.dim} does not fit "
                f"a frame of {MAX_FRAME >> 20} MB; choose a smaller tile"
            )
        norm_bound(self.max_norm, self.dim)  # raises for a norm out of range

    @property
    def pairs(self) -> int:
        """Comparisons in a job."""
        return self.tile[0] * self.tile[1]

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Input shapes of both parties: broadcasting makes all pairs of them."""
        return (self.tile[0], 1, self.dim), (1, self.tile[1], self.dim)

    def program(self, threshold: float | None) -> Program:
        """The program itself.

        Raises:
            ValueError: if the tape reveals bits and there is no threshold, or the other way round.
        """
        score = SCORES[self.score].within(self.max_norm)
        if self.reveal == "score":
            if threshold is not None:
                raise ValueError("these tapes reveal the score itself: leave the threshold out")
            return score
        if threshold is None:
            raise ValueError("these tapes reveal only the candidate bit: give a threshold")
        return is_candidate(score, threshold)

    @property
    def dealt_program(self) -> Program:
        """The program as the dealer reads it (a threshold changes nothing that is dealt)."""
        return self.program(0.0 if self.reveal == "bit" else None)

    def as_json(self) -> dict[str, Any]:
        """For a tape's header."""
        return {
            "score": self.score,
            "reveal": self.reveal,
            "dim": self.dim,
            "tile": list(self.tile),
            "max_norm": self.max_norm,
        }

    @classmethod
    def from_json(cls, header: Mapping[str, Any]) -> Purpose:
        """Read a tape's header back."""
        rows, columns = header["tile"]
        return cls(
            score=str(header["score"]),
            reveal=header["reveal"],
            dim=int(header["dim"]),
            tile=(int(rows), int(columns)),
            max_norm=float(header["max_norm"]),
        )
