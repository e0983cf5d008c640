"""What is written down: operations in order, each with the variables that it reads and the one it sets.

Two operations with one text and the same operands are one. An operation is *early* if it depends on the tape
alone; one with an *effect* (a frame, a check, a refusal) stays where it is, and whatever no effect needs is
left out (:mod:`spdz.compiled.source`).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Literal

from spdz.compiled.slots import Form, Slot
from spdz.foundations.types import Shape

Kind = Literal["value", "effect", "record", "refusal", "exchange", "check"]
"""A *value* is computed; an *effect* may refuse to go on, or changes something; a *record* tells the check
what was opened; a *refusal* (``if ..: raise ..``) has what was recorded checked first; an *exchange* is a
frame."""


@dataclass(frozen=True, slots=True)
class Operation:
    """One line of code.

    Attributes:
        target: The variable that it sets; None for a statement.
        text: Python, with ``{0}``, ``{1}`` .. for the operands.
        operands: What it reads.
        kind: What it is for (see :data:`Kind`).
    """

    target: Slot | None
    text: str
    operands: tuple[Slot, ...]
    kind: Kind


class Trace:
    """The operations so far, and the objects that their texts name."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.names: dict[str, Any] = {}
        self._known: dict[Hashable, Slot] = {}
        self._objects: dict[int, str] = {}
        self._count = 0

    def note(
        self,
        text: str,
        *operands: Slot,
        form: Form,
        shape: Shape = (),
        bits: int = 127,
        reduced: bool = True,
        kind: Kind = "value",
        early: bool | None = None,
    ) -> Slot:
        """Write down an operation that sets a variable; returns the variable."""
        key = (text, form, shape, *(operand.name for operand in operands))
        if kind == "value" and key in self._known:
            return self._known[key]
        if early is None:
            early = kind == "value" and all(operand.early for operand in operands)
        self._count += 1
        target = Slot(f"v{self._count}", form, shape, bits, reduced, early)
        self.operations.append(Operation(target, text, operands, kind))
        if kind == "value":
            self._known[key] = target
        return target

    def do(self, text: str, *operands: Slot, kind: Kind = "effect") -> None:
        """Write down a statement."""
        self.operations.append(Operation(None, text, operands, kind))

    def named(self, what: Any) -> str:
        """A name for an object, in the texts: numbered, so that it hides no builtin and no variable."""
        if id(what) not in self._objects:
            kind = getattr(what, "__name__", "").strip("_<>")
            name = f"{kind if kind.isidentifier() else 'k'}_{len(self.names)}"
            self._objects[id(what)] = name
            self.names[name] = what
        return self._objects[id(what)]
