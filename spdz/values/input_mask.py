"""How long an input's mask is, and how a short one travels.

A long mask is uniform on F_p: 127 bits, perfectly hiding, 16 bytes a coordinate. The semi-honest mode may
use a short one, ``x + s`` with s uniform on [0, 2^63), 8 bytes a coordinate: the sum is within |x|_1 / 2^63
of independent of x, where a vector's |x|_1 <= sqrt(N) |x|_2. Short masks are used only where the public
bounds of all vectors of an input together make that at most 2^-40, and never in the malicious mode: a
cheater's out-of-range vector would show through.

In the field a short mask is ``r = -(s + base)``. The bases of the two parties are far apart, so that the
masks of an input and of a difference of the two inputs never wrap, and both can be compared in place. (A
difference within one vector wraps with a probability below 2^-40, and the dealer notices.)
"""

from __future__ import annotations

from math import prod

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.bound import root
from spdz.foundations.types import FieldArray, IntArray, Shape

LONG, SHORT = 127, 63
_HIDING_BITS = 40
_HIGH = (1 << 36, 1 << 26)
"""The parties' bases are 2^64 times these: the high word of s + base."""
_OFFSET = np.uint64(1 << 62)
"""Added on the wire, so that x + s is a positive 64-bit number for every |x| < 2^62."""
_ONES, _LOW63 = np.uint64((1 << 64) - 1), (1 << 63) - 1


def bits(shape: Shape, norm: int, *, malicious: bool) -> int:
    """Bits of the mask of an input of this shape with L2 norms of at most ``norm`` (raw units)."""
    largest_l1 = prod(shape[:-1]) * root(shape[-1]) * norm
    short = not malicious and 0 < largest_l1 <= 1 << (SHORT - _HIDING_BITS)
    return SHORT if short else LONG


def element_bytes(mask_bits: int) -> int:
    """Bytes of a masked coordinate on the wire."""
    return 8 if mask_bits == SHORT else 16


def from_pad(pad: FieldArray, owner: int, mask_bits: int) -> FieldArray:
    """The mask r that uniform field elements stand for."""
    if mask_bits == LONG:
        return pad
    r = np.empty(pad.shape, dtype=np.uint64)
    # p - (s + base) is the complement of 127 bits.
    np.bitwise_xor(pad[..., 0] >> np.uint64(1), _ONES, out=r[..., 0])
    r[..., 1] = _HIGH[owner] ^ _LOW63
    return r


def hide(x: IntArray, r: FieldArray) -> npt.NDArray[np.uint64]:
    """``x + s + 2^62`` for a short mask r."""
    words: npt.NDArray[np.uint64] = (r[..., 0] ^ _ONES) + x.view(np.uint64)
    words += _OFFSET
    return words


def public_part(words: npt.NDArray[np.uint64], owner: int) -> FieldArray:
    """The ``eps = x - r`` that these words stand for: ``words - 2^62 + base``."""
    eps = np.empty((*words.shape, 2), dtype=np.uint64)
    np.subtract(words, _OFFSET, out=eps[..., 0])
    np.subtract(np.uint64(_HIGH[owner]), words < _OFFSET, out=eps[..., 1])
    return eps
