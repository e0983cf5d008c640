"""Dealing DCF keys; the construction is in the package's docstring."""

from __future__ import annotations

import secrets

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
from spdz.foundations.types import Block, FieldArray


def generate(
    roots0: Block,
    roots1: Block,
    threshold: Block,
    payload: FieldArray,
    bits: int,
    *,
    digit_bits: int | None = None,
    index: int | None = None,
) -> bytes:
    """Deal n keys.

    Args:
        roots0: Party 0's pseudo-random root seeds, shape (n, 2). Bits 63 and 127 are not used.
        roots1: Party 1's.
        threshold: The secret a, shape (n, 2), below 2^bits.
        payload: The secret beta, shape (n, w, 2).
        bits: Width of the domain, 1 to 127.
        digit_bits: Of the tree, where it is not the one of n keys.
        index: Which public hash, below 2^32; a random one if not given.

    Returns:
        The correction words, ``key_bytes(n, bits, w)`` bytes, for both parties.

    Raises:
        ValueError: for shapes that do not fit, a threshold out of range or a payload that is not canonical.
    """
    if payload.ndim != 3 or payload.shape[2] != 2:
        raise ValueError(f"the payload must have shape (n, w, 2), not {payload.shape}")
    n, w = payload.shape[:2]
    check_width(bits, w)
    for name, seeds in (("roots0", roots0), ("roots1", roots1)):
        check_blocks(name, seeds, (n,))
    check_domain("threshold", threshold, (n,), bits)
    if not field.is_canonical(payload):
        raise ValueError("the payload must be below p")
    digit_bits = digit_bits or digit_width(n)
    index = secrets.randbits(INDEX_BITS) if index is None else index
    fixed_key_hash = FixedKeyHash(index)
    key = np.zeros(key_bytes(n, bits, w, digit_bits) // 8, dtype=WORD)
    key[0] = index
    tree = binary if digit_bits == 1 else radix
    tree.deal(fixed_key_hash, (roots0, roots1), threshold, payload, bits, key[HEADER // 8 :])
    return key.tobytes()
