"""Standing inputs: vectors that are masked once, sent once, and compared with all that the other party has.

A gallery's slots hold them. A standing vector is a short word ``eps`` a coordinate with a mask ``r = -s``
(:mod:`spdz.values.input_mask`). Both are integers of some 44 bits, and products of such integers cost a
sixteenth of what products of field elements cost (:mod:`spdz.arithmetic.short`). To a program a standing
vector is a masked input like any other; only the products of one party's vectors with the other's look at the
integers (:mod:`spdz.gates.outer`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from spdz.arithmetic import field as elements
from spdz.foundations.types import FieldArray, IntArray


@dataclass(frozen=True, slots=True)
class Standing:
    """n vectors of one party's, as one side knows them.

    Attributes:
        owner: The party whose vectors they are: its axis among pairs as well.
        bits: Bits of a word and of s.
        plain_bits: Bits of an honest coordinate's magnitude.
        eps: The words, shape (n, N); None at the dealer.
        s: The negated masks; None at the other party.
        mac: This party's MAC shares of r, shape (n, N, 2); None at the dealer and in semi-honest mode.
    """

    owner: int
    bits: int
    plain_bits: int
    eps: IntArray | None = field(default=None, repr=False)
    s: IntArray | None = field(default=None, repr=False)
    mac: FieldArray | None = field(default=None, repr=False)

    @property
    def words(self) -> IntArray:
        """The words; ValueError where they are not known."""
        if self.eps is None:
            raise ValueError("the dealer does not know what the slots hold")
        return self.eps

    @property
    def offsets(self) -> IntArray:
        """s; ValueError at the other party."""
        if self.s is None:
            raise ValueError("only the owner and the dealer know a mask")
        return self.s

    def __len__(self) -> int:
        known = self.s if self.eps is None else self.eps
        return 0 if known is None else len(known)

    def among_pairs(self, part: Any) -> Any:
        """An array (n, ...) with an axis for the other party's vectors: (n, 1, ...) or (1, n, ...)."""
        return part[:, None] if self.owner == 0 else part[None]

    def parts(self, *, malicious: bool, dealt: bool) -> tuple[Any, ...]:
        """What a value of these vectors consists of, as field elements, among pairs."""
        mask = None if self.s is None else self.among_pairs(elements.from_int64(-self.s))
        if dealt:
            return (mask,)
        words = self.among_pairs(elements.from_int64(self.words))
        if not malicious or self.mac is None:
            return words, mask
        return words, mask, self.among_pairs(self.mac)

    def rows(self, which: Any) -> Standing:
        """Some of the vectors, as views if that can be."""
        eps, s, mac = (None if part is None else part[which] for part in (self.eps, self.s, self.mac))
        return replace(self, eps=eps, s=s, mac=mac)

    def cut(self, which: slice, entry: int) -> Standing:
        """Views of some coordinates, which are at most ``entry`` in an honest vector."""
        return replace(self.rows((slice(None), which)), plain_bits=min(self.plain_bits, entry.bit_length()))
