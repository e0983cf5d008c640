"""What a score is: one formula for a job, and the same in two steps for a gallery.

In a gallery every vector stands (:mod:`spdz.readings.gallery`): what depends on one vector alone is prepared
once a slot, and a pair is compared with what both slots have prepared. A score whose formula asks nothing of
one vector alone (S2, S10) needs no steps; one that is given in steps needs no formula.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from inspect import isawaitable
from typing import TypeAlias

from spdz import Engine, Value, parallel
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.readings.plans import unchanging
from spdz.readings.program import result_of

Operand: TypeAlias = tuple[Value, ...]
"""Vectors, and what was prepared of them."""

Formula: TypeAlias = Callable[[Engine, Value, Value], Awaitable[Value]]
Preparation: TypeAlias = Callable[[Engine, Value], Awaitable[Operand]]
Comparison: TypeAlias = Callable[[Engine, Operand, Operand], Awaitable[Value]]


async def _missing(*operands: object) -> Value:
    """Stands for a step that was not given."""
    raise TypeError("this score was given no such step")


@unchanging
async def nothing(engine: Engine, vectors: Value, /) -> Operand:
    """Prepare nothing."""
    return ()


@dataclass(frozen=True, slots=True)
class Of:
    """The comparison that is a formula on what was prepared last: on the vectors, where nothing was."""

    formula: Formula

    @unchanging
    async def __call__(self, engine: Engine, x: Operand, y: Operand, /) -> Value:
        """Run the formula."""
        return await result_of("score", self.formula, engine, x[-1], y[-1])


class _Default(Of):
    """The comparison of a score that gives a formula alone."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A preparation whose result is looked at."""

    function: Preparation

    @unchanging
    async def __call__(self, engine: Engine, vectors: Value, /) -> Operand:
        """Prepare.

        Raises:
            TypeError: if the function is no ``async def``, or returns no tuple of values.
        """
        pending = self.function(engine, vectors)
        if not isawaitable(pending):
            raise TypeError(f"prepare is an `async def`: this one returned {type(pending).__name__}")
        prepared = await pending
        if not isinstance(prepared, tuple) or not all(isinstance(one, Value) for one in prepared):
            raise TypeError(
                f"prepare returns a tuple of values, `return (z,)` of one, not {type(prepared).__name__}"
            )
        return prepared


@dataclass(frozen=True, slots=True)
class _Compared:
    """A comparison whose result is looked at."""

    function: Comparison

    @unchanging
    async def __call__(self, engine: Engine, x: Operand, y: Operand, /) -> Value:
        """Compare."""
        return await result_of("score", self.function, engine, x, y)


@dataclass(frozen=True, slots=True)
class _Steps:
    """The formula of a score that gives steps alone."""

    prepare: Preparation
    compare: Comparison

    @unchanging
    async def __call__(self, engine: Engine, x: Value, y: Value, /) -> Value:
        """Prepare both sides in the same rounds, then compare them."""
        operands = (_operand(engine, self.prepare, vectors) for vectors in (x, y))
        return await self.compare(engine, *await parallel(*operands))


async def _operand(engine: Engine, prepare: Preparation, vectors: Value) -> Operand:
    return vectors, *await prepare(engine, vectors)


@dataclass(frozen=True, slots=True)
class Score:
    """A score function of two descriptors.

    Attributes:
        name: Identifier, e.g. ``"S10"``.
        title: The paper's name.
        similarity: True if larger means more alike (candidate: score >= threshold), False for a
            distance (candidate: score <= threshold).
        formula: The protocol on masked descriptors of shape S + (N,). If it is not given, ``compare`` of what
            ``prepare`` makes of both.
        max_norm: Largest L2 norm of a descriptor; a smaller one makes the dealt keys smaller.
        min_norm: Smallest L2 norm of a descriptor.
        prove_norm: Whether single jobs prove the norms (malicious mode); a gallery has terms of its own.
        prepare: What a gallery computes of vectors (n, N) alone, once a slot: a tuple of values whose first
            axis is the vectors'. Nothing, if it is not given.
        compare: What it computes of pairs: ``compare(engine, x, y)`` with x = (vectors, *prepared) of party
            0, axes (R, 1, ...), and y of party 1, axes (1, C, ...). The formula, if it is not given.

    Raises:
        TypeError: without a formula and a comparison, or with a preparation that no comparison uses.
    """

    name: str
    title: str
    similarity: bool
    formula: Formula = _missing
    max_norm: float = MAX_NORM
    prepare: Preparation = nothing
    compare: Comparison = _missing
    min_norm: float = 0.0
    prove_norm: bool = False

    def __post_init__(self) -> None:
        given = self.compare is not _missing and not isinstance(self.compare, _Default)
        if not given and self.prepare is not nothing:
            raise TypeError(f"the score {self.name} prepares what nothing uses: give `compare=` as well")
        if not given and self.formula is _missing:
            raise TypeError(f"the score {self.name} needs a formula, or a comparison: `compare=`")
        # What is derived is derived anew where dataclasses.replace has changed what it came from.
        if given and not isinstance(self.compare, (Of, _Compared)):
            object.__setattr__(self, "compare", _Compared(self.compare))
        if self.prepare is not nothing and not isinstance(self.prepare, _Prepared):
            object.__setattr__(self, "prepare", _Prepared(self.prepare))
        if self.formula is _missing or isinstance(self.formula, _Steps):
            object.__setattr__(self, "formula", _Steps(self.prepare, self.compare))
        if not given:
            object.__setattr__(self, "compare", _Default(self.formula))

    @unchanging
    async def __call__(self, engine: Engine, x: Value, y: Value, /) -> Value:
        """Run the formula."""
        return await result_of("score", self.formula, engine, x, y)

    def __str__(self) -> str:
        return f"{self.name} ({self.title})"

    def within(self, max_norm: float, *, min_norm: float = 0.0, prove: bool = False) -> Score:
        """The same score for descriptors of norms in a range (1 for normalised descriptors).

        Args:
            max_norm: The largest norm.
            min_norm: The smallest.
            prove: Whether single jobs prove it, for two rounds and two checks more in the malicious mode.
        """
        return replace(self, max_norm=max_norm, min_norm=min_norm, prove_norm=prove)
