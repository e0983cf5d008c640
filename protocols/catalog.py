"""What a tape is dealt for, as a few numbers that fit its header."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocols.question import Question, Reveal
from protocols.thresholds import threshold_warning
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.channels.frames import MAX_FRAME
from spdz.foundations.types import Security, Shape
from spdz.readings.gallery import Terms
from spdz.rounds.wire import ELEMENT_BYTES

__all__ = ["GalleryPurpose", "Purpose", "Reveal", "parse_resolution", "threshold_warning"]

FINEST = 62
"""Most fractional bits of a resolution: no score has more."""


@dataclass(frozen=True, slots=True)
class Purpose(Question):
    """The program of one job of a tape: every descriptor of one tile against every other.

    Attributes:
        score: Name of the score function.
        reveal: ``"bit"`` (is it a candidate?) or ``"score"`` (the number itself).
        dim: Length N of a descriptor.
        tile: Descriptors (of party 0, of party 1) in a job.
        max_norm: Largest L2 norm of a descriptor.
        min_norm: Smallest L2 norm of a descriptor.
        proof: Whether every job proves the norms of its descriptors (malicious mode).
    """

    score: str
    dim: int
    reveal: Reveal = "bit"
    tile: tuple[int, int] = (1, 1)
    max_norm: float = MAX_NORM
    min_norm: float = 0.0
    proof: bool = False

    def __post_init__(self) -> None:
        self.check()
        if len(self.tile) != 2 or min(self.tile) < 1:
            raise ValueError("the tile must be positive")
        if max(self.tile) * self.dim * ELEMENT_BYTES > MAX_FRAME or self.pairs * ELEMENT_BYTES > MAX_FRAME:
            raise ValueError(
                f"a job of {self.tile[0]} x {self.tile[1]} descriptors of dimension {self.dim} does not fit "
                f"a frame of {MAX_FRAME >> 20} MB; choose a smaller tile"
            )

    @property
    def pairs(self) -> int:
        """Comparisons in a job."""
        return self.tile[0] * self.tile[1]

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Input shapes of both parties: broadcasting makes all pairs of them."""
        return (self.tile[0], 1, self.dim), (1, self.tile[1], self.dim)

    def as_json(self) -> dict[str, Any]:
        """For a tape's header."""
        return {
            "score": self.score,
            "reveal": self.reveal,
            "dim": self.dim,
            "tile": list(self.tile),
            "max_norm": self.max_norm,
            **({"min_norm": self.min_norm, "norm_proof": True} if self.proof else {}),
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
            min_norm=float(header.get("min_norm", 0.0)),
            proof=bool(header.get("norm_proof", False)),
        )


@dataclass(frozen=True, slots=True)
class GalleryPurpose(Question):
    """What a gallery is dealt for: any descriptor of party 0 may meet any of party 1.

    Attributes:
        score: Name of the score function.
        dim: Length N of a descriptor.
        reveal: ``"bit"`` (is it a candidate?) or ``"score"`` (the number itself).
        max_norm: Largest L2 norm of a descriptor.
        resolution: Fractional bits of the score that a comparison looks at: a score within 2^-resolution / 2
            of the threshold may be decided either way. None for all of them: then it is exact.
        min_norm: Smallest L2 norm of a descriptor; 0 for none.
        proof: Whether the norm of every descriptor is proved (malicious mode).

    Raises:
        ValueError: if a field is out of range, or a descriptor too large for a gallery's words.
    """

    score: str
    dim: int
    reveal: Reveal = "bit"
    max_norm: float = 1.0
    resolution: int | None = 16
    min_norm: float = 0.0
    proof: bool = True

    def __post_init__(self) -> None:
        self.check()
        if self.resolution is not None and not 0 <= self.resolution <= FINEST:
            raise ValueError(f"a resolution is 2^0 to 2^-{FINEST}, or exact")
        self.dealt_terms("malicious")  # raises where the words would be too long

    def terms(self, threshold: float | None, security: Security) -> Terms:
        """What slots and pairs are read with.

        Raises:
            ValueError: if the gallery reveals bits and there is no threshold, or the other way round.
        """
        return Terms(
            self.program(threshold), self.dim, security, self.resolution, float(self.min_norm), self.proof
        )

    def dealt_terms(self, security: Security) -> Terms:
        """The terms as the dealer reads them (a threshold changes nothing that is dealt)."""
        return self.terms(0.0 if self.reveal == "bit" else None, security)

    def rule(self, threshold: float | None) -> str:
        """What is decided, for people."""
        rule = Question.rule(self, threshold)  # super() finds no class made with slots=True
        return rule if threshold is None or self.resolution is None else f"{rule}, to {self.step_text}"

    def as_json(self) -> dict[str, Any]:
        """For a tape's header."""
        return {
            "score": self.score,
            "reveal": self.reveal,
            "dim": self.dim,
            "max_norm": self.max_norm,
            "resolution": self.step_text,
            "min_norm": self.min_norm,
            "norm_proof": self.proof,
        }

    @classmethod
    def from_json(cls, header: Mapping[str, Any]) -> GalleryPurpose:
        """Read a tape's header back.

        Raises:
            ValueError: if the tape was dealt for something else.
        """
        if "place" in header:
            raise ValueError(
                "this gallery holds places of several descriptors, each with a threshold: run it with "
                "`python -m spdz agent`, or with protocols.Gallery(tape, terms=purpose.terms(thresholds, "
                "security)), purpose being protocols.PlacePurpose.from_json(header.program)"
            )
        if not {"score", "dim", "reveal", "max_norm", "resolution", "min_norm", "norm_proof"} <= set(header):
            raise ValueError(
                "this gallery was dealt for a program of your own, not for one of the ten scores: meet with "
                "the spdz.readings.gallery.Terms that it was dealt for"
            )
        return cls(
            score=str(header["score"]),
            dim=int(header["dim"]),
            reveal=header["reveal"],
            max_norm=float(header["max_norm"]),
            resolution=parse_resolution(str(header["resolution"])),
            min_norm=float(header["min_norm"]),
            proof=bool(header["norm_proof"]),
        )

    @property
    def step_text(self) -> str:
        """The resolution, as the dealer's command takes it."""
        return "exact" if self.resolution is None else f"2^-{self.resolution}"


def parse_resolution(text: str) -> int | None:
    """Fractional bits of ``2^-16``; None of ``exact``.

    Raises:
        ValueError: of anything else.
    """
    if text == "exact":
        return None
    bits = text.removeprefix("2^-")
    if bits == text or not (bits.isascii() and bits.isdigit() and len(bits) < 4):
        raise ValueError(f"a resolution is a power of two such as 2^-16, or exact, not {text!r}")
    return int(bits)
