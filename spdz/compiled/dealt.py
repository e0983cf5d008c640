"""What was dealt, as places of the tape: the compiled reading's stream."""

from __future__ import annotations

from typing import Any

from spdz.compiled.slots import Slot
from spdz.compiled.trace import Trace
from spdz.foundations.types import Shape
from spdz.readings.streams import JobStream
from spdz.rounds.wire import ELEMENT_BYTES

PLACE = "<{} {} {}>"
"""How a text says: the integers of so many elements of the ``pad``, or ``stored``, from here on."""


def dealt_numbers(a: Slot) -> str:
    """The text that reads what was dealt as Python integers."""
    where, start = _place(a)
    return PLACE.format(where, start, a.size)


def dealt_array(a: Slot) -> str:
    """The text that reads it as elements."""
    where, start = _place(a)
    return f"{where}[{start}:{start + a.size}].reshape({(*a.shape, 2)})"


def _place(a: Slot) -> tuple[str, int]:
    if a.place is None:
        raise ValueError("this was not dealt")
    return a.place


class TracedStream:
    """A job's stream of which it is noted what is drawn where.

    Args:
        trace: Where it is noted.
        pad_bytes: Length of the pad.
        stored_bytes: Length of the correction.
    """

    def __init__(self, trace: Trace, pad_bytes: int, stored_bytes: int) -> None:
        self._trace = trace
        self._blank = JobStream(bytes(32), pad_bytes, bytes(stored_bytes))

    def pad(self, shape: Shape) -> Slot:
        """The next pseudo-random elements."""
        at, _ = self._blank.position
        self._blank.pad(shape)
        return Slot(f"pad {at}", "dealt", shape, early=True, place=("pad", at))

    def correction(self, shape: Shape) -> Slot:
        """The next stored elements."""
        _, at = self._blank.position
        self._blank.correction(shape)
        return Slot(f"stored {at}", "dealt", shape, early=True, place=("stored", at // ELEMENT_BYTES))

    def drawn(self, what: Any, *arguments: Any) -> Slot:
        """What a function of the stream draws from here on, such as keys."""
        text = f"{self._trace.named(what)}(stream.at{self._blank.position}, *{self._trace.named(arguments)})"
        what(self._blank, *arguments)
        return self._trace.note(text, form="other", early=True)

    def keys(self, party: int, shape: Shape, bits: int, payloads: int) -> Slot:
        """The next DCF keys."""
        return self.drawn(JobStream.keys, party, shape, bits, payloads)

    @property
    def exhausted(self) -> bool:
        """Whether the whole job has been drawn."""
        return self._blank.exhausted
