"""Key derivation and pseudo-random expansion: SHA-256 ratchet, AES-CTR, fixed-key AES hashes.

A tape's jobs draw their keys from a forward ratchet: ``chain' = H(next, chain)``, ``key = H(job, chain)``;
a third hash gives the key under which the job's stored correction is sealed.
Once a chain value is overwritten, neither it nor an earlier job's key can be recomputed (forward secrecy).
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from spdz.foundations.types import Block, Buffer

CHAIN_BYTES = 32
"""Length of a chain value and of a job key."""

_BLOCK = 16
_LOW64 = (1 << 64) - 1
_ZERO_COUNTER = bytes(_BLOCK)
_NEXT = b"spdz prf v1: next chain\0"
_JOB = b"spdz prf v1: job key\0"
_SEAL = b"spdz prf v1: seal key\0"
_FIXED_KEY_LABEL = b"spdz prf v1: fixed AES key"
_CIRCULAR_LABEL = b"spdz prf v1: circular AES key\0"

_Words: TypeAlias = npt.NDArray[np.uint64]

Batches: TypeAlias = Sequence[tuple[slice, bytes]]
"""Consecutive slices that cover n keys from the first on, each with its public 16-byte key."""


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

    @property
    def permute(self) -> Callable[[Buffer, Buffer], int]:
        """AES_k alone: from a buffer to one that has room for a block more."""
        return self._encryptor.update_into

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


def one_batch(n: int, key: bytes) -> Batches:
    """All n keys under one public key; no batch where there is no key."""
    return [(slice(0, n), key)] if n else []


class CircularHash:
    """H_k(x) = AES_k(sigma(x)) xor sigma(x), sigma(low, high) = (high, high xor low), for batches of blocks.

    Circular correlation-robust when AES is modelled as an ideal cipher: H(x xor Delta), also with Delta
    XORed to it, looks random to whoever does not know Delta. Without sigma it is not, as Delta cancels
    between the hash and what is XORed to it. Guo, Katz, Wang, Yu, "Efficient and Secure Multiparty
    Computation from Fixed-Key Block Ciphers", IEEE S&P 2020 (sigma is a linear orthomorphism).

    The AES key of a batch is the start of SHA-256("spdz prf v1: circular AES key" || 0 || the batch's key).

    Args:
        n: Number of blocks.
        batches: They cover the n blocks.

    Raises:
        ValueError: for slices that do not follow on each other and cover n blocks, or a key that has not
            16 bytes.
    """

    __slots__ = ("_batches", "_ends")

    def __init__(self, n: int, batches: Batches) -> None:
        self._batches: list[tuple[int, int, Callable[[Buffer, Buffer], int]]] = []
        end = 0
        for keys, key in batches:
            if keys.start != end or keys.stop <= end or keys.step not in (None, 1):
                raise ValueError(f"a batch must begin where the one before it ends, at {end}, not {keys}")
            if len(key) != _BLOCK:
                raise ValueError(f"the public key of a batch has {_BLOCK} bytes, not {len(key)}")
            aes_key = hashlib.sha256(_CIRCULAR_LABEL + key).digest()[:_BLOCK]
            encryptor = Cipher(algorithms.AES(aes_key), modes.ECB()).encryptor()
            self._batches.append((end, keys.stop, encryptor.update_into))
            end = keys.stop
        if end != n:
            raise ValueError(f"the batches cover {end} blocks, not {n}")
        self._ends = [last for _, last, _ in self._batches]

    def of_block(self, block: int) -> Callable[[int], int]:
        """The hash of one of the blocks, as integers."""
        _, _, update = self._batches[bisect_right(self._ends, block)]
        # update_into asks for room for one more block, less a byte, than it writes.
        room = bytearray(2 * _BLOCK)
        encrypted = memoryview(room)[:_BLOCK]

        def run(number: int) -> int:
            high = number >> 64
            sigma = high | (high ^ number & _LOW64) << 64
            update(sigma.to_bytes(_BLOCK, "little"), room)
            return int.from_bytes(encrypted, "little") ^ sigma

        return run

    def bind(self, start: int, inp: _Words, out: _Words) -> Callable[[], None]:
        """A function that hashes m of the blocks, from the block ``start`` on, each time that it is called.

        Args:
            start: Which block is the first.
            inp: All low words, then all high words: contiguous, shape (2, m).
            out: The same; it may be ``inp``.
        """
        stop = start + inp.shape[1]
        blocks = np.empty((inp.shape[1], 2), dtype=np.uint64)
        # update_into asks for room for one more block, less a byte, than it writes.
        scratch = np.empty(blocks.nbytes + _BLOCK, dtype=np.uint8)
        encrypted = scratch[: blocks.nbytes].view(np.uint64).reshape(blocks.shape)
        source, destination = blocks.reshape(-1).view(np.uint8).data, scratch.data
        calls = []
        for first, last, update in self._batches[bisect_right(self._ends, start) :]:
            if first >= stop:
                break
            begin, end = _BLOCK * max(first - start, 0), _BLOCK * (min(last, stop) - start)
            calls.append((update, source[begin:end], destination[begin : end + _BLOCK]))
        low, high, xor = blocks[:, 0], blocks[:, 1], np.bitwise_xor
        encrypted_low, encrypted_high, out_low, out_high = encrypted[:, 0], encrypted[:, 1], out[0], out[1]

        def run() -> None:
            _sigma_into(inp, low, high)
            for update, plain, room in calls:
                update(plain, room)
            xor(encrypted_low, low, out_low)
            xor(encrypted_high, high, out_high)

        return run


def _sigma_into(inp: _Words, low: _Words, high: _Words) -> None:
    """The linear orthomorphism: x and sigma(x) xor x are both bijective in x."""
    low[...] = inp[1]
    np.bitwise_xor(inp[0], inp[1], high)
