"""What a tape is dealt for, as a few numbers that fit its header, and which thresholds make sense for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any, Literal

from protocols.candidate import is_candidate
from protocols.scores import SCORES
from spdz import Program
from spdz.arithmetic.fixed_point import MAX_NORM, norm_bound
from spdz.channels.frames import MAX_FRAME
from spdz.foundations.types import Shape
from spdz.rounds.wire import ELEMENT_BYTES

Reveal = Literal["bit", "score"]

_ROUNDING = 2.0**-13
"""How far the score of two equal descriptors may be from the ideal one: a few units of 2^-16, with room."""
_FLOORS = {"S1": _ROUNDING, "S3": _ROUNDING, "S5": 2.0**-22}
"""Distances that equal descriptors may have, of the scores that normalise inside."""


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

    def rule(self, threshold: float | None) -> str:
        """What is decided, for people."""
        if threshold is None:
            return f"{self.score} itself"
        sign = ">=" if SCORES[self.score].similarity else "<="
        root = f", a distance of {sqrt(threshold):.4g}" if self.hint and threshold >= 0 else ""
        return f"{self.score} {sign} {threshold:g}{root}"

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
        """Read a tape's header back.

        Raises:
            ValueError: if the tape was dealt for something else.
        """
        if not {"score", "dim", "reveal", "tile", "max_norm"} <= set(header):
            raise ValueError(
                "these tapes were dealt for a program of your own, not for one of the ten scores: run it "
                "with spdz.open_session(...).run(program, data), as docs/how-to.md has it"
            )
        rows, columns = header["tile"]
        return cls(
            score=str(header["score"]),
            reveal=header["reveal"],
            dim=int(header["dim"]),
            tile=(int(rows), int(columns)),
            max_norm=float(header["max_norm"]),
        )

    @property
    def score_range(self) -> tuple[float, float]:
        """The smallest and the largest score of descriptors of norm at most ``max_norm``, before rounding."""
        norm = 1.0 if self.score in ("S1", "S3", "S5", "S7", "S8", "S9") else self.max_norm
        if SCORES[self.score].similarity:
            return -(norm**2), norm**2
        if self.score in ("S5", "S6"):
            return 0.0, 4 * norm**2
        return 0.0, 2 * norm * (sqrt(self.dim) if self.score == "S2" else 1.0)

    @property
    def hint(self) -> str | None:
        """What users of this score get wrong most often."""
        if self.score in ("S5", "S6"):
            return f"{self.score} is the squared distance: for a Euclidean threshold t give t*t"
        return None


def threshold_warning(purpose: Purpose, threshold: float | None) -> str | None:
    """Why a threshold will not do what its user wants, or None.

    Warned of are thresholds that every pair or no pair can pass, that equal descriptors pass only by luck,
    and that confuse a distance with its square. Of the last kind only those can be told by the number that
    are past a right angle: descriptors of norm at most R that have nothing in common (x . y = 0) are at
    most sqrt(2) R apart, and 2 R^2 squared. A threshold above that calls all of them the same place, which
    nobody wants whatever R is.

    Args:
        purpose: What the tape is for.
        threshold: In the score's units; None where scores are opened.
    """
    if threshold is None or purpose.reveal == "score" or not isfinite(threshold):
        return None
    name, (least, most) = purpose.score, purpose.score_range
    given = f"the threshold {threshold:g}"
    if SCORES[name].similarity:
        if threshold <= least:
            return f"{given} lets every pair match: no {name} is below {least:g}"
        if threshold > most * (1 + _ROUNDING):
            return f"{given} lets no pair match: no {name} is above {most:g} ({_of_norm(purpose)})"
        if threshold >= most * (1 - _ROUNDING) or (name == "S10" and threshold == 1):
            return (
                f"{given} is met by equal descriptors up to rounding only, which may give 0.9999 or 1.00001 "
                "times the largest score: give a little less"
            )
        return None
    if threshold < 0:
        return f"{given} lets no pair match: a distance is never negative"
    if threshold >= most:
        return f"{given} lets every pair match: no {name} is above {most:g} ({_of_norm(purpose)})"
    if threshold < _FLOORS.get(name, 0):
        return f"{given} is met by equal descriptors up to rounding only: give at least {_FLOORS[name]:.1g}"
    unrelated = {"S3": most / sqrt(2), "S4": most / sqrt(2), "S5": most / 2, "S6": most / 2}
    if threshold > unrelated.get(name, most):
        other = f"S{int(name[1:]) + 2}"
        what = purpose.hint or f"{name} is not squared: for a threshold s of squared distances give sqrt(s)"
        return (
            f"{given} lets descriptors match that have nothing in common: at a right angle {name} is at most "
            f"{unrelated[name]:.4g}. {what}{'' if purpose.hint else f', or deal for {other}'}"
        )
    return None


def _of_norm(purpose: Purpose) -> str:
    if purpose.score in ("S2", "S4", "S6", "S10"):
        return f"of descriptors of norm at most {purpose.max_norm:g}, as the tapes were dealt for"
    return "by its definition"
