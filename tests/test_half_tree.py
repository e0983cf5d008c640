"""Half-trees: shares of [a < x] Delta, exhaustively, at edges, against a slow model; and an attack."""

from __future__ import annotations

import hashlib
from collections import Counter
from itertools import product

import numpy as np
import pytest
from cryptography.hazmat.primitives.ciphers import Cipher, CipherContext, algorithms, modes
from half_tree_helpers import Pads, cut, integers, words

from spdz.arithmetic import prf
from spdz.arithmetic.prf import Batches
from spdz.dcf import half_tree
from spdz.dcf.half_tree import deal_tree, evaluate_tree
from spdz.foundations.types import Block

KEY = bytes(range(16))
EDGES = [0, 1, 2, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, 1 << 64, (1 << 64) + 1, (1 << 126) - 1, 1 << 126]
EDGES += [(1 << 127) - 2, (1 << 127) - 1, 0x5555 << 111, 0x2AAA << 112 | 0xAAAA << 40]


def ciphers(key: bytes) -> tuple[CipherContext, CipherContext]:
    aes_key = hashlib.sha256(b"spdz prf v1: circular AES key\0" + key).digest()[:16]
    cipher = Cipher(algorithms.AES(aes_key), modes.ECB())
    return cipher.encryptor(), cipher.decryptor()


def permute(context: CipherContext, x: int) -> int:
    return int.from_bytes(context.update(x.to_bytes(16, "little")), "little")


def sigma(x: int) -> int:
    low, high = x % (1 << 64), x >> 64
    return high | (high ^ low) << 64


def sigma_inverse(y: int) -> int:
    high, both = y % (1 << 64), y >> 64
    return (high ^ both) | high << 64


class Model:
    """One key on Python integers, as the module's docstring has it."""

    def __init__(self, key: bytes) -> None:
        self.encryptor, _ = ciphers(key)

    def hash(self, x: int) -> int:
        return permute(self.encryptor, sigma(x)) ^ sigma(x)

    def deal(self, a: int, levels: int, deltas: tuple[int, int], first1: int) -> tuple[int, list[int]]:
        bits = [a >> j & 1 for j in range(levels - 1, -1, -1)]
        delta = deltas[0] ^ deltas[1]
        first0 = first1 ^ (0 if bits[0] else delta)
        nodes = [f ^ (d if bits[0] else 0) for f, d in zip((first0, first1), deltas, strict=True)]
        corrections = []
        for bit in bits[1:]:
            hashed = [self.hash(s) for s in nodes]
            corrections.append(hashed[0] ^ hashed[1] ^ (0 if bit else delta))
            left = [h ^ (corrections[-1] if s & 1 else 0) for h, s in zip(hashed, nodes, strict=True)]
            nodes = [x ^ s if bit else x for x, s in zip(left, nodes, strict=True)]
            assert nodes[0] ^ nodes[1] == delta
        return first0, corrections

    def evaluate(self, delta: int, first: int, corrections: list[int], x: int, levels: int) -> int:
        left, right, total = first, first ^ delta, 0
        for j in range(levels - 1, -1, -1):
            node = right if x >> j & 1 else left
            total ^= left if x >> j & 1 else 0
            if j:
                left = self.hash(node) ^ (corrections[levels - 1 - j] if node & 1 else 0)
                right = left ^ node
        return total


def shares(pads: Pads, a: Block, x: Block, levels: int, batches: Batches) -> list[Block]:
    first0, corrections = deal_tree(a, levels, *pads.delta, pads.first1, batches)
    assert corrections.shape == (len(a), levels - 1, 2)
    firsts = (first0, pads.first1)
    return [
        evaluate_tree(delta, first, corrections, x, levels, batches)
        for delta, first in zip(pads.delta, firsts, strict=True)
    ]


@pytest.mark.parametrize("levels", range(1, 7))
def test_all_numbers_of_small_domains(levels):
    pairs = list(product(range(1 << levels), repeat=2))
    pads = Pads(len(pairs), seed=levels)
    a, x = (words(numbers) for numbers in zip(*pairs, strict=True))
    both = shares(pads, a, x, levels, cut(len(pairs), 3, 1, 256))
    pads.check(both, [a < x for a, x in pairs])


@pytest.mark.parametrize("levels", [63, 64, 65, 126, 127])
def test_edges_of_wide_domains(levels):
    numbers = {edge % (1 << levels) for edge in EDGES}
    numbers |= {(1 << levels) - 1 - number for number in numbers}
    pairs = list(product(sorted(numbers), repeat=2))
    pads = Pads(len(pairs))
    a, x = (words(numbers) for numbers in zip(*pairs, strict=True))
    pads.check(shares(pads, a, x, levels, cut(len(pairs), 100)), [a < x for a, x in pairs])


@pytest.mark.parametrize("levels", [1, 2, 7, 65, 127])
def test_words_and_shares_are_those_of_the_model(levels):
    """The format and the construction, to the bit."""
    n, model = 20, Model(KEY)
    pads, rng = Pads(n), np.random.default_rng(levels)
    a, x = ([int.from_bytes(rng.bytes(16), "little") % (1 << levels) for _ in range(n)] for _ in range(2))
    batches = [(slice(0, n), KEY)]
    first0, corrections = deal_tree(words(a), levels, *pads.delta, pads.first1, batches)
    both = [
        integers(evaluate_tree(delta, first, corrections, words(x), levels, batches))
        for delta, first in zip(pads.delta, (first0, pads.first1), strict=True)
    ]
    delta0, delta1, first1 = (integers(blocks) for blocks in (*pads.delta, pads.first1))
    for i in range(n):
        first, expected = model.deal(a[i], levels, (delta0[i], delta1[i]), first1[i])
        assert integers(first0[i]) == [first] and integers(corrections[i]) == expected
        assert both[0][i] == model.evaluate(delta0[i], first, expected, x[i], levels)
        assert both[1][i] == model.evaluate(delta1[i], first1[i], expected, x[i], levels)


@pytest.mark.parametrize("levels", [1, 2, 64, 65, 127])
def test_few_keys_are_walked_like_many(levels, monkeypatch):
    n = 7
    pads, rng = Pads(n), np.random.default_rng(levels)
    a, x = (words([int.from_bytes(rng.bytes(16), "little") % (1 << levels) for _ in range(n)]) for _ in "ax")
    batches = [(slice(0, 2), KEY), (slice(2, 3), KEY[::-1]), (slice(3, n), bytes(16))]
    first0, corrections = deal_tree(a, levels, *pads.delta, pads.first1, batches)
    for delta, first in zip(pads.delta, (first0, pads.first1), strict=True):
        results = []
        for few in (0, n):
            monkeypatch.setattr(half_tree, "_FEW", few)
            results.append(evaluate_tree(delta, first, corrections, x, levels, batches))
        assert np.array_equal(*results)


@pytest.mark.parametrize("k", [0, 1, 2, 3])
def test_several_points_are_walked_like_one(k):
    n, levels = 40, 9
    pads, rng = Pads(n), np.random.default_rng(k)
    a, points = np.zeros((n, 2), np.uint64), np.zeros((n, k, 2), np.uint64)
    a[:, 0], points[..., 0] = rng.integers(0, 1 << levels, n), rng.integers(0, 1 << levels, (n, k))
    batches = cut(n, 7)
    both = shares(pads, a, points, levels, batches)
    assert both[0].shape == (n, k, 2)
    for j in range(k):
        alone = shares(pads, a, points[:, j], levels, batches)
        np.testing.assert_array_equal([share[:, j] for share in both], alone)
        pads.check(alone, a[:, 0] < points[:, j, 0])


def test_batches_may_be_cut_anywhere(monkeypatch):
    """Keys that are dealt at once are evaluated in any strips of them, in parts of any size."""
    n, levels = 100, 12
    pads, rng = Pads(n), np.random.default_rng(0)
    a, x = np.zeros((2, n, 2), np.uint64)
    a[:, 0], x[:, 0] = rng.integers(0, 1 << levels, (2, n))
    batches = cut(n, 17, 1, 30)
    (delta, _), (first, corrections) = pads.delta, deal_tree(a, levels, *pads.delta, pads.first1, batches)
    whole = evaluate_tree(delta, first, corrections, x, levels, batches)
    monkeypatch.setattr(half_tree, "_CHUNK", 13)
    again = deal_tree(a, levels, *pads.delta, pads.first1, batches)
    np.testing.assert_array_equal(first, again[0])
    np.testing.assert_array_equal(corrections, again[1])
    np.testing.assert_array_equal(whole, evaluate_tree(delta, first, corrections, x, levels, batches))
    for start, stop in [(0, 1), (0, 50), (16, 19), (20, 100), (99, 100)]:
        part = slice(start, stop)
        strip = [
            (slice(max(keys.start, start) - start, min(keys.stop, stop) - start), key)
            for keys, key in batches
            if keys.start < stop and keys.stop > start
        ]
        alone = evaluate_tree(delta[part], first[part], corrections[part], x[part], levels, strip)
        np.testing.assert_array_equal(whole[part], alone)


def test_more_keys_than_are_worked_on_at_once():
    n, levels = 2 * half_tree._CHUNK + 77, 17
    pads, rng = Pads(n), np.random.default_rng(0)
    a, x = np.zeros((2, n, 2), np.uint64)
    a[:, 0], x[:, 0] = rng.integers(0, 1 << levels, (2, n))
    pads.check(shares(pads, a, x, levels, cut(n, 256)), a[:, 0] < x[:, 0])


def test_another_batch_key_gives_other_words():
    pads, a = Pads(5), words([0, 9, 5, 7, 15])
    ours, theirs = (deal_tree(a, 4, *pads.delta, pads.first1, cut(5, 5, seed=i))[1] for i in (0, 1))
    assert (ours != theirs).all()


def test_one_delta_for_all_keys_and_no_keys():
    pads = Pads(6)
    one = [delta[:1] for delta in pads.delta]
    pads.delta = tuple(np.broadcast_to(delta, (6, 2)) for delta in one)
    a, x, batches = words(range(6)), words([3] * 6), cut(6, 4)
    first0, corrections = deal_tree(a, 3, *one, pads.first1, batches)
    firsts = (first0, pads.first1)
    both = [evaluate_tree(d[0], f, corrections, x, 3, batches) for d, f in zip(one, firsts, strict=True)]
    pads.check(both, [True] * 3 + [False] * 3)
    empty = np.empty((0, 2), np.uint64)
    first0, corrections = deal_tree(empty, 3, *one, empty, [])
    assert evaluate_tree(one[0], first0, corrections, empty, 3, []).shape == (0, 2)


def test_what_does_not_fit_is_refused():
    pads, batches, a = Pads(2), cut(2, 2), words([1, 2])
    with pytest.raises(ValueError, match="1 to 127 levels"):
        deal_tree(a, 0, *pads.delta, pads.first1, batches)
    with pytest.raises(ValueError, match="1 to 127 levels"):
        evaluate_tree(pads.delta[0], pads.first1, np.empty((2, 127, 2), np.uint64), a, 128, batches)
    with pytest.raises(ValueError, match=r"a must be below 2\^1"):
        deal_tree(a, 1, *pads.delta, pads.first1, batches)
    with pytest.raises(ValueError, match="delta0 must be 0"):
        deal_tree(a, 2, pads.delta[1], pads.delta[1], pads.first1, batches)
    with pytest.raises(ValueError, match="delta1 must be 1"):
        deal_tree(a, 2, pads.delta[0], pads.delta[0], pads.first1, batches)
    first0, corrections = deal_tree(a, 2, *pads.delta, pads.first1, batches)
    with pytest.raises(ValueError, match=r"x must be below 2\^2"):
        evaluate_tree(pads.delta[0], first0, corrections, words([3, 4]), 2, batches)
    with pytest.raises(ValueError, match="words must be"):
        evaluate_tree(pads.delta[0], first0, corrections, a, 3, batches)
    with pytest.raises(ValueError, match="cover"):
        evaluate_tree(pads.delta[0], first0, corrections, a, 2, cut(1, 1))


def stolen_deltas(first: Block, own_delta: Block, corrections: Block, with_sigma: bool) -> Counter[int]:
    """What a party makes of the first correction words of a batch by one inverse AES call each.

    Without sigma the word of a_2 = 0 is AES(s) ^ AES(s ^ Delta), s being a node of level 1, left or right.
    """
    encryptor, decryptor = ciphers(KEY)
    found: Counter[int] = Counter()
    for left, delta, word in zip(*map(integers, (first, own_delta, corrections[:, 0])), strict=True):
        for s in (left, left ^ delta):
            for known in {s, sigma(s)} if with_sigma else {s}:
                inverse = permute(decryptor, permute(encryptor, known) ^ word)
                found.update({inverse ^ s, sigma_inverse(inverse) ^ s} if with_sigma else {inverse ^ s})
    return found


@pytest.mark.parametrize("party", [0, 1])
def test_inverse_aes_finds_delta_only_where_sigma_is_left_out(party, monkeypatch):
    n, levels = 32, 8
    pads, rng = Pads(n), np.random.default_rng(1)
    pads.delta = tuple(np.broadcast_to(delta[:1], (n, 2)) for delta in pads.delta)
    secret = integers(pads.delta[0][0] ^ pads.delta[1][0])[0]
    a, x = np.zeros((2, n, 2), np.uint64)
    a[:, 0], x[:, 0] = rng.integers(0, 1 << levels, (2, n))
    batches = [(slice(0, n), KEY)]

    def attack(with_sigma: bool) -> Counter[int]:
        pads.check(shares(pads, a, x, levels, batches), a[:, 0] < x[:, 0])
        first0, corrections = deal_tree(a, levels, *pads.delta, pads.first1, batches)
        first = (first0, pads.first1)[party]
        return stolen_deltas(first, pads.delta[party], corrections, with_sigma)

    found = attack(with_sigma=True)
    assert len(found) == 8 * n and secret not in found

    def identity(inp, low, high):
        low[...], high[...] = inp

    monkeypatch.setattr(prf, "_sigma_into", identity)
    found = attack(with_sigma=False)
    (best, votes), (_, next_votes) = found.most_common(2)
    assert best == secret and votes == np.sum((a[:, 0] >> np.uint64(levels - 2)) % 2 == 0) and next_votes == 1
