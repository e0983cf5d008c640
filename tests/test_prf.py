"""The ratchet, the stream and the fixed-key hash."""

import hashlib
from itertools import pairwise

import numpy as np
import pytest
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from spdz.arithmetic import prf

CHAIN = bytes(range(32))


def aes(key: bytes, block: bytes) -> bytes:
    return Cipher(algorithms.AES(key), modes.ECB()).encryptor().update(block)


def test_ratchet_values_are_fixed():
    # A change here makes every tape that was ever dealt unreadable.
    assert prf.next_chain(CHAIN) == hashlib.sha256(b"spdz prf v1: next chain\0" + CHAIN).digest()
    assert prf.job_key(CHAIN) == hashlib.sha256(b"spdz prf v1: job key\0" + CHAIN).digest()


def test_ratchet_outputs_are_all_different():
    seen, chain = set(), CHAIN
    for _ in range(50):
        seen |= {chain, prf.job_key(chain)}
        chain = prf.next_chain(chain)
    assert len(seen) == 100 and all(len(value) == prf.CHAIN_BYTES for value in seen)


@pytest.mark.parametrize("key_bytes", [16, 32])
@pytest.mark.parametrize("blocks", [1, 2, 300])
def test_stream_is_aes_in_counter_mode(key_bytes, blocks):
    key = CHAIN[:key_bytes]
    expected = b"".join(aes(key, counter.to_bytes(16, "big")) for counter in range(blocks))
    assert prf.expand(key, 16 * blocks).tobytes() == expected


def test_first_block_under_the_zero_key():
    # AES-256 of the zero block, a published constant.
    assert prf.expand(bytes(32), 16).tobytes().hex() == "dc95c078a2408989ad48a21492842087"


def test_stream_shape_and_prefix():
    long, short = prf.expand(CHAIN, 16 * 9), prf.expand(CHAIN, 16 * 4)
    assert long.shape == (9, 2) and long.dtype == np.uint64 and long.flags.writeable
    np.testing.assert_array_equal(long[:4], short)
    assert prf.expand(CHAIN, 0).shape == (0, 2)


@pytest.mark.parametrize("nbytes", [-16, 1, 17])
def test_stream_of_part_blocks_is_refused(nbytes):
    with pytest.raises(ValueError, match="multiple of 16"):
        prf.expand(CHAIN, nbytes)


@pytest.mark.parametrize("key_bytes", [0, 15, 24, 33])
def test_keys_of_other_lengths_are_refused(key_bytes):
    with pytest.raises(ValueError, match="16 or 32 bytes"):
        prf.expand(bytes(key_bytes), 16)


@pytest.mark.parametrize("index", [0, 1])
def test_hash_is_matyas_meyer_oseas_on_every_block(index):
    key = hashlib.sha256(b"spdz prf v1: fixed AES key" + index.to_bytes(4, "little")).digest()[:16]
    hasher = prf.FixedKeyHash(index)
    # Growing and shrinking batches share one scratch buffer.
    for size in (3, 200, 1, 50, 0):
        blocks = prf.expand(CHAIN, 16 * size)
        before, out = blocks.copy(), np.zeros_like(blocks)
        hasher.hash_into(blocks, out)
        np.testing.assert_array_equal(blocks, before)
        for block, digest in zip(blocks, out, strict=True):
            cipher = np.frombuffer(aes(key, block.tobytes()), dtype=np.uint64)
            np.testing.assert_array_equal(digest, cipher ^ block)


def test_hash_in_place():
    hasher, blocks = prf.FixedKeyHash(), prf.expand(CHAIN, 160)
    out = np.empty_like(blocks)
    hasher.hash_into(blocks, out)
    hasher.hash_into(blocks, blocks)
    np.testing.assert_array_equal(blocks, out)


def test_hashes_of_two_objects_agree():
    blocks = prf.expand(CHAIN, 64)
    first, second = np.empty_like(blocks), np.empty_like(blocks)
    prf.FixedKeyHash().hash_into(blocks, first)
    prf.FixedKeyHash().hash_into(blocks, second)
    np.testing.assert_array_equal(first, second)


def circular_model(key: bytes, low: int, high: int) -> tuple[int, int]:
    """AES_k(sigma(x)) ^ sigma(x) on integers."""
    sigma = (high.to_bytes(8, "little")) + (high ^ low).to_bytes(8, "little")
    aes_key = hashlib.sha256(b"spdz prf v1: circular AES key\0" + key).digest()[:16]
    hashed = int.from_bytes(aes(aes_key, sigma), "little") ^ int.from_bytes(sigma, "little")
    return hashed % (1 << 64), hashed >> 64


@pytest.mark.parametrize("start", [0, 3, 4, 8])
@pytest.mark.parametrize("in_place", [False, True])
def test_circular_hash_of_some_blocks_of_several_batches(start, in_place):
    cuts = [0, 1, 4, 9, 10]
    batches = [(slice(i, j), bytes([i] * 16)) for i, j in pairwise(cuts)]
    keys = [key for keys, key in batches for _ in range(keys.start, keys.stop)]
    blocks = prf.expand(CHAIN, 16 * 10)
    expected = [circular_model(key, *block) for key, block in zip(keys, blocks.tolist(), strict=True)]
    inp = np.array(blocks[start:].T, order="C")
    out = inp if in_place else np.empty_like(inp)
    run = prf.CircularHash(10, batches).bind(start, inp, out)
    run()
    assert [tuple(block) for block in out.T.tolist()] == expected[start:]
    if not in_place:
        inp ^= np.uint64(5)
        before = out.copy()
        run()
        assert (before != out).any(axis=0).all()  # it reads what is there when it is called


@pytest.mark.parametrize(
    "cuts", [[(0, 4)], [(0, 6)], [(0, 3), (4, 5)], [(0, 3), (2, 5)], [(1, 5)], [(0, 0), (0, 5)], []]
)
def test_batches_that_do_not_cover_the_blocks_are_refused(cuts):
    with pytest.raises(ValueError, match="batch"):
        prf.CircularHash(5, [(slice(*cut), bytes(16)) for cut in cuts])


def test_batch_keys_of_other_lengths_are_refused():
    with pytest.raises(ValueError, match="16 bytes"):
        prf.CircularHash(5, [(slice(0, 5), bytes(32))])
