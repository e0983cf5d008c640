"""The order of operations: a frame leaves as soon as it can, and what it does not need is done meanwhile.

Before a frame come the operations that its bytes depend on, and whatever may refuse to go on. The others,
such as this party's part of the MAC check, follow while the frame travels, and so does what comes later in
the program and is known already. Where a refusal asks for a check
first (:class:`~spdz.foundations.errors.Wrapped`), what was opened before must have been recorded: what is put
off is done there, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from spdz.compiled.slots import Slot
from spdz.compiled.trace import Operation


def needed(operations: Iterable[Operation], result: Slot) -> list[Operation]:
    """What an effect or the result depends on, in order."""
    return _closure(list(operations), {result.name}, ("effect", "record", "refusal", "exchange", "check"))


def _closure(operations: list[Operation], names: set[str], kinds: tuple[str, ...]) -> list[Operation]:
    """The operations of these kinds, and what they and these names depend on, in order."""
    names, kept = set(names), []
    for one in reversed(operations):
        if one.kind in kinds or (one.target is not None and one.target.name in names):
            names.update(slot.name for slot in one.operands)
            kept.append(one)
    return kept[::-1]


def lines(operations: Sequence[Operation], known: Iterable[str]) -> list[str]:
    """The code.

    Args:
        operations: In the order of the program.
        known: The variables that are there at the beginning.
    """
    written: list[str] = []
    done, there = set[int](), set(known)
    segment: list[Operation] = []

    def write(some: Iterable[Operation]) -> None:
        for one in some:
            written.append(line(one))
            note(one)

    def note(one: Operation) -> None:
        done.add(id(one))
        if one.target is not None:
            there.add(one.target.name)

    for number, one in enumerate(operations):
        if id(one) in done:
            continue
        if one.kind == "check":
            write([*segment, one])
            segment = []
        elif one.kind == "exchange":
            first, put_off = _before(segment, one)
            written += first
            for earlier in segment:
                note(earlier)
            meanwhile = [*put_off, *_ready(operations[number + 1 :], there, done)]
            written += _frame(one, [line(other) for other in meanwhile])
            for other in [*meanwhile, one]:
                note(other)
            segment = []
        else:
            segment.append(one)
    write(segment)
    return written


def _before(segment: list[Operation], frame: Operation) -> tuple[list[str], list[Operation]]:
    """Of the operations since the last frame, the lines that must come before this one, and the rest."""
    payload = {slot.name for slot in frame.operands}
    first = {id(one) for one in _closure(segment, payload, ("effect", "refusal"))}
    written, put_off = [], []
    for one in segment:
        if id(one) not in first:
            put_off.append(one)
        elif one.kind == "refusal":
            records = _closure(put_off, set(), ("record",))
            condition, _, action = line(one).partition(": ")
            written += [f"{condition}:", *(f"    {text}" for text in [*map(line, records), action])]
        else:
            written.append(line(one))
    return written, put_off


def _ready(later: Sequence[Operation], known: set[str], done: set[int]) -> list[Operation]:
    """Values further on that need nothing which is not there already."""
    there, ready = set(known), []
    for one in later:
        if one.kind == "value" and one.target is not None and id(one) not in done:
            if all(slot.name in there or slot.literal is not None for slot in one.operands):
                ready.append(one)
                there.add(one.target.name)
    return ready


def _frame(one: Operation, meanwhile: list[str]) -> list[str]:
    """The lines of an exchange, with what is done while the frame travels."""
    if not meanwhile:
        return [line(one)]
    sent = one.text.replace("Exchange", "Post").format(*(slot.name for slot in one.operands))
    target = "" if one.target is None else f"{one.target.name} = "
    return [sent, *meanwhile, f"{target}yield TAKE"]


def line(one: Operation) -> str:
    """One operation as code."""
    text = one.text.format(*(slot.name for slot in one.operands))
    return text if one.target is None else f"{one.target.name} = {text}"
