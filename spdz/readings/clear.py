"""The clear engine: the same protocols on plain integers.

No security at all: each party sends its descriptor as it is, which is what robots do today. It is the
baseline that the benchmark measures against, and the oracle that the tests hold the secure readings to:
exact integer arithmetic on the quantised inputs, independent of the field kernels.
"""

from __future__ import annotations

from typing import Any

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import IntegerRing, whole
from spdz.values.engine import ClearText, Gate
from spdz.values.value import Value

_RING = IntegerRing()


class Clear(ClearText):
    """One party of the insecure baseline."""

    def __init__(self, index: int) -> None:
        self.index, self.ring, self.security = index, _RING, "semi-honest"

    def _read(self, gate: Gate, *operands: Any) -> Any:
        """Read a gate's meaning."""
        return gate.clear(self, *operands)

    @property
    def has_unchecked_openings(self) -> bool:
        """There is nothing to check."""
        return False

    def shared(self, x: Value) -> Value:
        """The same integers."""
        if not x.masked:
            x.decide()
            return x
        return self.value(x.parts[0], x.frac, x.bound, is_bit=x.is_bit)

    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """Add public integers."""
        return (whole(x.parts[0].astype(object) + raw),)

    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """There is no mask."""
        return x.parts

    def value(
        self, raw: Any, frac: int, bound: Bound, *, masked: bool = False, is_bit: bool = False
    ) -> Value:
        """Wrap integers, masked where a party's value is: a program that it refuses is refused here too."""
        integers = whole(raw)
        return Value(self, (integers,), integers.shape, frac, bound, masked=masked, is_bit=is_bit)
