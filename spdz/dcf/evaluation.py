"""Evaluating DCF keys; the construction is in the package's docstring."""

from __future__ import annotations

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.prf import FixedKeyHash
from spdz.dcf import binary, radix
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
from spdz.foundations.types import Block, Buffer, FieldArray


def evaluate(
    party: int, roots: Block, key: Buffer, points: Block, bits: int, w: int, digit_bits: int | None = None
) -> FieldArray:
    """One party's additive shares of beta [x < a] for n keys, each at its own point or at k points.

    Args:
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words of :func:`generate`.
        points: The public x below 2^bits, shape (n, 2) or (n, k, 2).
        bits: Width of the domain, 1 to 127.
        w: Payloads a key.
        digit_bits: Of the tree, where it is not the one of n keys.

    Returns:
        Shares of shape (n, w, 2) or (n, k, w, 2).

    Raises:
        ValueError: for shapes or a length that do not fit, or a point out of range.
    """
    n = len(roots)
    check_width(bits, w)
    if party not in (0, 1):
        raise ValueError(f"the party must be 0 or 1, not {party}")
    check_blocks("roots", roots, (n,))
    k = points.shape[1] if points.ndim == 3 else 1
    check_domain("points", points, (n, k) if points.ndim == 3 else (n,), bits)
    digit_bits = digit_bits or digit_width(n)
    if memoryview(key).nbytes != (size := key_bytes(n, bits, w, digit_bits)):
        raise ValueError(f"{n} keys of {bits} bits have {size} bytes, not {memoryview(key).nbytes}")
    words = np.frombuffer(key, dtype=WORD)
    index = int(words[0]) | int(words[1]) << 64
    if index >> INDEX_BITS:
        raise ValueError("the key does not begin with a hash index: it is damaged or not a key")
    fixed_key_hash = FixedKeyHash(index)
    tree = binary if digit_bits == 1 else radix
    sums = tree.evaluate(fixed_key_hash, party, roots, words[HEADER // 8 :], points.reshape(n, k, 2), bits, w)
    shares = field.from_words32(sums.reshape(*points.shape[:-1], w, 4))
    return field.neg(shares) if party else shares
