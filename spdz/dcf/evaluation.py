"""Evaluating DCF keys; the construction is in the package's docstring."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.prf import FixedKeyHash
from spdz.dcf.binary import BinaryKey
from spdz.dcf.format import (
    HEADER,
    INDEX_BITS,
    WORD,
    check_blocks,
    check_domain,
    check_width,
    digit_width,
    key_bytes,
)
from spdz.dcf.radix_key import RadixKey
from spdz.foundations.types import Block, Buffer, FieldArray

Key: TypeAlias = RadixKey | BinaryKey
"""n keys of one party, made ready to be evaluated anywhere."""


def opened(party: int, roots: Block, key: Buffer, bits: int, w: int, digit_bits: int | None = None) -> Key:
    """Check keys and do once what does not depend on where they are evaluated.

    Args:
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words of :func:`spdz.dcf.generate`.
        bits: Width of the domain, 1 to 127.
        w: Payloads a key.
        digit_bits: Of the tree, where it is not the one of n keys.

    Raises:
        ValueError: for shapes or a length that do not fit, or for what is no key.
    """
    n = len(roots)
    check_width(bits, w)
    if party not in (0, 1):
        raise ValueError(f"the party must be 0 or 1, not {party}")
    check_blocks("roots", roots, (n,))
    digit_bits = digit_bits or digit_width(n)
    words = memoryview(key)
    if words.nbytes != (size := key_bytes(n, bits, w, digit_bits)):
        raise ValueError(f"{n} keys of {bits} bits have {size} bytes, not {words.nbytes}")
    index = int.from_bytes(words.cast("B")[:HEADER], "little")
    if index >> INDEX_BITS:
        raise ValueError("the key does not begin with a hash index: it is damaged or not a key")
    tree = BinaryKey if digit_bits == 1 else RadixKey
    return tree(FixedKeyHash(index), party, roots, np.frombuffer(words, dtype=WORD, offset=HEADER), bits, w)


def evaluate(
    party: int, roots: Block, key: Buffer, points: Block, bits: int, w: int, digit_bits: int | None = None
) -> FieldArray:
    """One party's additive shares of beta [x < a] for n keys, each at its own point or at k points.

    Args:
        party: As in :func:`opened`.
        roots: Likewise.
        key: Likewise.
        points: The public x below 2^bits, shape (n, 2) or (n, k, 2).
        bits: Likewise.
        w: Likewise.
        digit_bits: Likewise.

    Returns:
        Shares of shape (n, w, 2) or (n, k, w, 2).

    Raises:
        ValueError: as :func:`opened`, or for points of another shape or out of range.
    """
    n = len(roots)
    keys = opened(party, roots, key, bits, w, digit_bits)
    k = points.shape[1] if points.ndim == 3 else 1
    check_domain("points", points, (n, k) if points.ndim == 3 else (n,), bits)
    sums = np.moveaxis(keys.sums(points.reshape(n, k, 2)), 0, 2)
    shares = field.from_words32(sums.reshape(*points.shape[:-1], w, 4))
    return field.neg(shares) if party else shares
