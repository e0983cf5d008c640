"""Plans of the programs that a session has run lately.

Reading a program for its plan costs about as much as running it once, so the plans of the last few are kept:
under everything that a program is made of, and only where nothing of that can change. A frozen dataclass of
numbers, names and more of the same is kept, if its ``__call__`` and the functions in its fields are declared
:func:`unchanging`. Any other
program (a function, which may read what has changed since; an array among the fields) is read anew for each
run.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, fields, is_dataclass
from fractions import Fraction
from types import FunctionType
from typing import Any, TypeVar

from spdz.foundations.types import Security, Shape
from spdz.readings.meter import Plan, measure
from spdz.readings.program import Program

KEPT = 16
"""Plans kept: a session uses a few thresholds in turn. One plan takes some kilobytes."""

_CONSTANTS = (int, float, bool, str, bytes, type(None), Fraction)


_MARK = "_spdz_unchanging"

Formula = TypeVar("Formula", bound=Callable[..., Any])


def unchanging(function: Formula) -> Formula:
    """Declare that what a function computes depends on its arguments alone: it reads nothing else."""
    setattr(function, _MARK, True)
    return function


@dataclass(slots=True)
class Known:
    """A program of which nothing can change.

    Attributes:
        plan: The meter's.
        runs: How often it was asked for.
        code: What was made of it since (:mod:`spdz.compiled.programs`).
    """

    plan: Plan
    runs: int = 0
    code: Any = None


class Plans:
    """Plans for one tape's shapes and security model, the latest used last."""

    def __init__(self, shapes: tuple[Shape, Shape], security: Security) -> None:
        self._shapes, self._security = shapes, security
        self._kept: OrderedDict[Hashable, Known] = OrderedDict()
        self._last: tuple[Program | None, Known | None] = None, None

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, program: Program) -> Plan:
        """The meter's plan of a program."""
        known = self.known(program)
        return measure(program, self._shapes, self._security) if known is None else known.plan

    def known(self, program: Program) -> Known | None:
        """What is kept of a program; None where it can change."""
        last, known = self._last
        if known is not None and last is program:  # the same object, of which nothing can change
            return known
        key = constants(program) if is_dataclass(program) else None
        if key is None:
            return None
        known = self._kept.pop(key, None) or Known(measure(program, self._shapes, self._security))
        self._kept[key] = known
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        self._last = program, known
        return known


def _is_unchanging(kind: Any) -> bool:
    """Whether a dataclass is frozen, and what its instances do when called is declared unchanging."""
    if not kind.__dataclass_params__.frozen:
        return False
    call = next((vars(base)["__call__"] for base in kind.__mro__ if "__call__" in vars(base)), None)
    return call is None or getattr(call, _MARK, False)


def constants(value: Any) -> Hashable | None:
    """Everything that ``value`` is made of, or None if any of it can change.

    Fields that a dataclass leaves out of comparison count as well, and 1, 1.0 and True are different.
    """
    kind = type(value)
    if kind in _CONSTANTS:
        return kind, repr(value)
    if kind is FunctionType and getattr(value, _MARK, False):
        return kind, value
    if kind is tuple:
        parts = [constants(part) for part in value]
    elif is_dataclass(kind) and _is_unchanging(kind):
        parts = [constants(getattr(value, field.name)) for field in fields(kind)]
        if hasattr(value, "__dict__") and len(value.__dict__) != len(parts):
            return None
    else:
        return None
    return None if None in parts else (kind, *parts)
