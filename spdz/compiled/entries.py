"""Texts that compute entry by entry: of one element, written out for very few, else as a comprehension."""

from __future__ import annotations

from spdz.compiled.slots import Slot

_WRITTEN_OUT = 4
"""Up to so many entries a list written out is quicker than a comprehension, which is a call (measured)."""


def each(expression: str, size: int, *operands: Slot) -> str:
    """The text of an expression for every entry.

    Args:
        expression: With ``{0}``, ``{1}`` .. for one entry of each operand.
        size: Entries of the result.
        operands: Each a single element, or as many as there are entries.
    """
    if size == 1:
        return expression
    few = [i for i, operand in enumerate(operands) if operand.form != "one"]
    places = [f"{{{i}}}" for i in range(len(operands))]
    if size <= _WRITTEN_OUT:
        entries = (
            expression.format(*(f"{p}[{k}]" if i in few else p for i, p in enumerate(places)))
            for k in range(size)
        )
        return f"[{', '.join(entries)}]"
    names = {i: f"e{i}" for i in few}
    entry = expression.format(*(names.get(i, place) for i, place in enumerate(places)))
    lists = ", ".join(places[i] for i in few)
    source = f"zip({lists})" if len(few) > 1 else lists
    return f"[{entry} for {', '.join(names.values())} in {source}]"
