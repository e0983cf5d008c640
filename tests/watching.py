"""Watch every value of a run against its bound: those that gates are given, and all of the clear reading."""

from contextlib import ExitStack
from unittest.mock import patch

import numpy as np

from spdz import Value
from spdz.arithmetic import field
from spdz.readings.clear import Clear
from spdz.readings.party import Party


def within_bound(raw, bound):
    """Whether integers keep to a bound, entry and norm."""
    rows = np.atleast_1d(np.asarray(raw, dtype=object))
    squares = np.asarray((rows**2).sum(axis=-1))
    return np.abs(rows).max(initial=0) <= bound.entry and squares.max(initial=0) <= bound.norm**2


def form(value):
    """What all readings must agree on."""
    return value.shape, value.frac, value.masked, value.bound.entry, value.bound.norm


def put_together(first, second):
    """The integers that two parties hold parts of."""
    parts = [part for value in (first, second) for part in value.parts[first.masked : first.masked + 1]]
    if first.masked:
        assert np.array_equal(first.parts[0], second.parts[0])
        parts.append(first.parts[0])
    total = field.zeros(first.shape)
    for part in parts:
        if part is not None:
            total = field.add(total, part)
    return field.centered(total)


class Watch:
    """Keeps, while it is entered, what both parties give to gates, and every value in the clear."""

    def __init__(self):
        self.operands, self.clear, self._stack = ([], []), [], ExitStack()

    def __enter__(self):
        read, make = Party.read, Value.__init__

        def watched_read(party, gate, *operands):
            values = [one for one in operands if isinstance(one, Value)]
            self.operands[party.index].extend((type(gate).__name__, value) for value in values)
            return read(party, gate, *operands)

        def watched_make(value, *arguments, **options):
            make(value, *arguments, **options)
            if isinstance(value.engine, Clear):
                self.clear.append(value)

        self._stack.enter_context(patch.object(Party, "read", watched_read))
        self._stack.enter_context(patch.object(Value, "__init__", watched_make))
        return self

    def __exit__(self, *error):
        self._stack.close()

    @property
    def begun(self):
        """Whether a party has used anything of a job."""
        return any(self.operands)

    def beyond(self):
        """What exceeds its bound, as text."""
        found = []
        for (gate, first), (other, second) in zip(*self.operands, strict=True):
            assert gate == other and first.undecided == second.undecided
            if first.undecided:  # a comparison that is opened as bits has no parts
                continue
            raw = put_together(first, second)
            if not within_bound(raw, first.bound):
                found.append(f"an operand of {gate}: {raw.tolist()} exceeds {first.bound}")
        for value in self.clear:
            raw = value.parts[0]
            assert raw.shape == value.shape and raw.dtype in (np.int64, object)
            if not within_bound(raw, value.bound):
                found.append(f"in the clear: {value}, {raw.tolist()} exceeds {value.bound}")
        return found
