"""All products of one party's standing vectors with the other's, by short integers.

With words ``x = ex - sx`` and ``y = ey - sy`` (:mod:`spdz.values.standing`) the masks' products are dealt:

    x_j . y_k = x_j . ey_k  -  ex_j . sy_k  +  sx_j . sy_k  =  ex_j . y_k  -  sx_j . ey_k  +  sx_j . sy_k.

In either form party 0 knows all of one term and party 1 all of another: both are products of integers below
2^58, exact (:func:`spdz.arithmetic.short.outer`). A term with a plain vector costs half of one with a mask,
so for half of the pairs the first form is used, for the other half the second. The MAC shares are not
multiplied out (:mod:`spdz.values.outer`).
"""

from __future__ import annotations

import numpy as np

from spdz.arithmetic import field, short
from spdz.foundations.types import FieldArray, IntArray
from spdz.values.standing import Standing
from spdz.values.value import Value


def standing_pairs(x: Value, y: Value) -> tuple[Standing, Standing] | None:
    """Party 0's and party 1's vectors, if the two values are these; in either order."""
    if x.standing is None or y.standing is None or x.standing.owner == y.standing.owner:
        return None
    return (x.standing, y.standing) if x.standing.owner == 0 else (y.standing, x.standing)


def dealt_products(x: Standing, y: Standing) -> FieldArray:
    """The products of the masks, shape (R, C)."""
    return short.outer(x.offsets, y.offsets, x.bits, y.bits)


def product_shares(party: int, x: Standing, y: Standing) -> FieldArray:
    """This party's term of every pair, shape (R, C)."""
    own, other = (x, y) if party == 0 else (y, x)
    plain = own.words - own.offsets
    rows, columns = len(x), len(y)
    by_rows = rows > 1
    half = (rows if by_rows else columns) // 2
    # The first form in the first part: there party 0 has the plain vectors.
    first, second = slice(0, half), slice(half, None)
    light, heavy = (first, second) if party == 0 else (second, first)
    result = np.empty((rows, columns, 2), dtype=np.uint64)
    for part, mine, bits, sign in (
        (light, plain, own.plain_bits, 1),
        (heavy, own.offsets, own.bits, -1),
    ):
        cut_own = mine[part] if by_rows == (party == 0) else mine
        cut_other = other.words[part] if by_rows == (party == 1) else other.words
        product = _outer(party, cut_own, cut_other, bits, other.bits)
        where = (part, slice(None)) if by_rows else (slice(None), part)
        result[where] = product if sign > 0 else field.neg(product)
    return result


def _outer(party: int, own: IntArray, other: IntArray, own_bits: int, other_bits: int) -> FieldArray:
    if party == 0:
        return short.outer(own, other, own_bits, other_bits)
    return short.outer(other, own, other_bits, own_bits)
