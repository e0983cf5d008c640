"""Programs: a protocol from two private inputs to one opened result.

A program is any ``async def program(engine, x, y)`` that returns a value, x belonging to party 0 and y to
party 1. It may carry an attribute ``max_norm`` (:data:`spdz.arithmetic.fixed_point.MAX_NORM` where it does
not): the largest L2 norm along the last axis that an input may have; ``min_norm``, the smallest; and
``prove_norm``: whether in the malicious mode every input is proved to lie between the two. Inputs are masked
before the program runs and its result is opened after it, so a program can neither mask an input twice nor
output unchecked.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from inspect import isawaitable
from typing import Any, Protocol, TypeVar

from spdz.arithmetic.fixed_point import MAX_NORM, encode, norm_bound, square_bounds
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import IntArray, Shape
from spdz.gates.inputs import MaskedInput
from spdz.gates.interval import inside
from spdz.gates.output import output
from spdz.gates.product import dot
from spdz.rounds.coroutine import parallel
from spdz.values.engine import Engine, Input
from spdz.values.input_mask import SLOT_REJECTION, provable_bits, word_bits
from spdz.values.refusals import described
from spdz.values.value import Value

Operand = TypeVar("Operand")


class Program(Protocol):
    """What the engine runs."""

    def __call__(self, engine: Engine, x: Value, y: Value, /) -> Awaitable[Value]:
        """Compute on x (party 0's) and y (party 1's)."""


def max_norm(program: Program) -> float:
    """The largest L2 norm of an input of this program."""
    return float(getattr(program, "max_norm", MAX_NORM))


def min_norm(program: Program) -> float:
    """The smallest L2 norm of an input of this program."""
    return float(getattr(program, "min_norm", 0.0))


def quantise(program: Program, data: Any, name: str) -> IntArray:
    """Check and quantise one party's input for a program; raises :class:`ValueError` for bad input."""
    return encode(data, max_norm=max_norm(program), min_norm=min_norm(program), name=name)


def declare(
    program: Program, shapes: tuple[Shape, Shape], data: Mapping[int, IntArray] | None = None
) -> tuple[Input, Input]:
    """Both inputs of a program, with the quantised data of the parties in ``data``."""
    known, proved = data or {}, bool(getattr(program, "prove_norm", False))
    if proved:
        _check_provable(program, shapes)
    first, second = (
        Input(owner, shape, norm_bound(max_norm(program), shape[-1]), proved, known.get(owner))
        for owner, shape in enumerate(shapes)
    )
    return first, second


def _check_provable(program: Program, shapes: tuple[Shape, Shape]) -> None:
    if shapes[0][-1:] != shapes[1][-1:]:
        raise ValueError("norms are proved of vectors of one length")
    for shape in shapes:
        norm = norm_bound(max_norm(program), shape[-1])
        if word_bits(shape, norm, SLOT_REJECTION) > provable_bits(shape[-1]):
            raise ValueError(
                f"vectors of {shape[-1]} numbers and norm {max_norm(program):g} are too large for a proof of "
                "their norm: scale them down and deal for a smaller max_norm, or for fewer in a job"
            )


async def run(engine: Engine, program: Program, inputs: Sequence[Input]) -> Any:
    """Mask the inputs, prove their norms where that is asked for, run the program, open its result."""
    x, y = await engine.read(MaskedInput(), *inputs)
    if engine.malicious and all(source.proved for source in inputs):
        await _prove(program, x, y)
    return await output(engine, await result_of("program", program, engine, x, y))


async def _prove(program: Program, x: Value, y: Value) -> None:
    """Refuse an input whose norm is not what an honest one has, before anything is computed with it.

    Raises:
        ProtocolViolation: naming the party.
    """
    least, most = min_norm(program), max_norm(program)
    bounds = square_bounds(least, most, x.shape[-1])
    for owner, proofs in enumerate(await parallel(inside(dot(x, x), *bounds), inside(dot(y, y), *bounds))):
        if proofs is not None and not proofs.all():
            raise ProtocolViolation(
                f"a vector of party {owner} has not a norm between {least:g} and {most:g}: nothing was "
                "computed with it"
            )


async def result_of(
    kind: str,
    function: Callable[[Engine, Operand, Operand], Awaitable[Value]],
    engine: Engine,
    x: Operand,
    y: Operand,
) -> Value:
    """Await a program, or a part of one that has its form.

    Args:
        kind: What the function is called where it is at fault.
        function: An ``async def function(engine, x, y)``.
        engine: The reading.
        x: What party 0 has: a value, or several.
        y: The same of party 1.

    Returns:
        Its result.

    Raises:
        TypeError: if it is no ``async def``, or does not return one value.
    """
    pending = function(engine, x, y)
    if not isawaitable(pending):
        raise TypeError(
            f"a {kind} is an `async def`: this one returned {type(pending).__name__} and nothing to await"
        )
    result = await pending
    if not isinstance(result, Value):
        raise TypeError(f"a {kind} must return one value, not {described(result)}")
    return result
