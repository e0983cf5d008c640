"""What is written down: operations in order, each with the variables that it reads and the one it sets.

Two operations with one text and the same operands are one. An operation is *early* if it depends on the tape
alone; one with an *effect* (a frame, a check, a refusal) stays where it is, and whatever no effect needs is
left out (:mod:`spdz.compiled.source`).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from spdz.compiled.slots import Form, Slot
from spdz.foundations.types import Shape


@dataclass(frozen=True, slots=True)
class Operation:
    """One line of code.

    Attributes:
        target: The variable that it sets; None for a statement.
        text: Python, with ``{0}``, ``{1}`` .. for the operands.
        operands: What it reads.
        effect: Whether it must be done, and in this order with others.
    """

    target: Slot | None
    text: str
    operands: tuple[Slot, ...]
    effect: bool


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
        effect: bool = False,
        early: bool | None = None,
    ) -> Slot:
        """Write down an operation that sets a variable; returns the variable."""
        key = (text, form, shape, *(operand.name for operand in operands))
        if not effect and key in self._known:
            return self._known[key]
        if early is None:
            early = not effect and all(operand.early for operand in operands)
        self._count += 1
        target = Slot(f"v{self._count}", form, shape, bits, reduced, early)
        self.operations.append(Operation(target, text, operands, effect))
        if not effect:
            self._known[key] = target
        return target

    def do(self, text: str, *operands: Slot) -> None:
        """Write down a statement."""
        self.operations.append(Operation(None, text, operands, effect=True))

    def named(self, what: Any) -> str:
        """A name for an object, in the texts."""
        if id(what) not in self._objects:
            name = getattr(what, "__name__", "").strip("_<>") or "k"
            name = (
                name if name.isidentifier() and name not in self.names else f"{name or 'k'}_{len(self.names)}"
            )
            self._objects[id(what)] = name
            self.names[name] = what
        return self._objects[id(what)]
