"""Chained hashes over slots: two robots that name the same head hold the same bytes in the same slots.

head(0) = SHA-256(label, owner, tape) and
head(k + 1) = SHA-256(head(k), k as u64, void as u8, SHA-256(eps), or 32 zeros for a void slot).
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable

_LINK = struct.Struct("<32sQ?32s")


def digest_of(eps: bytes | None) -> bytes | None:
    """What the chain takes of a slot: SHA-256 of its bytes, None for a void one."""
    return None if eps is None else hashlib.sha256(eps).digest()


def first_head(tape: str, owner: int) -> bytes:
    """The head over no slots."""
    return hashlib.sha256(f"spdz gallery head {owner} {tape}".encode()).digest()


def extended(heads: Iterable[bytes], digests: Iterable[bytes | None]) -> list[bytes]:
    """The heads over 0, 1, ... slots, with some more slots.

    Args:
        heads: The heads so far: at least the first.
        digests: What :func:`digest_of` makes of each further slot.
    """
    result = list(heads)
    for digest in digests:
        link = _LINK.pack(result[-1], len(result) - 1, digest is None, digest or bytes(32))
        result.append(hashlib.sha256(link).digest())
    return result
