"""What a gallery of places is dealt for, as a few numbers that fit a tape's header."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from protocols.candidate import is_candidate
from protocols.catalog import FINEST, GalleryPurpose, parse_resolution
from protocols.combining import RULES, Rule
from protocols.place import Compared, Place, check_part
from protocols.question import Reveal
from protocols.scores import SCORES
from spdz.foundations.types import Security
from spdz.local import run_clear
from spdz.readings.gallery import Terms
from spdz.readings.sections import cuts, encode_sections

_FIELDS = {"place", "rule", "resolution", "norm_proof"}
_PART = {"name", "score", "dim", "turns", "max_norm", "min_norm"}


@dataclass(frozen=True, slots=True)
class Part:
    """One descriptor of a place.

    Attributes:
        name: A name of one's own: 1 to 31 letters, digits, - and _.
        score: Name of the score function.
        dim: Length N of a descriptor.
        turns: Rotations that a place brings of it, 1 to 16, each of ``dim`` numbers.
        max_norm: Largest L2 norm of a descriptor.
        min_norm: Smallest L2 norm of a descriptor; 0 for none.

    Raises:
        ValueError: if a field is out of range.
    """

    name: str
    score: str
    dim: int
    turns: int = 1
    max_norm: float = 1.0
    min_norm: float = 0.0

    def __post_init__(self) -> None:
        check_part(self.name, self.dim, self.turns)
        try:
            GalleryPurpose(self.score, self.dim, max_norm=self.max_norm, min_norm=self.min_norm)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def compared(self, threshold: float) -> Compared:
        """As a program compares it."""
        score = SCORES[self.score].within(float(self.max_norm), min_norm=float(self.min_norm))
        return Compared(self.name, is_candidate(score, threshold), self.dim, self.turns)

    def __str__(self) -> str:
        turns = f"{self.turns} x " if self.turns > 1 else ""
        return f"{self.name} ({SCORES[self.score]} of {turns}{self.dim}-D, norm at most {self.max_norm:g})"


@dataclass(frozen=True, slots=True)
class PlacePurpose:
    """What a gallery of places is dealt for: any place of party 0 may meet any of party 1.

    For a pair: of a part, turn 0 of party 0's place against all turns of party 1's, any of them; the parts
    combined by the rule. One bit is opened.

    Attributes:
        parts: The descriptors of a place, in the order in which a slot's vector holds them.
        rule: ``"any"`` of the parts, or ``"all"``.
        resolution: Fractional bits of the scores that comparisons look at; None for all of them.
        proof: Whether the norm of every descriptor is proved, turn by turn (malicious mode).

    Raises:
        ValueError: if a field is out of range, or a place too large for a gallery's words.
    """

    parts: tuple[Part, ...]
    rule: Rule = "any"
    resolution: int | None = 16
    proof: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.parts, tuple) or not all(isinstance(part, Part) for part in self.parts):
            raise ValueError("the parts of a place are a tuple of Part(name, score, dim, ..)")
        names = [part.name for part in self.parts]
        if not names or len(set(names)) < len(names):
            raise ValueError(
                f"a place has parts, each of a name of its own, not {', '.join(names) or 'none'}"
            )
        if self.rule not in RULES:
            raise ValueError(f"the rule of a place is {' or '.join(RULES)}, not {self.rule!r}")
        if self.resolution is not None and not 0 <= self.resolution <= FINEST:
            raise ValueError(f"a resolution is 2^0 to 2^-{FINEST}, or exact")
        self.dealt_terms("malicious")  # raises where the words would be too long

    @property
    def dim(self) -> int:
        """Length of a slot's vector: all turns of all parts end to end."""
        return sum(part.turns * part.dim for part in self.parts)

    def terms(self, thresholds: Mapping[str, float], security: Security) -> Terms:
        """What slots and pairs are read with.

        Args:
            thresholds: One a part, by its name, in its score's units.
            security: The security model.

        Raises:
            ValueError: unless every part has a threshold, one finite number, and nothing else has.
        """
        return Terms(self.program(thresholds), self.dim, security, self.resolution, proof=self.proof)

    def dealt_terms(self, security: Security) -> Terms:
        """The terms as the dealer reads them (thresholds change nothing that is dealt)."""
        return self.terms({part.name: 0.0 for part in self.parts}, security)

    def program(self, thresholds: Mapping[str, float]) -> Place:
        """The program itself; arguments and errors as of :meth:`terms`."""
        names = {part.name for part in self.parts}
        if not isinstance(thresholds, Mapping) or set(thresholds) != names:
            given = ", ".join(map(str, thresholds)) if isinstance(thresholds, Mapping) else repr(thresholds)
            raise ValueError(
                f"a place has a threshold for each of its parts ({', '.join(sorted(names))}), not for {given}"
            )
        return Place(tuple(part.compared(thresholds[part.name]) for part in self.parts), self.rule)

    def in_words(self, thresholds: Mapping[str, float]) -> str:
        """What is decided: ``any of lidar S10 >= 0.42 (4 turns), camera S10 >= 0.8, to 2^-16``."""
        return self.terms(thresholds, "malicious").rule

    def plain(
        self, x: npt.ArrayLike, y: npt.ArrayLike, thresholds: Mapping[str, float]
    ) -> npt.NDArray[np.bool_]:
        """The decisions in the clear, exact: what a gallery without a resolution opens.

        Args:
            x: Places of party 0, shape (R, N).
            y: Places of party 1, shape (C, N).
            thresholds: As of :meth:`terms`.

        Returns:
            Booleans of shape (R, C).

        Raises:
            ValueError: for places that do not suit.
        """
        program = self.program(thresholds)
        places = [np.asarray(one) for one in (x, y)]
        for one in places:
            encode_sections(program.sections, one)
        where, at, parts = cuts(program.sections), 0, []
        for part in program.parts:
            turns = [
                run_clear(part.candidate, places[0][:, None, where[at]], places[1][None, :, cut]).value
                for cut in where[at : at + part.turns]
            ]
            parts.append(np.any(turns, axis=0))
            at += part.turns
        combine = np.any if self.rule == "any" else np.all
        return np.asarray(combine(parts, axis=0), dtype=np.bool_)

    @property
    def summary(self) -> str:
        """What is compared and opened, for people."""
        named = ", ".join(map(str, self.parts))
        return f"places of {named}; opens one bit, whether {self.rule} of them match"

    @property
    def reveal(self) -> Reveal:
        """Never a score."""
        return "bit"

    @property
    def hint(self) -> str | None:
        """What users of the parts' scores get wrong most often."""
        questions = (GalleryPurpose(part.score, part.dim) for part in self.parts)
        return next((one.hint for one in questions if one.hint), None)

    @property
    def step_text(self) -> str:
        """The resolution, as the dealer's command takes it."""
        return "exact" if self.resolution is None else f"2^-{self.resolution}"

    def as_json(self) -> dict[str, Any]:
        """For a tape's header."""
        return {
            "place": [{name: getattr(part, name) for name in sorted(_PART)} for part in self.parts],
            "rule": self.rule,
            "resolution": self.step_text,
            "norm_proof": self.proof,
        }

    @classmethod
    def from_json(cls, header: Mapping[str, Any]) -> PlacePurpose:
        """Read a tape's header back.

        Raises:
            ValueError: if the tape was dealt for something else.
        """
        parts = header.get("place")
        if set(header) - {"gallery"} != _FIELDS or not isinstance(parts, list):
            raise ValueError("this gallery was not dealt for places of several descriptors")
        for part in parts:
            if not isinstance(part, dict) or set(part) != _PART:
                raise ValueError(f"a part of a place has {', '.join(sorted(_PART))}")
        return cls(
            tuple(Part(**part) for part in parts),
            header["rule"],
            parse_resolution(str(header["resolution"])),
            bool(header["norm_proof"]),
        )


AnyPurpose: TypeAlias = GalleryPurpose | PlacePurpose
"""What a dealer deals galleries for."""


def purpose_of(header: Mapping[str, Any]) -> AnyPurpose:
    """What the program in a tape's header is for.

    Raises:
        ValueError: if that is a program of the user's own.
    """
    return PlacePurpose.from_json(header) if "place" in header else GalleryPurpose.from_json(header)
