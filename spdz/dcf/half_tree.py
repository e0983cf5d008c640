"""Half-tree comparison: XOR shares of [a < x] Delta for a dealt secret a and a public x, 16 bytes a level.

Delta = Delta_0 ^ Delta_1 is secret, party i holds the block Delta_i, whose lowest bit is i. So the lowest bit
of a share of ``bit * Delta`` is a share of the bit and the whole block is its MAC: whoever holds one share
and Delta_i claims the other bit with the probability of a guess of Delta, 2^-127. None of the 128 bits may be
left out of what is compared.

**Construction.** A number has L = ``levels`` bits, the first the most significant; there is a node for each
of its prefixes but the empty one. Both parties' blocks at a node differ by Delta on the path of a and are
equal off it; the lowest bit of a block is its control bit t. H is :class:`spdz.arithmetic.prf.CircularHash`.

- Level 1 needs no hash and no root: its left node is dealt as an XOR share of (1 - a_1) Delta, ``first``, a
  random block of party 1's; its right node is left ^ Delta_i.
- The children of s are left = H(s) ^ (t CW) and right = left ^ s, with the level's correction word CW =
  H(s_0) ^ H(s_1) ^ (1 - a_j) Delta, s_i being party i's node on the path. Off the path equal nodes have equal
  children. On it exactly one t is set, so the left children differ by (1 - a_j) Delta and the right ones by
  a_j Delta.
- D_i(x) is the XOR of the *left siblings* on the path of x, that is of the left child wherever x goes right.
  The parties' left siblings differ only where x leaves the path of a to the right, by Delta:
  D_0 ^ D_1 = [a < x] Delta.

**Cost.** A key is L blocks for party 0 and L - 1 for party 1, whose ``first`` is its pad. n (L - 1) AES calls
a point; for the dealer 2n (L - 1).

**Security.** To party 1 ``first`` is its own random block; to party 0 it is masked by that of party 1. Party
i knows its own nodes; the other's on the path is its own ^ Delta, so every CW is masked by H(s_i ^ Delta),
and what is XORed to it depends on Delta: H must be *circular* correlation-robust. (Without sigma the CW of
a_j = 0 is AES(s_0) ^ AES(s_1), and one inverse AES call gives Delta.) So all words look uniform, whichever x
is walked; further points tell nothing more. In the ideal-cipher model an attacker with q AES calls under a
batch's key has an advantage of about 2 q m / 2^127 + m^2 / 2^128, where m is levels times keys of the batch:
for 256 keys of 17 levels and q = 2^64 that is 2^-50. Delta must be uniform but for its lowest bit, and fresh
for every batch: who learns one, from a pad that was not erased, learns no other. Masks are applied in full,
no branch and no index depends on a secret. (For few keys they are Python integers: see the threat model.)

Sources: Guo, Yang, Wang, Zhang, Xie, Liu, Zhao, "Half-tree: halving the cost of tree expansion in COT and
DPF", EUROCRYPT 2023; the prefix sums as in Storrier, Vadapalli, Lyons, Henry, "Grotto: screaming fast
(2+1)-PC or Z_2^n via (2,2)-DPFs", CCS 2023. Departures: no conversion at the leaf, as the payload is Delta
itself; level 1 is dealt.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spdz.arithmetic.field import to_list
from spdz.arithmetic.prf import Batches, CircularHash
from spdz.dcf.format import Words, check_blocks, check_domain, chunks
from spdz.foundations.types import Block

_CHUNK = 4096  # keys at a time: nodes and temporaries stay in the second-level cache (measured)
_FEW = 4  # points up to which Python's integers are quicker (measured)
_ONE = np.array(1, dtype=np.uint64)  # to a ufunc, a 0-d array costs less than a scalar
_ONE.flags.writeable = False


def deal_tree(
    a: Block, levels: int, delta0: Block, delta1: Block, first1: Block, batches: Batches
) -> tuple[Block, Block]:
    """Deal n keys.

    Args:
        a: The secrets, below 2^levels, shape (n, 2).
        levels: Bits of a number, 1 to 127.
        delta0: Party 0's Delta_0, lowest bit 0; broadcast to (n, 2).
        delta1: Party 1's Delta_1, lowest bit 1; broadcast to (n, 2).
        first1: Party 1's left nodes of level 1, random blocks, shape (n, 2).
        batches: They cover the n keys.

    Returns:
        Party 0's left nodes of level 1, shape (n, 2), and the correction words of both parties, shape
        (n, levels - 1, 2).

    Raises:
        ValueError: for shapes that do not fit, a number out of range, a lowest bit of Delta_i that is not i.
    """
    n = len(a)
    _check_levels(levels)
    check_domain("a", a, (n,), levels)
    check_blocks("first1", first1, (n,))
    own, other = _deltas(delta0, n), _deltas(delta1, n)
    for party, delta in enumerate((own, other)):
        if ((delta[..., 0] & _ONE) != party).any():
            raise ValueError(f"the lowest bit of delta{party} must be {party}")
    hashes = CircularHash(n, batches)
    first0, words = np.empty((n, 2), dtype=np.uint64), np.empty((n, levels - 1, 2), dtype=np.uint64)
    for part in chunks(n, _CHUNK):
        delta0_part = _planar(own[part])
        delta = delta0_part ^ _planar(other[part])
        goes_right, pad = _masks(_planar(a[part]), levels), _planar(first1[part])
        mask = goes_right(1)
        left = delta & ~mask ^ pad
        first0[part] = left.T
        node = left ^ (delta0_part & mask)
        _deal_path(hashes, part.start, node, delta, goes_right, words[part])
    return first0, words


def evaluate_tree(delta: Block, first: Block, words: Block, x: Block, levels: int, batches: Batches) -> Block:
    """Evaluate n keys at one or k public points each.

    Args:
        delta: The party's Delta_i, broadcast to (n, 2).
        first: The party's left nodes of level 1, shape (n, 2).
        words: The correction words, shape (n, levels - 1, 2).
        x: Points below 2^levels, shape (n, 2) or (n, k, 2).
        levels: Bits of a number, 1 to 127.
        batches: They cover the n keys.

    Returns:
        The party's D_i, of x's shape: the XOR of both parties' is [a < x] Delta.

    Raises:
        ValueError: for shapes that do not fit or a point out of range.
    """
    n = len(first)
    _check_levels(levels)
    check_blocks("first", first, (n,))
    check_blocks("words", words, (n, levels - 1))
    points = x[:, None] if x.ndim == 2 else x
    check_domain("x", points, (n, points.shape[1]), levels)
    delta, hashes = _deltas(delta, n), CircularHash(n, batches)
    result = np.empty(points.shape, dtype=np.uint64)
    if points.size <= 2 * _FEW:
        for key, point in np.ndindex(points.shape[:2]):
            (seed,), (offset,), (at,) = map(to_list, (first[key], delta[key], points[key, point]))
            walked = _walk_one(hashes.of_block(key), seed, offset, to_list(words[key]), at, levels)
            result[key, point] = np.frombuffer(walked.to_bytes(16, "little"), dtype="<u8")
        return result.reshape(x.shape)
    for part in chunks(n, _CHUNK):
        own, left = _planar(delta[part]), _planar(first[part])
        for point in range(points.shape[1]):
            goes_right = _masks(_planar(points[part, point]), levels)
            result[part, point] = _walk(hashes, part.start, left, own, goes_right, words[part]).T
    return result.reshape(x.shape)


def _deal_path(
    hashes: CircularHash,
    start: int,
    node: Words,
    delta: Words,
    goes_right: Callable[[int], Words],
    words: Block,
) -> None:
    """Walk down from party 0's node of level 1 and write the correction words."""
    other, of_0, of_1, control = (np.empty_like(node) for _ in range(4))
    hash_0, hash_1 = hashes.bind(start, node, of_0), hashes.bind(start, other, of_1)
    for j in range(words.shape[1]):
        np.bitwise_xor(node, delta, out=other)
        hash_0()
        hash_1()
        mask = goes_right(j + 2)
        of_1 ^= of_0
        of_1 ^= delta & ~mask
        words[:, j] = of_1.T
        _control_mask(node, control[0])
        of_1 &= control[0]
        # The child on the path: left = H(s) ^ (t CW), right = left ^ s.
        node &= mask
        node ^= of_0
        node ^= of_1


def _walk(
    hashes: CircularHash,
    start: int,
    left: Words,
    delta: Words,
    goes_right: Callable[[int], Words],
    words: Block,
) -> Words:
    """The XOR of the left siblings on the path, shape (2, m)."""
    mask = goes_right(1)
    total = left & mask
    node = left ^ (delta & mask)
    child, correction = np.empty_like(node), np.empty_like(node)
    control = np.empty_like(mask)
    low, high = correction
    bitwise_and, xor = np.bitwise_and, np.bitwise_xor
    hash_node = hashes.bind(start, node, child)
    for j in range(words.shape[1]):
        hash_node()
        _control_mask(node, control)
        bitwise_and(words[:, j, 0], control, low)
        bitwise_and(words[:, j, 1], control, high)
        xor(child, correction, child)
        mask = goes_right(j + 2)
        bitwise_and(node, mask, node)
        xor(node, child, node)
        bitwise_and(child, mask, child)
        xor(total, child, total)
    return total


def _walk_one(
    hash_node: Callable[[int], int], left: int, delta: int, words: list[int], point: int, levels: int
) -> int:
    """:func:`_walk` for one key at one point, on integers."""
    goes_right = -(point >> levels - 1)
    total, node = left & goes_right, left ^ delta & goes_right
    for level, word in enumerate(words, 2):
        child = hash_node(node) ^ word & -(node & 1)
        goes_right = -(point >> levels - level & 1)
        node = node & goes_right ^ child
        total ^= child & goes_right
    return total


def _control_mask(node: Words, out: Words) -> None:
    """All ones where t = 1, else zeros."""
    np.bitwise_and(node[0], _ONE, out)
    np.negative(out, out)


def _masks(numbers: Words, levels: int) -> Callable[[int], Words]:
    """For numbers (2, m): a function of a level that gives all ones where the bit of that level is 1.

    Its result is overwritten by the next call.
    """
    mask = np.empty(numbers.shape[1], dtype=np.uint64)
    places = [divmod(bit, 64) for bit in range(levels - 1, -1, -1)]

    def goes_right(level: int) -> Words:
        word, offset = places[level - 1]
        np.right_shift(numbers[word], np.uint64(offset), mask)
        np.bitwise_and(mask, _ONE, mask)
        return np.negative(mask, mask)

    return goes_right


def _planar(blocks: Block) -> Words:
    """Blocks (m, 2) as all low words, then all high words: a contiguous array of its own, shape (2, m)."""
    return np.array(blocks.T, order="C")


def _deltas(delta: Block, n: int) -> Block:
    if delta.dtype != np.uint64:
        raise ValueError(f"a Delta must be uint64, not {delta.dtype}")
    return np.broadcast_to(delta, (n, 2))


def _check_levels(levels: int) -> None:
    if not 1 <= levels <= 127:
        raise ValueError(f"a tree has 1 to 127 levels, not {levels}")
