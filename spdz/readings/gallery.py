"""A gallery's program: the comparison of a job, read on standing inputs instead of fresh ones.

A *slot* holds one vector of one party, masked once and for ever. What depends on one vector alone (that it is
no longer than it may be, its norm, the normalised vector) is computed once a slot, by :func:`fill`. A *pair*
of slots is compared by :func:`compare`, for any rectangle of pairs at a time. Both are read by the same
engines as a job: the dealer on the masks, a party on what it holds, the meter on symbols. Everything that is
dealt belongs to one slot or to one pair, so that any slots and any rectangle can be read later.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Protocol

from spdz.arithmetic.bound import Bound, root
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.arithmetic.short import MOST_BITS
from spdz.foundations.types import Security, Shape
from spdz.gates.output import output
from spdz.readings.sections import Section, prove
from spdz.rounds.coroutine import check
from spdz.values.engine import Engine
from spdz.values.input_mask import SLOT_REJECTION, provable_bits, span, word_bits
from spdz.values.standing import Standing
from spdz.values.value import Value


class GalleryProgram(Protocol):
    """What a gallery computes. Both steps are ``async``; ``vectors`` has shape (n, N).

    A program whose vectors are several descriptors end to end has an attribute ``sections``, a tuple of
    :class:`spdz.readings.sections.Section`.
    """

    @property
    def max_norm(self) -> float:
        """The largest L2 norm of a vector, or of the longest of its sections."""

    def prepare(self, engine: Engine, vectors: Value, /) -> Awaitable[tuple[Value, ...]]:
        """What a pair needs of one vector, computed once a slot: values whose first axis is the vectors'."""

    def compare(self, engine: Engine, x: tuple[Value, ...], y: tuple[Value, ...], /) -> Awaitable[Value]:
        """The result of every pair.

        Args:
            engine: The reading.
            x: Party 0's vectors, shape (R, 1, N), and what was prepared of them.
            y: Party 1's, shape (1, C, N).
        """


@dataclass(frozen=True, slots=True)
class Terms:
    """What a gallery is dealt for.

    Attributes:
        program: The program.
        dim: Length N of a vector.
        security: The security model.
        resolution: Fractional bits of the score that a comparison looks at; None for all.
        min_norm: The smallest L2 norm of a vector; 0 for none. Sections have their own.
        proof: Whether every slot's norms are proved (malicious mode only).
    """

    program: GalleryProgram
    dim: int
    security: Security = "malicious"
    resolution: int | None = 16
    min_norm: float = 0.0
    proof: bool = True

    def __post_init__(self) -> None:
        sections = self.sections
        if sum(one.dim for one in sections) != self.dim or (len(sections) > 1 and self.min_norm):
            raise ValueError("sections make up the whole vector, and each has a smallest norm of its own")
        most = min(min(provable_bits(one.dim) for one in sections), MOST_BITS - 1)
        if self.word_bits > most:
            raise ValueError(
                f"vectors of {self.dim} numbers and norm {self.program.max_norm:g} need words of more "
                "than 57 bits, which a gallery has not: scale them down and deal for a smaller max_norm"
            )
        _ = self.squares  # raises for norms out of range

    @property
    def sections(self) -> tuple[Section, ...]:
        """What vectors consist of: one section, or the program's."""
        whole = Section("vector", self.dim, self.program.max_norm, self.min_norm)
        return getattr(self.program, "sections", None) or (whole,)

    @property
    def entry(self) -> int:
        """The largest magnitude of a quantised coordinate: that of the longest section, raw."""
        return max(one.norm for one in self.sections)

    @property
    def norm(self) -> int:
        """The largest L2 norm of a quantised vector, raw."""
        return root(sum(one.norm**2 for one in self.sections))

    @property
    def squares(self) -> tuple[tuple[int, int], ...]:
        """The least and the greatest square of the norm of each section of an honest vector, raw."""
        return tuple(one.squares for one in self.sections)

    @property
    def word_bits(self) -> int:
        """Bits of a word, or LONG."""
        return word_bits((self.dim,), self.entry, SLOT_REJECTION)

    @property
    def rule(self) -> str:
        """What is computed, for people: ``S10 >= 0.8, to 2^-16``."""
        named = type(self.program).__str__ is not object.__str__
        what = str(self.program) if named else type(self.program).__name__
        return what if self.resolution is None else f"{what}, to 2^-{self.resolution}"

    @property
    def proves(self) -> bool:
        """Whether the norms of every slot are proved."""
        return self.proof and self.security == "malicious"

    def standing(self, owner: int) -> Standing:
        """Vectors of which nothing is known yet."""
        return Standing(owner, self.word_bits, self.entry.bit_length())

    def value(self, engine: Engine, vectors: Standing, shape: Shape, parts: Any) -> Value:
        """Vectors as an operand of the program."""
        bound, reach = Bound.of_norm(self.norm), span(self.word_bits)
        return Value(engine, parts, shape, FRACTION_BITS, bound, masked=True, span=reach, standing=vectors)


@dataclass(frozen=True, slots=True)
class Derived:
    """A value that :meth:`GalleryProgram.prepare` made of n slots, apart from any reading of the program."""

    value: Value

    def of(self, engine: Engine, owner: int) -> Value:
        """It among pairs, for another reading."""
        value = self.value
        moved = Value(
            engine,
            value.parts,
            value.shape,
            value.frac,
            value.bound,
            masked=value.masked,
            is_bit=value.is_bit,
            mask_bits=value.mask_bits,
            span=value.span,
        )
        return moved[:, None] if owner == 0 else moved[None]


@dataclass(frozen=True, slots=True)
class Filled:
    """Slots of one party as one side knows them: the vectors and what was prepared of them."""

    vectors: Standing
    derived: tuple[Derived, ...]
    count: int
    parts: Callable[[], tuple[Any, ...]]
    """What the reading holds of the vectors among pairs, where a gate asks for more than their products."""

    def among_pairs(self, engine: Engine, terms: Terms) -> tuple[Value, ...]:
        """The operands of a comparison."""
        owner = self.vectors.owner
        shape = (self.count, 1, terms.dim) if owner == 0 else (1, self.count, terms.dim)
        vectors = terms.value(engine, self.vectors, shape, self.parts)
        return vectors, *(one.of(engine, owner) for one in self.derived)


async def fill(engine: Engine, terms: Terms, vectors: Value) -> tuple[tuple[Derived, ...], Any]:
    """Prepare n slots of one party, and prove their norms.

    Args:
        engine: A reading whose streams count slots.
        terms: The gallery's.
        vectors: Masked, shape (n, N).

    Returns:
        What was prepared, and for every slot and section whether its norm is proved, shape (n, sections);
        None where nothing is proved, and at dealer and meter.
    """
    prepared = await terms.program.prepare(engine, vectors)
    for value in prepared:
        if value.shape[:1] != vectors.shape[:1]:
            raise TypeError("what a gallery prepares has the vectors' axis first")
        _ = value.parts
    proved = None
    if terms.proves:
        proved = await prove(vectors, terms.sections)
    elif engine.has_unchecked_openings:
        await check()
    return tuple(Derived(value) for value in prepared), proved


async def compare(engine: Engine, terms: Terms, x: Filled, y: Filled) -> Any:
    """Compare party 0's slots with party 1's, and open the results: shape (R, C)."""
    operands = (x.among_pairs(engine, terms), y.among_pairs(engine, terms))
    return await output(engine, await terms.program.compare(engine, *operands))
