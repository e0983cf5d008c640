"""The order of operations: a frame leaves as soon as it can, and what it does not need is done meanwhile.

Before a frame come the operations that its bytes depend on, and whatever may refuse to go on. The others,
such as this party's part of the MAC check, follow while the frame travels. Where a refusal asks for a check
first (:class:`~spdz.foundations.errors.Wrapped`), what was opened before must have been recorded: what is put
off is done there, too.
"""

from __future__ import annotations

from collections.abc import Iterable

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


def lines(operations: Iterable[Operation]) -> list[str]:
    """The code."""
    written: list[str] = []
    segment: list[Operation] = []
    for one in operations:
        segment.append(one)
        if one.kind == "exchange":
            written += _exchange(segment[:-1], one)
            segment = []
        elif one.kind == "check":
            written += map(line, segment)
            segment = []
    return [*written, *map(line, segment)]


def _exchange(before: list[Operation], frame: Operation) -> list[str]:
    """The operations since the last frame, and this frame."""
    payload = {slot.name for slot in frame.operands}
    first = _closure(before, payload, ("effect", "refusal"))
    at_once = {id(one) for one in first}
    written, put_off = [], []
    for one in before:
        if id(one) not in at_once:
            put_off.append(one)
        elif one.kind == "refusal":
            records = _closure(put_off, set(), ("record",))
            condition, _, action = line(one).partition(": ")
            written += [f"{condition}:", *(f"    {text}" for text in [*map(line, records), action])]
        else:
            written.append(line(one))
    if not put_off:
        return [*written, line(frame)]
    target = "" if frame.target is None else f"{frame.target.name} = "
    sent = frame.text.replace("Exchange", "Post").format(*(slot.name for slot in frame.operands))
    return [*written, sent, *map(line, put_off), f"{target}yield TAKE"]


def line(one: Operation) -> str:
    """One operation as code."""
    text = one.text.format(*(slot.name for slot in one.operands))
    return text if one.target is None else f"{one.target.name} = {text}"
