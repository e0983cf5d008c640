"""What is asked of a pair of descriptors: a score, or whether it is past a threshold."""

from __future__ import annotations

from math import sqrt
from typing import Literal, TypeAlias

from protocols.candidate import Candidate, is_candidate
from protocols.score import Score
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import norm_bound

Reveal: TypeAlias = Literal["bit", "score"]

OF_UNIT_VECTORS = ("S1", "S3", "S5", "S7", "S8", "S9")
"""The scores that normalise inside."""


class Question:
    """What purposes of every kind have; they are frozen dataclasses with these fields.

    Attributes:
        score: Name of the score function.
        reveal: ``"bit"`` (is it a candidate?) or ``"score"`` (the number itself).
        dim: Length N of a descriptor.
        max_norm: Largest L2 norm of a descriptor.
        min_norm: Smallest L2 norm of a descriptor.
        proof: Whether norms are proved.
        resolution: Fractional bits of the score that a comparison looks at; None for all of them.
    """

    __slots__ = ()

    score: str
    dim: int
    reveal: Reveal
    max_norm: float
    min_norm: float
    proof: bool
    resolution: int | None = None

    def check(self) -> None:
        """Refuse what no purpose can have.

        Raises:
            ValueError: saying what is wrong.
        """
        if self.score not in SCORES:
            raise ValueError(f"unknown score {self.score!r}; known scores are {', '.join(SCORES)}")
        if self.reveal not in ("bit", "score"):
            raise ValueError(f"reveal must be 'bit' or 'score', not {self.reveal!r}")
        if self.dim < 1:
            raise ValueError("the dimension must be positive")
        norm_bound(self.max_norm, self.dim)  # raises for a norm out of range

    def program(self, threshold: float | None) -> Score | Candidate:
        """The program itself.

        Raises:
            ValueError: if the tape reveals bits and there is no threshold, or the other way round.
        """
        score = SCORES[self.score].within(self.max_norm, min_norm=self.min_norm, prove=self.proof)
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
    def summary(self) -> str:
        """What is compared and opened, for people."""
        opened = "the candidate bit alone" if self.reveal == "bit" else "the score itself"
        what = f"{SCORES[self.score]} of {self.dim}-D descriptors of norm at most {self.max_norm:g}"
        return f"{what}; opens {opened}"

    @property
    def dealt_program(self) -> Score | Candidate:
        """The program as the dealer reads it (a threshold changes nothing that is dealt)."""
        return self.program(0.0 if self.reveal == "bit" else None)

    @property
    def score_range(self) -> tuple[float, float]:
        """The smallest and the largest score of descriptors of norm at most ``max_norm``, before rounding."""
        norm = 1.0 if self.score in OF_UNIT_VECTORS else self.max_norm
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
