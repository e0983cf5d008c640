"""Key derivation and pseudo-random expansion: SHA-256 ratchet, AES-CTR, fixed-key AES hash.

A tape's jobs draw their keys from a forward ratchet: ``chain' = H(next, chain)``, ``key = H(job, chain)``;
a third hash gives the key under which the job's stored correction is sealed.
Once a chain value is overwritten, neither it nor an earlier job's key can be recomputed (forward secrecy).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from spdz.foundations.types import Block

CHAIN_BYTES = 32
"""Length of a chain value and of a job key."""

_BLOCK = 16
_ZERO_COUNTER = bytes(_BLOCK)
_NEXT = b"spdz prf v1: next chain\0"
_JOB = b"spdz prf v1: job key\0"
_SEAL = b"spdz prf v1: seal key\0"
_FIXED_KEY_LABEL = b"spdz prf v1: fixed AES key"


def next_chain(chain: bytes) -> bytes:
    """One step of the forward ratchet: 32 bytes from which ``chain`` cannot be found."""
    return hashlib.sha256(_NEXT + chain).digest()


def job_key(chain: bytes) -> bytes:
    """The 32-byte key of the job at this step of the ratchet, independent of :func:`next_chain`."""
    return hashlib.sha256(_JOB + chain).digest()


def seal_key(chain: bytes) -> bytes:
    """The 32-byte key that this job's stored correction is sealed under, independent of the others."""
    return hashlib.sha256(_SEAL + chain).digest()


def seal(key: bytes, data: memoryview) -> None:
    """Encrypt or decrypt in place: XOR with the AES-CTR stream of a key that is used for nothing else."""
    if data.nbytes:
        Cipher(algorithms.AES(key), modes.CTR(_ZERO_COUNTER)).encryptor().update_into(data, data)


def expand(key: bytes, nbytes: int) -> Block:
    """Expand a key by AES in counter mode, the counter starting at 0.

    Args:
        key: 16 or 32 bytes, used for nothing else (each key has exactly one stream).
        nbytes: Length of the stream, a multiple of 16.

    Returns:
        A writable array of shape (nbytes / 16, 2).

    Raises:
        ValueError: for a key or a length of another size.
    """
    if len(key) not in (16, 32):
        raise ValueError(f"a PRF key has 16 or 32 bytes, not {len(key)}")
    if nbytes < 0 or nbytes % _BLOCK:
        raise ValueError(f"the stream's length must be a multiple of {_BLOCK} bytes, not {nbytes}")
    blocks = np.zeros((nbytes // _BLOCK, 2), dtype=np.uint64)
    if nbytes:
        stream = blocks.data.cast("B")
        Cipher(algorithms.AES(key), modes.CTR(_ZERO_COUNTER)).encryptor().update_into(stream, stream)
    return blocks


class FixedKeyHash:
    """The hash AES_k(x) xor x under one public key k (Matyas-Meyer-Oseas), on 128-bit blocks.

    Correlation-robust when AES under a fixed key is modelled as a random permutation: Guo, Katz, Wang, Yu,
    "Efficient and Secure Multiparty Computation from Fixed-Key Block Ciphers", IEEE S&P 2020. The key is
    the start of SHA-256("spdz prf v1: fixed AES key" || index), so nobody chose it.

    An object holds a cipher context and scratch memory: one thread at a time.

    Args:
        index: Which of a family of independent hashes.
    """

    __slots__ = ("_encryptor", "_scratch")

    def __init__(self, index: int = 0) -> None:
        label = _FIXED_KEY_LABEL + index.to_bytes(4, "little")
        # ECB is the raw block cipher, which is what the construction calls for.
        cipher = Cipher(algorithms.AES(hashlib.sha256(label).digest()[:16]), modes.ECB())
        self._encryptor = cipher.encryptor()
        self._scratch = np.empty(0, dtype=np.uint8)

    def hash_into(self, inp: Block, out: Block) -> None:
        """Write the hash of every block of ``inp`` to ``out``.

        Args:
            inp: Contiguous ``uint64`` array of shape (n, 2).
            out: The same, not overlapping ``inp`` unless it is the same array.
        """
        size = inp.nbytes
        if not size:
            return
        # update_into asks for room for one more block, less a byte, than it writes.
        if len(self._scratch) < size + _BLOCK - 1:
            self._scratch = np.empty(size + _BLOCK, dtype=np.uint8)
        self._encryptor.update_into(inp.data.cast("B"), self._scratch.data)
        np.bitwise_xor(self._scratch[:size].view(np.uint64).reshape(inp.shape), inp, out=out)

    def bind(self, inp: Block, out: Block) -> Callable[[], None]:
        """``hash_into(inp, out)`` with its views made once; ``inp`` and ``out`` do not overlap."""
        scratch = np.empty(inp.nbytes + _BLOCK, dtype=np.uint8)
        encrypted = scratch[: inp.nbytes].view(np.uint64).reshape(inp.shape)
        update, xor = self._encryptor.update_into, np.bitwise_xor
        source, destination = inp.view(np.uint8).reshape(-1).data, scratch.data

        def run() -> None:
            update(source, destination)
            xor(encrypted, inp, out)

        return run
