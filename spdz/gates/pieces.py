"""The public side of piecewise linear functions: thresholds, jumps, and the tables made of them once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.field import P
from spdz.arithmetic.unreduced import MOST_TERMS, Weights
from spdz.foundations.types import BigIntArray, Block, Shape

HALF = (P + 1) // 2
"""The inverse of 2 in F_p."""


@dataclass(frozen=True, slots=True)
class Function:
    """One piecewise linear function ``a_0 + b_0 z + sum_i [z >= T_i] (a_i + b_i z)``, in raw integers.

    Attributes:
        constants: a_0, a_1 .. a_k: the first constant, and its jump at each threshold.
        slopes: b_0, b_1 .. b_k, likewise.
        frac: Fractional bits of the result.
        entry: Largest magnitude of an honest result.
        is_bit: Whether it is 0 or 1.
    """

    constants: tuple[int, ...]
    slopes: tuple[int, ...]
    frac: int
    entry: int
    is_bit: bool = False

    def form(self, shape: Shape) -> tuple[int, Bound]:
        """Fractional bits and bound of a result of this shape."""
        return self.frac, Bound.of_entry(self.entry, shape)


class Pieces:
    """Functions on common thresholds.

    Args:
        thresholds: T_1 < .. < T_k, raw integers, at least one.
        functions: The functions, each with k jumps.
    """

    def __init__(self, thresholds: Sequence[int], *functions: Function) -> None:
        self.thresholds, self.functions = tuple(thresholds), functions
        jumps = {len(column) - 1 for f in functions for column in (f.constants, f.slopes)}
        if jumps != {len(self.thresholds)} or list(self.thresholds) != sorted(set(self.thresholds)):
            raise ValueError("thresholds must ascend, and every function have one jump a threshold")
        if len(self.thresholds) > MOST_TERMS:
            raise ValueError(f"at most {MOST_TERMS} thresholds, not {len(self.thresholds)}")

    def __repr__(self) -> str:
        return f"Pieces({self.thresholds}, {self.functions})"

    @property
    def farthest(self) -> int:
        """The largest magnitude of a threshold."""
        return max(abs(self.thresholds[0]), abs(self.thresholds[-1]))

    @cached_property
    def width(self) -> int:
        """Payload elements of a key: a second one, with the mask, if any slope jumps."""
        return 2 if any(any(f.slopes[1:]) for f in self.functions) else 1

    @cached_property
    def words(self) -> Block:
        """The thresholds as two's complement of 128 bits, shape (k, 2)."""
        packed = b"".join((number % (1 << 128)).to_bytes(16, "little") for number in self.thresholds)
        return np.frombuffer(packed, dtype="<u8").reshape(-1, 2)

    @cached_property
    def jumps(self) -> tuple[tuple[int, ...], ...]:
        """The columns of jumps that occur, each once."""
        columns = [column[1:] for f in self.functions for column in (f.constants, f.slopes)]
        return tuple(dict.fromkeys(column for column in columns if any(column)))

    @cached_property
    def rows(self) -> tuple[tuple[int | None, int | None], ...]:
        """Where each function's jumps of constant and slope are in :attr:`jumps`; None for no jumps."""
        place = {column: row for row, column in enumerate(self.jumps)}
        return tuple((place.get(f.constants[1:]), place.get(f.slopes[1:])) for f in self.functions)

    @cached_property
    def weights(self) -> Weights:
        """:attr:`jumps` as they weigh what a key gives."""
        return Weights(self.jumps)

    @cached_property
    def public(self) -> tuple[tuple[int, int], ...]:
        """Constant and slope of each function outside the key: a jump counts half, [z >= T] = 1/2 + .."""
        return tuple(
            (
                (f.constants[0] + sum(f.constants[1:]) * HALF) % P,
                (f.slopes[0] + sum(f.slopes[1:]) * HALF) % P,
            )
            for f in self.functions
        )

    @cached_property
    def clear(self) -> tuple[BigIntArray, list[tuple[BigIntArray, BigIntArray]]]:
        """The thresholds, and each function's constant and slope on every piece."""
        pieces = [
            (np.array(list(accumulate(f.constants)), object), np.array(list(accumulate(f.slopes)), object))
            for f in self.functions
        ]
        return np.array(self.thresholds, dtype=object), pieces
