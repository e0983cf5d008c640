"""Sections: consecutive coordinates of a gallery's vectors that have a norm of their own.

The vector in a slot is one section, unless the gallery's program says that it is several descriptors end to
end. Each is checked at its owner, and its norm is proved (specification, sections 22 and 27): a bound on the
whole would let one descriptor be as long as all of them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from spdz.arithmetic.fixed_point import encode, norm_bound, square_bounds
from spdz.foundations.types import IntArray
from spdz.gates.interval import inside
from spdz.gates.product import dot
from spdz.rounds.coroutine import parallel
from spdz.values.columns import columns
from spdz.values.value import Value


@dataclass(frozen=True, slots=True)
class Section:
    """One of them.

    Attributes:
        name: What it is called where it is refused.
        dim: Its coordinates.
        max_norm: Largest L2 norm.
        min_norm: Smallest L2 norm.
    """

    name: str
    dim: int
    max_norm: float
    min_norm: float = 0.0

    @property
    def norm(self) -> int:
        """The largest L2 norm when it is quantised, raw."""
        return norm_bound(self.max_norm, self.dim)

    @property
    def squares(self) -> tuple[int, int]:
        """The least and the greatest square of an honest one's norm, raw."""
        return square_bounds(self.min_norm, self.max_norm, self.dim)


def cuts(sections: Sequence[Section]) -> list[slice]:
    """Where each of them lies."""
    ends = list(accumulate(section.dim for section in sections))
    return [slice(end - section.dim, end) for end, section in zip(ends, sections, strict=True)]


def encode_sections(sections: Sequence[Section], array: Any) -> IntArray:
    """Check and quantise vectors of shape (n, N).

    Raises:
        ValueError: naming the section that is not as it should be.
    """
    if len(sections) == 1:
        (whole,) = sections
        return encode(array, max_norm=whole.max_norm, min_norm=whole.min_norm)
    parts = [
        encode(array[:, cut], max_norm=one.max_norm, min_norm=one.min_norm, name=one.name)
        for one, cut in zip(sections, cuts(sections), strict=True)
    ]
    return np.concatenate(parts, axis=1)


async def prove(vectors: Value, sections: Sequence[Section]) -> Any:
    """Open whether every section's norm is an honest one, all in the same rounds.

    Args:
        vectors: Masked by words, shape (n, N).
        sections: Of all their coordinates.

    Returns:
        Booleans of shape (n, number of sections); None at dealer and meter.
    """
    lanes = []
    for one, cut in zip(sections, cuts(sections), strict=True):
        alone = len(sections) == 1
        part = vectors if alone else columns(vectors, cut.start, cut.stop, max_norm=one.max_norm)
        lanes.append(inside(dot(part, part), *one.squares))
    proofs = await parallel(*lanes)
    return None if proofs[0] is None else np.stack(proofs, axis=1)
