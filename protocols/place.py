"""Places of several descriptors: one slot holds them all, and of a pair of places one bit is opened.

A *part* is a descriptor with its own score, length, threshold and norms. It may be brought in several *turns*
(rotations of one scan): turn 0 of party 0's place is compared with every turn of party 1's, and the part
matches if any of these does. The parts are combined by a rule, any or all. No comparison of a part is opened
(:mod:`protocols.combining`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from protocols.candidate import Candidate
from protocols.combining import Rule, combined
from protocols.score import Operand, Score
from spdz import Engine, Value, columns, parallel
from spdz.arithmetic.fixed_point import norm_bound
from spdz.readings.meter import Meter
from spdz.readings.sections import Section, cuts
from spdz.rounds.coroutine import run_silently
from spdz.values.engine import Input
from spdz.values.input_mask import SLOT_REJECTION, word_bits

MOST_TURNS = 16
_NAME = re.compile(r"[A-Za-z0-9_-]{1,31}")


@dataclass(frozen=True, slots=True)
class Compared:
    """A part of a place, as a program compares it.

    Attributes:
        name: What it is called in rules and errors.
        candidate: Score with norms, and threshold.
        dim: Length of one turn.
        turns: How many there are.

    Raises:
        ValueError: for a name or a number out of range.
    """

    name: str
    candidate: Candidate
    dim: int
    turns: int = 1

    def __post_init__(self) -> None:
        check_part(self.name, self.dim, self.turns)

    def __str__(self) -> str:
        turns = f" ({self.turns} turns)" if self.turns > 1 else ""
        return f"{self.name} {self.candidate}{turns}"

    @property
    def sections(self) -> tuple[Section, ...]:
        """Its turns."""
        name, score = self.name, self.candidate.score
        names = [name] if self.turns == 1 else [f"{name} (turn {turn})" for turn in range(self.turns)]
        return tuple(Section(one, self.dim, score.max_norm, score.min_norm) for one in names)

    @property
    def prepared(self) -> int:
        """Values that its score prepares of a turn."""
        return _prepared(self.candidate.score, self.dim)


@dataclass(frozen=True, slots=True)
class Place:
    """The program of a gallery of places.

    Attributes:
        parts: In the order in which a slot's vector holds them, turn after turn.
        rule: ``"any"`` or ``"all"``.
    """

    parts: tuple[Compared, ...]
    rule: Rule = "any"

    def __str__(self) -> str:
        named = ", ".join(str(part) for part in self.parts)
        return named if len(self.parts) == 1 else f"{self.rule} of {named}"

    @property
    def sections(self) -> tuple[Section, ...]:
        """Every turn of every part."""
        return tuple(section for part in self.parts for section in part.sections)

    @property
    def max_norm(self) -> float:
        """The largest of the parts'."""
        return max(part.candidate.max_norm for part in self.parts)

    async def prepare(self, engine: Engine, vectors: Value, /) -> Operand:
        """What each score prepares of each turn, all in the same rounds."""
        turns = zip(self._turns(), self._cut(vectors), strict=True)
        lanes = [part.candidate.prepare(engine, cut) for (part, _), cut in turns]
        return tuple(value for one in await parallel(*lanes) for value in one)

    async def compare(self, engine: Engine, x: Operand, y: Operand, /) -> Value:
        """Every comparison of every part in the same rounds, then the one bit."""
        first, second = self._operands(x), self._operands(y)
        lanes = []
        for part, turn in self._turns():
            mine, theirs = first[part.name, 0], second[part.name, turn]
            lanes.append(part.candidate.compare(engine, mine, theirs))
        bits = iter(await parallel(*lanes))
        return await combined([[next(bits) for _ in range(part.turns)] for part in self.parts], self.rule)

    def _turns(self) -> Iterator[tuple[Compared, int]]:
        return ((part, turn) for part in self.parts for turn in range(part.turns))

    def _cut(self, vectors: Value) -> list[Value]:
        sections = self.sections
        return [
            columns(vectors, cut.start, cut.stop, max_norm=one.max_norm)
            for one, cut in zip(sections, cuts(sections), strict=True)
        ]

    def _operands(self, operand: Operand) -> dict[tuple[str, int], Operand]:
        vectors, *prepared = operand
        operands, start = {}, 0
        for (part, turn), cut in zip(self._turns(), self._cut(vectors), strict=True):
            stop = start + part.prepared
            operands[part.name, turn] = (cut, *prepared[start:stop])
            start = stop
        return operands


def check_part(name: Any, dim: Any, turns: Any) -> None:
    """Refuse a name or numbers that no part can have.

    Raises:
        ValueError: saying what is allowed.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"a part's name is 1 to 31 letters, digits, - and _, not {name!r}")
    if type(dim) is not int or dim < 1:
        raise ValueError(f"{name}: the dimension must be a positive integer, not {dim!r}")
    if type(turns) is not int or not 1 <= turns <= MOST_TURNS:
        raise ValueError(f"{name}: turns are 1 to {MOST_TURNS}, not {turns!r}")


@lru_cache(maxsize=64)
def _prepared(score: Score, dim: int) -> int:
    """How many values a score prepares: what the meter sees of it."""
    meter, norm = Meter("semi-honest", (1,)), norm_bound(score.max_norm, dim)
    meter.slot_bits = word_bits((dim,), norm, SLOT_REJECTION)
    vectors = meter.input_mask(Input(0, (1, dim), norm))
    return len(run_silently(score.prepare(meter, vectors)))  # type: ignore[arg-type]
