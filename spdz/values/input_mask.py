"""How long an input's mask is, and how a short one travels.

A long mask is uniform on F_p: 127 bits, 16 bytes a coordinate. A short one is a *word* ``x + s`` with s
uniform on [0, 2^w), and it hides x perfectly as well: with B the largest magnitude of a coordinate, the owner
sends its words only if every one of them lies in [B, 2^w - B). Each such word stands for exactly one s,
whatever x is, so the words that are sent are uniform on that interval, and the chance 2 B / 2^w a coordinate
that they are not sent is the same for every x within the bound. Words that are not sent cost the job (or, in
a gallery, the slot). So w may be as short as the cost allows (:func:`word_bits`). The receiver refuses words
outside the interval.

A short mask hides the honest owner's vector, and nothing that the other party does changes what it shows; the
owner checks its own vector's bound, and MACs do not depend on how r is distributed. So both security modes
use short masks where w <= 63.

In the field ``r = -s``, and ``eps`` is the word: both are small integers, so that ``eps + r`` never wraps,
nor does a difference of two inputs. Gates that work on the integers behind a mask use that
(:func:`spdz.gates.masking.in_place`).
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.foundations.errors import ProtocolViolation, Unsent
from spdz.foundations.types import Buffer, FieldArray, IntArray, Shape

LONG = 127
_MOST = 63
"""Bits of the longest word: words are int64."""

JOB_REJECTION, SLOT_REJECTION = 25, 16
"""The chance that an input is not sent is at most 2^-25 for a job, which it costs, and 2^-16 for a slot."""


def job_bits(shape: Shape, norm: int) -> int:
    """Bits of the words of a job's input: all that the bytes hold which they need, or LONG."""
    w = word_bits(shape, norm, JOB_REJECTION)
    return w if w == LONG else min(8 * element_bytes(w), _MOST)


def word_bits(shape: Shape, norm: int, rejection: int) -> int:
    """Bits w of the words of an input of this shape with L2 norms of at most ``norm`` (raw), or LONG.

    The smallest w with ``2 n norm / 2^w <= 2^-rejection`` for all n coordinates together.
    """
    needed = (2 * prod(shape) * norm << rejection) - 1
    w = needed.bit_length()
    return w if norm > 0 and 0 not in shape and w <= _MOST else LONG


def provable_bits(n: int) -> int:
    """Bits of the longest words with ``n 2^(2 w) <= 2^126``: the square of a vector of n words cannot wrap.

    Then the sum of squares mod p is the square of the norm of the integers, whatever words were sent, and a
    test of it proves the norm (:mod:`spdz.gates.interval`). The word's length is the range proof.
    """
    return (127 - (2 * n - 1).bit_length()) // 2


def span(mask_bits: int) -> int:
    """The largest magnitude of a short mask; 0 for a long one, which may be any element."""
    return 0 if mask_bits == LONG else (1 << mask_bits) - 1


def element_bytes(mask_bits: int) -> int:
    """Bytes of a masked coordinate on the wire."""
    return 16 if mask_bits == LONG else -(-mask_bits // 8)


def from_pad(pad: FieldArray, mask_bits: int) -> FieldArray:
    """The mask r that uniform field elements stand for."""
    return pad if mask_bits == LONG else field.from_int64(-offsets(pad[..., 0], mask_bits))


def offsets(words: npt.NDArray[np.uint64], mask_bits: int) -> IntArray:
    """The s that uniform 64-bit words stand for: their lowest w bits."""
    low: IntArray = (words & np.uint64((1 << mask_bits) - 1)).view(np.int64)
    return low


def hide(x: IntArray, r: FieldArray, mask_bits: int, norm: int) -> npt.NDArray[Any]:
    """What the owner sends: elements ``x - r``, or words ``x + s``.

    Raises:
        Unsent: if a word would lie outside the interval.
    """
    if mask_bits == LONG:
        return field.sub_from_int64(x, r)
    words = x + field_offsets(r)
    if not all_inside(words, mask_bits, norm):
        raise unsuited()
    return words


def field_offsets(r: FieldArray) -> IntArray:
    """The s of short masks r = -s: the low word of p - s is 2^64 - 1 - s; 0 is 0 in both words."""
    s: npt.NDArray[np.uint64] = ~r[..., 0]
    s += r[..., 1] == 0
    return s.view(np.int64)


def as_elements(words: IntArray) -> FieldArray:
    """Words are below 2^63, and not negative: quicker than :func:`spdz.arithmetic.field.from_int64`."""
    elements = np.zeros((*words.shape, 2), dtype=np.uint64)
    elements[..., 0] = words
    return elements


def inside(words: IntArray, mask_bits: int, norm: int) -> npt.NDArray[np.bool_]:
    """Which words lie in [B, 2^w - B)."""
    return np.asarray((words >= norm) & (words < (1 << mask_bits) - norm))


def all_inside(words: IntArray, mask_bits: int, norm: int) -> bool:
    """Whether all do (there is at least one)."""
    return bool(words.min() >= norm and words.max() < (1 << mask_bits) - norm)


def pack(words: IntArray, mask_bits: int) -> npt.NDArray[np.uint8]:
    """Words as ceil(w / 8) bytes each, little-endian, shape (n, bytes).

    Each is written as 8 bytes, in order, so that the next one covers the upper ones, which are 0.
    """
    size, n = element_bytes(mask_bits), words.size
    octets = np.empty(size * n + 8 - size, dtype=np.uint8)
    np.ndarray((n,), dtype="<i8", buffer=octets, strides=(size,))[...] = words.reshape(-1)
    return octets[: size * n].reshape(n, size)


def unpack(raw: Buffer, shape: Shape, mask_bits: int, norm: int) -> IntArray:
    """Read a peer's words.

    Raises:
        ProtocolViolation: if one lies outside the interval.
    """
    words = read_packed(raw, shape, mask_bits)
    if not all_inside(words, mask_bits, norm):
        raise outside()
    return words


def unsuited() -> Unsent:
    """What to raise for words that must not be sent."""
    return Unsent(
        "the mask of this job does not suit this input, which happens once in 2^25 times (2^16 with proofs "
        "of norm): nothing was sent; run the next job"
    )


def outside() -> ProtocolViolation:
    """What to raise for words that no honest peer sends."""
    return ProtocolViolation("the peer sent a masked word outside the interval that honest words lie in")


def read_packed(raw: Buffer, shape: Shape, bits: int) -> IntArray:
    """Numbers as :func:`pack` has packed them. A peer's may have more bits than told, up to whole bytes."""
    size = element_bytes(bits)
    if size == 8:
        return np.frombuffer(raw, dtype="<i8").reshape(shape)
    n = prod(shape)
    octets = np.empty(size * n + 8 - size, dtype=np.uint8)
    octets[: size * n] = np.frombuffer(raw, dtype=np.uint8)
    # Each is read with the first bytes of the next one, which are cut off.
    whole = np.ndarray((n,), dtype="<i8", buffer=octets, strides=(size,))
    words: IntArray = (whole & np.int64((1 << 8 * size) - 1)).reshape(shape)
    return words
