"""Distributed comparison function: keys k_0, k_1 with Eval(0, x) + Eval(1, x) = beta [x < a] in F_p.

Neither key tells anything about the threshold a or the payload beta. n keys are dealt and evaluated at once.

**Construction.** A binary tree of depth ``bits``; a party's state at a node is a 127-bit seed with a control
bit t as the block's top bit (at the root t is the party's index). With H the fixed-key hash of
:mod:`spdz.prf`, the child in direction d is H(s ^ (2^63 d + 1)), and where t = 1 the level's correction word
(CW) is XORed to it: one seed for both directions and a control bit for each. On the path of a the two
parties' seeds are independent and t_0 ^ t_1 = 1; off the path both states are equal. Node i also yields
payload j = Conv(H(s ^ 2j) ^ (t CW_ij)), Conv(y) = y mod p, and party 1 negates: off the path the two cancel,
on the path the dealer chose CW_ij so that they leave g_i = beta (a_(i+1) - a_i), where a_1 is the most
significant bit and a_0 = a_(bits+1) = 0. The sum over the path of x telescopes to beta a_(l+1) when x leaves
the path of a after node l, which is beta [x < a], and to 0 for x = a.

**Cost.** AES calls: n (bits + w (bits + 1)) for a party, 2n (2 bits + w (bits + 1)) for the dealer.

**Security.** Against the holder of one key, hybrids down the path: at node i the *other* party's seed is
uniform given all that precedes, so H gives fresh masks at its 2 + w distinct inputs. The lost child masks the
seed CW (it is the XOR of both parties' lost children), the children's top bits mask both control bits, the
kept child is the next uniform seed. Let T be the party with t = 1 and O the one without: CW_ij = y_T ^ r with
r = Conv(y_O) +- g_i (mod p). It is masked by y_T for O, and by y_O for T as r is then uniform. So the CWs are
indistinguishable from uniform strings; reduction mod p adds at most w (bits + 1) 2^-126. The control bit may
stay in the hash input: the holder knows the other's anyway, and the remaining 127 bits are uniform.

In the ideal-cipher model an attacker who makes q AES calls under one fixed key, under which m seeds are in
use, succeeds with probability about ((2 + w) q m + m^2) / 2^127: tweaks do not separate the m targets. Each
batch has its own public random key out of 2^32, so m is the (bits + 1) n of a batch and not of a mission:
2^20 for 8192 keys of 78 bits, which leaves 2^-41 for q = 2^64. The root seeds must be pseudo-random, each
used for one key only.

**Key format**, the same bytes for both parties, 64-bit words, little-endian, node-major:

    16 bytes                hash index below 2^32
    (bits, n, 2) words      seed CW; top bit: control-bit correction of the left child
    (bits + 1, w, n, 2)     payload CWs; top bit, the same for all j: left ^ right control-bit correction
                            (0 at the leaf)

Sources: Boyle, Gilboa, Ishai, "Secure computation with preprocessing via function secret sharing", TCC 2019;
Boyle et al., "Function secret sharing for mixed-mode and fixed-point secure computation", EUROCRYPT 2021
(the DCF); Boneh et al., "Lightweight techniques for private heavy hitters", IEEE S&P 2021 (a payload at every
prefix). Departure: payload CWs are XORed before conversion, and are shared by both directions.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from spdz import field
from spdz.prf import FixedKeyHash
from spdz.types import Block, Buffer, FieldArray

_WORD = np.dtype("<u8")
_HEADER = 16
_INDEX_BITS = 32
_CHUNK = 1024  # keys at a time: their seeds on all levels stay in the second-level cache
_GROUP = 8192  # payload blocks at a time: they and their temporaries stay close to the first level
_TOP = np.uint64(1 << 63)
_ONE, _32, _63 = np.uint64(1), np.uint64(32), np.uint64(63)
# right_shift(int64, 63) spreads the top bit over the word. To a ufunc, a 0-d array costs less than a scalar.
_SIGN = np.array(63, dtype=np.int64)
_SIGN.flags.writeable = False

_Words: TypeAlias = npt.NDArray[np.uint64]


class _BoundHash(FixedKeyHash):
    """The fixed-key hash with a quick form for one small buffer that is hashed at every level."""

    __slots__ = ()

    def bind(self, inp: Block, out: Block) -> Callable[[], None]:
        """``hash_into(inp, out)`` with its views made once; ``inp`` and ``out`` do not overlap."""
        scratch = np.empty(inp.nbytes + 16, dtype=np.uint8)
        encrypted = scratch[: inp.nbytes].view(np.uint64).reshape(inp.shape)
        update, xor = self._encryptor.update_into, np.bitwise_xor
        source, destination = inp.view(np.uint8).reshape(-1).data, scratch.data

        def run() -> None:
            update(source, destination)
            xor(encrypted, inp, out)

        return run


def key_bytes(n: int, bits: int, w: int) -> int:
    """Length of the correction words of n keys with w payloads each: a multiple of 16."""
    return _HEADER + 16 * n * (bits + w * (bits + 1))


def generate(roots0: Block, roots1: Block, threshold: Block, payload: FieldArray, bits: int) -> bytes:
    """Deal n keys.

    Args:
        roots0: Party 0's pseudo-random root seeds, shape (n, 2). Their top bits are not used.
        roots1: Party 1's.
        threshold: The secret a, shape (n, 2), below 2^bits.
        payload: The secret beta, shape (n, w, 2).
        bits: Width of the domain, 1 to 127.

    Returns:
        The correction words, ``key_bytes(n, bits, w)`` bytes, for both parties.

    Raises:
        ValueError: for shapes that do not fit, a threshold out of range or a payload that is not canonical.
    """
    if payload.ndim != 3 or payload.shape[2] != 2:
        raise ValueError(f"the payload must have shape (n, w, 2), not {payload.shape}")
    n, w = payload.shape[:2]
    _check_width(bits, w)
    for name, seeds in (("roots0", roots0), ("roots1", roots1)):
        _check_blocks(name, seeds, n)
    _check_domain("threshold", threshold, n, bits)
    if not field.is_canonical(payload):
        raise ValueError("the payload must be below p")
    index = secrets.randbits(_INDEX_BITS)
    fixed_key_hash = _BoundHash(index)
    key = np.zeros(key_bytes(n, bits, w) // 8, dtype=_WORD)
    key[0] = index
    seed_words, payload_words = _correction_words(key, n, bits, w)
    for part in _chunks(n):
        path = _top_bits(threshold[part], bits)
        seeds = np.empty((bits + 1, 2, path.shape[1], 2), dtype=np.uint64)
        for party, roots in enumerate((roots0, roots1)):
            _set_root(party, roots[part], seeds[0, party])
        flips = _deal_path(fixed_key_hash, seeds, path, seed_words[:, part])
        _deal_payload(fixed_key_hash, seeds, path, flips, payload[part], payload_words[:, :, part])
    return key.tobytes()


def evaluate(party: int, roots: Block, key: Buffer, points: Block, bits: int, w: int) -> FieldArray:
    """One party's additive shares of beta [x < a] for n keys, each at its own point.

    Args:
        party: 0 or 1.
        roots: This party's root seeds, shape (n, 2).
        key: The correction words of :func:`generate`.
        points: The public x, shape (n, 2), below 2^bits.
        bits: Width of the domain, 1 to 127.
        w: Payloads a key.

    Returns:
        Shares of shape (n, w, 2).

    Raises:
        ValueError: for shapes or a length that do not fit, or a point out of range.
    """
    n = len(roots)
    _check_width(bits, w)
    if party not in (0, 1):
        raise ValueError(f"the party must be 0 or 1, not {party}")
    _check_blocks("roots", roots, n)
    _check_domain("points", points, n, bits)
    if memoryview(key).nbytes != key_bytes(n, bits, w):
        size = key_bytes(n, bits, w)
        raise ValueError(f"{n} keys of {bits} bits have {size} bytes, not {memoryview(key).nbytes}")
    words = np.frombuffer(key, dtype=_WORD)
    index = int(words[0]) | int(words[1]) << 64
    if index >> _INDEX_BITS:
        raise ValueError("the key does not begin with a hash index: it is damaged or not a key")
    fixed_key_hash = _BoundHash(index)
    seed_words, payload_words = _correction_words(words, n, bits, w)
    sums = np.empty((n, w, 4), dtype=np.uint64)
    for part in _chunks(n):
        directions = _top_bits(points[part], bits)
        seeds = np.empty((bits + 1, directions.shape[1], 2), dtype=np.uint64)
        _set_root(party, roots[part], seeds[0])
        _walk(fixed_key_hash, seeds, directions, seed_words[:, part], payload_words[:-1, 0, part])
        sums[part] = _payload_sums(fixed_key_hash, seeds, payload_words[:, :, part])
    shares = field.from_words32(sums)
    return field.neg(shares) if party else shares


def _walk(
    fixed_key_hash: _BoundHash, seeds: Block, directions: _Words, seed_words: Block, flip_words: Block
) -> None:
    """Fill ``seeds`` (bits + 1, n, 2) from its first row along the path of ``directions``."""
    bits, n = directions.shape
    tweaks = np.zeros((bits, n, 2), dtype=np.uint64)
    np.bitwise_or(directions, _ONE, out=tweaks[..., 0])
    # The chosen child's control-bit correction goes on top: right = left ^ flip.
    low_words = seed_words[..., 0]
    high_words = directions & flip_words[..., 1]
    high_words ^= seed_words[..., 1]
    block, hashed, correction = (np.empty((n, 2), dtype=np.uint64) for _ in range(3))
    low, high = correction[:, 0], correction[:, 1]
    control = np.empty(n, dtype=np.int64)
    mask = control.view(np.uint64)
    signed = seeds.view(np.int64)[..., 1]
    xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
    hash_block = fixed_key_hash.bind(block, hashed)
    node = seeds[0]
    levels = zip(seeds[1:], signed[:-1], tweaks, low_words, high_words, strict=True)
    for child, sign, tweak, low_word, high_word in levels:
        xor(node, tweak, block)
        hash_block()
        right_shift(sign, _SIGN, control)
        bitwise_and(low_word, mask, low)
        bitwise_and(high_word, mask, high)
        xor(hashed, correction, child)
        node = child


def _payload_sums(fixed_key_hash: _BoundHash, seeds: Block, words: Block) -> _Words:
    """Sum the payload of all nodes, in base 2^32: shape (n, w, 4)."""
    levels, w, n = words.shape[:3]
    group = _group(n * w, levels)
    tweaks = _payload_tweaks(w, n)
    total, upper = (np.zeros((w, n, 2), dtype=np.uint64) for _ in range(2))
    workspace = np.empty((2, group, w, n, 2), dtype=np.uint64)
    for start in range(0, levels, group):
        nodes = seeds[start : start + group, None]
        blocks, corrections = workspace[:, : len(nodes)]
        np.bitwise_xor(nodes, tweaks, out=blocks)
        _hash_in_place(fixed_key_hash, blocks)
        np.bitwise_and(words[start : start + group], _control_masks(nodes), out=corrections)
        blocks ^= corrections
        total += np.add.reduce(blocks, axis=0)
        blocks >>= _32
        upper += np.add.reduce(blocks, axis=0)
    # At most 128 terms: upper < 2^39, and total (mod 2^64) - 2^32 upper is the sum of the lower halves.
    sums = np.empty((n, w, 2, 2), dtype=np.uint64)
    sums[..., 1] = upper.swapaxes(0, 1)
    sums[..., 0] = (total - (upper << _32)).swapaxes(0, 1)
    return sums.reshape(n, w, 4)


def _deal_path(fixed_key_hash: _BoundHash, seeds: Block, path: _Words, seed_words: Block) -> _Words:
    """Fill both parties' seeds (bits + 1, 2, n, 2) along the path from the first row, and the seed CWs.

    Returns:
        left ^ right control-bit correction as the top bit, shape (bits + 1, n); 0 at the leaf.
    """
    bits, n = path.shape
    # Children are (kept, lost): the kept one is in the direction of the path.
    tweaks = np.zeros((bits, 2, 2, n, 2), dtype=np.uint64)
    tweaks[:, 0, :, :, 0] = (path | _ONE)[:, None]
    tweaks[:, 1, :, :, 0] = (path ^ _TOP | _ONE)[:, None]
    flips = np.zeros((bits + 1, n), dtype=np.uint64)
    blocks, children = (np.empty((2, 2, n, 2), dtype=np.uint64) for _ in range(2))
    both, correction = (np.empty((2, n, 2), dtype=np.uint64) for _ in range(2))
    kept, lost = both
    kept_high, lost_low, lost_high = kept[:, 1], lost[:, 0], lost[:, 1]
    low, high = correction[..., 0], correction[..., 1]
    kept_children, of_0, of_1 = children[0], children[:, 0], children[:, 1]
    control = np.empty((2, n), dtype=np.int64)
    mask = control.view(np.uint64)
    xor, bitwise_and, right_shift = np.bitwise_xor, np.bitwise_and, np.right_shift
    hash_blocks = fixed_key_hash.bind(blocks, children)
    signed = seeds.view(np.int64)[..., 1]
    node = seeds[0]
    levels = zip(seeds[1:], signed[:-1], tweaks, flips[:-1], seed_words, strict=True)
    for child, sign, tweak, flip, words in levels:
        xor(node, tweak, blocks)
        hash_blocks()
        xor(of_0, of_1, both)
        # t_0 ^ t_1 must be 1 in the kept child and 0 in the lost one.
        xor(kept_high, lost_high, flip)
        bitwise_and(np.invert(flip, flip), _TOP, flip)
        xor(lost_high, flip, lost_high)
        words[...] = lost
        right_shift(sign, _SIGN, control)
        bitwise_and(lost_low, mask, low)
        bitwise_and(lost_high, mask, high)
        xor(kept_children, correction, child)
        node = child
    # So far the words hold the kept child's control-bit correction; the format wants the left child's.
    seed_words[..., 1] ^= flips[:-1] & path
    return flips


def _deal_payload(
    fixed_key_hash: _BoundHash, seeds: Block, path: _Words, flips: _Words, payload: FieldArray, words: Block
) -> None:
    """Write the payload CWs, ``words`` of shape (bits + 1, w, n, 2)."""
    levels, w, n = words.shape[:3]
    beta = payload.swapaxes(0, 1)
    # CW's top bit is the flip, so r's top bit is given, and it weighs 1 (mod p), as does that of y_O. What is
    # added to y_O is therefore (-1, 0 or 1) beta + (-1, 0 or 1): nine choices for each payload.
    signed = np.stack([field.neg(beta), field.zeros((w, n)), beta])
    choices = field.add(signed[:, None], field.from_ints([-1, 0, 1])[:, None, None]).reshape(-1, 2)
    own = np.arange(w * n).reshape(w, n)
    # All ones where T is party 1: then -g_i is added, else g_i.
    holder = _control_masks(seeds[:, None, 1])
    negate = holder[..., 0].view(np.int64)
    digits = (path >> _63).view(np.int64)[:, None]
    steps = (np.diff(digits, axis=0, prepend=0, append=0) ^ negate) - negate
    tweaks = _payload_tweaks(w, n)[:, None]
    group = _group(2 * n * w, levels)
    for part in (slice(start, start + group) for start in range(0, levels, group)):
        blocks = seeds[part, None] ^ tweaks
        _hash_in_place(fixed_key_hash, blocks)
        y_0, y_1 = blocks[:, :, 0], blocks[:, :, 1]
        swap = (y_0 ^ y_1) & holder[part]
        y_t, y_o = y_0 ^ swap, y_1 ^ swap
        top = (y_t[..., 1] ^ flips[part, None]) >> _63
        balance = ((y_o[..., 1] >> _63) - top).view(np.int64)
        added = choices.take((3 * steps[part] + balance + 4) * (w * n) + own, axis=0)
        r = field.add(field.from_blocks(y_o), added)
        r[..., 1] |= top << _63
        np.bitwise_xor(r, y_t, out=words[part])


def _control_masks(seeds: Block) -> Block:
    """All ones where t = 1, else zeros, in both words."""
    masks = np.empty(seeds.shape, dtype=np.int64)
    np.right_shift(seeds.view(np.int64)[..., 1], _SIGN, out=masks[..., 1])
    masks[..., 0] = masks[..., 1]
    return masks.view(np.uint64)


def _payload_tweaks(w: int, n: int) -> Block:
    """Even numbers, whereas the children's tweaks are odd; shape (w, n, 2) as inner loops of 2 are slow."""
    tweaks = np.zeros((w, n, 2), dtype=np.uint64)
    tweaks[..., 0] = np.arange(0, 2 * w, 2, dtype=np.uint64)[:, None]
    return tweaks


def _group(blocks: int, levels: int) -> int:
    """How many levels of so many blocks to work on at a time."""
    return min(levels, max(1, _GROUP // blocks))


def _hash_in_place(fixed_key_hash: _BoundHash, blocks: Block) -> None:
    flat = blocks.reshape(-1, 2)
    fixed_key_hash.hash_into(flat, flat)


def _set_root(party: int, roots: Block, out: Block) -> None:
    out[...] = roots
    high = out[:, 1]
    high &= ~_TOP
    high |= _TOP * np.uint64(party)


def _correction_words(key: _Words, n: int, bits: int, w: int) -> tuple[Block, Block]:
    """Views of shape (bits, n, 2) and (bits + 1, w, n, 2)."""
    words = key[_HEADER // 8 :]
    split = 2 * bits * n
    return words[:split].reshape(bits, n, 2), words[split:].reshape(bits + 1, w, n, 2)


def _top_bits(numbers: Block, bits: int) -> _Words:
    """The bits of n numbers, the most significant first, each as a word's top bit: shape (bits, n)."""
    result = np.empty((bits, len(numbers)), dtype=np.uint64)
    shifts = np.arange(64 - bits, 64, dtype=np.int64)[:, None]
    high = max(bits - 64, 0)
    np.left_shift(numbers[:, 1], (shifts[:high] + 64).view(np.uint64), out=result[:high])
    np.left_shift(numbers[:, 0], shifts[high:].view(np.uint64), out=result[high:])
    result &= _TOP
    return result


def _chunks(n: int) -> Iterator[slice]:
    """Nearly equal parts of at most ``_CHUNK``."""
    size = max(1, -(-n // max(1, -(-n // _CHUNK))))
    return (slice(start, start + size) for start in range(0, n, size))


def _check_width(bits: int, w: int) -> None:
    if not 1 <= bits <= 127:
        raise ValueError(f"the domain must have 1 to 127 bits, not {bits}")
    if w < 1:
        raise ValueError(f"there must be at least one payload, not {w}")


def _check_blocks(name: str, blocks: Block, n: int) -> None:
    if blocks.shape != (n, 2) or blocks.dtype != np.uint64:
        raise ValueError(f"{name} must be uint64 of shape ({n}, 2), not {blocks.dtype} of {blocks.shape}")


def _check_domain(name: str, numbers: Block, n: int, bits: int) -> None:
    _check_blocks(name, numbers, n)
    low, high = (int(numbers[:, word].max(initial=0)) for word in (0, 1))
    if high >> max(bits - 64, 0) or low >> bits:
        raise ValueError(f"{name} must be below 2^{bits}")
