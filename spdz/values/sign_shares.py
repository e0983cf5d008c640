"""Opening bits from shares of ``bit * Delta``: the lowest bit of a share is a share of the bit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import Block, Buffer

Octets = npt.NDArray[np.uint8]


def packed_signs(shares: Block) -> Octets:
    """The lowest bits of shares (n, 2), packed: what a party sends."""
    return np.packbits((shares[:, 0] & np.uint64(1)).astype(np.uint8), bitorder="little")


def opened_signs(own: Octets, theirs: Buffer, n: int) -> npt.NDArray[np.bool_]:
    """The n bits that both have sent.

    Raises:
        ProtocolViolation: if the peer's bytes hold more than n bits.
    """
    both = np.unpackbits(own ^ np.frombuffer(theirs, dtype=np.uint8), bitorder="little")
    if both[n:].any():
        raise ProtocolViolation("the peer sent bits beyond the last one")
    return both[:n].astype(np.bool_)


def sign_macs(shares: Block, bits: npt.NDArray[np.bool_], delta: Block) -> Block:
    """What must be the same blocks at both parties if the bits are right: ``S_i xor bit Delta_i``."""
    return shares ^ np.where(bits[:, None], delta, np.uint64(0))
