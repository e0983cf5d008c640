"""Keys that add up to beta [x < a], checked exhaustively, at edges, and against a slow integer evaluator."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt
import pytest
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import dcf
from spdz.arithmetic import field, unreduced
from spdz.arithmetic.field import P
from spdz.dcf.format import tiles
from spdz.foundations.types import Block, FieldArray

TOP = 1 << 127
HEADER = 16


@pytest.fixture(params=[1, 2, 4], ids=["binary", "radix 4", "radix 16"], autouse=True)
def digit_bits(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """All batches, whatever their size, in each of the trees."""
    width: int = request.param
    monkeypatch.setattr("spdz.dcf.format.WIDE_DIGITS", {10**9: width} if width > 1 else {})
    return width


def words(numbers: list[int]) -> Block:
    packed = b"".join(number.to_bytes(16, "little") for number in numbers)
    return np.frombuffer(packed, dtype=np.uint64).reshape(-1, 2)


def random_blocks(rng: np.random.Generator, n: int) -> Block:
    return rng.integers(0, 1 << 64, (n, 2), dtype=np.uint64)


def random_payload(rng: np.random.Generator, n: int, w: int) -> FieldArray:
    return field.from_blocks(random_blocks(rng, n * w)).reshape(n, w, 2)


def shares(
    roots: tuple[Block, Block], keys: tuple[bytes, bytes], points: Block, bits: int, w: int
) -> FieldArray:
    parts = [dcf.evaluate(i, roots[i], keys[i], points, bits, w) for i in (0, 1)]
    assert all(field.is_canonical(part) for part in parts)
    return field.add(*parts)


def expected(thresholds: list[int], payload: FieldArray, points: list[int]) -> list[list[int]]:
    rows = zip(thresholds, field.to_ints(payload).tolist(), points, strict=True)
    return [[beta if x < a else 0 for beta in row] for a, row, x in rows]


class Deal:
    """Seeded roots and payloads for given thresholds, with the dealt key."""

    def __init__(self, thresholds: list[int], bits: int, w: int, seed: int = 0) -> None:
        rng, n = np.random.default_rng(seed), len(thresholds)
        self.thresholds, self.bits, self.w, self.n = thresholds, bits, w, n
        self.roots = random_blocks(rng, n), random_blocks(rng, n)
        self.payload = random_payload(rng, n, w)
        self.key = dcf.generate(*self.roots, words(thresholds), self.payload, bits)

    def sum_at(self, points: list[int], keys: tuple[bytes, bytes] | None = None) -> list[list[int]]:
        keys = keys or (self.key, self.key)
        total = shares(self.roots, keys, words(points), self.bits, self.w)
        return field.to_ints(total).tolist()  # type: ignore[no-any-return]

    def expected_at(self, points: list[int]) -> list[list[int]]:
        return expected(self.thresholds, self.payload, points)


@pytest.mark.parametrize("w", [1, 2, 3])
@pytest.mark.parametrize("bits", [1, 2, 3, 4, 5, 6])
def test_every_threshold_and_every_point_of_a_small_domain(bits: int, w: int) -> None:
    size = 1 << bits
    pairs = [(a, x) for a in range(size) for x in range(size)]
    deal = Deal([a for a, _ in pairs], bits, w, seed=bits)
    points = [x for _, x in pairs]
    assert deal.sum_at(points) == deal.expected_at(points)


@pytest.mark.parametrize("bits", [7, 63, 64, 65, 66, 68, 69, 78, 81, 126, 127])
def test_points_next_to_the_threshold_and_at_the_ends(bits: int) -> None:
    last = (1 << bits) - 1
    for a in (0, 1, last, last - 1, last // 2, last // 2 + 1, min(last, (1 << 64) - 1), last // 3):
        points = sorted({x for x in (a - 1, a, a + 1, 0, last, last // 2, 1 << (bits - 1)) if 0 <= x <= last})
        deal = Deal([a] * len(points), bits, 2, seed=bits)
        assert deal.sum_at(points) == deal.expected_at(points)


@settings(max_examples=40, deadline=None)
@given(st.data(), st.sampled_from([63, 64, 78, 80, 126, 127]), st.sampled_from([1, 7]), st.integers(1, 3))
def test_shares_add_up_to_the_payload_below_the_threshold(
    data: st.DataObject, bits: int, n: int, w: int
) -> None:
    last = (1 << bits) - 1
    number = st.integers(0, last)
    thresholds = data.draw(st.lists(number, min_size=n, max_size=n))
    offsets = data.draw(st.lists(st.integers(-2, 2) | number, min_size=n, max_size=n))
    points = [
        min(max(a + d, 0), last) if abs(d) <= 2 else d for a, d in zip(thresholds, offsets, strict=True)
    ]
    deal = Deal(thresholds, bits, w, seed=data.draw(st.integers(0, 1 << 32)))
    assert deal.sum_at(points) == deal.expected_at(points)


@pytest.mark.parametrize("n", [0, 1, 819, 820, 1639, 2047, 2048, 2049, 4500])
def test_batches_across_the_chunk_boundary(n: int) -> None:
    rng = np.random.default_rng(n)
    thresholds, points = (rng.integers(0, 1 << 20, n).tolist() for _ in range(2))
    deal = Deal(thresholds, 20, 2)
    assert deal.sum_at(points) == deal.expected_at(points)


@pytest.mark.parametrize("beta", [0, 1, P - 1, (P + 1) // 2, 1 << 64])
def test_extreme_payloads(beta: int) -> None:
    rng = np.random.default_rng(3)
    roots = random_blocks(rng, 4), random_blocks(rng, 4)
    payload = field.from_ints([[beta]] * 4)
    key = dcf.generate(*roots, words([5, 0, 15, 8]), payload, 4)
    total = shares(roots, (key, key), words([4, 0, 14, 9]), 4, 1)
    assert field.to_ints(total).ravel().tolist() == [beta, 0, beta, 0]


def test_many_payloads_exceed_a_group_of_levels() -> None:
    deal = Deal([40, 3, 63], 6, 3000)
    points = [39, 3, 62]
    assert deal.sum_at(points) == deal.expected_at(points)


# -- many points a key ------------------------------------------------------------------------------------


def sum_at_grid(deal: Deal, grid: list[list[int]]) -> list[list[list[int]]]:
    """Sums of shape (n, k, w) as integers."""
    points = words([x for row in grid for x in row]).reshape(deal.n, -1, 2)
    total = shares(deal.roots, (deal.key, deal.key), points, deal.bits, deal.w)
    assert total.shape == (deal.n, points.shape[1], deal.w, 2)
    return field.to_ints(total).tolist()  # type: ignore[no-any-return]


def expected_at_grid(deal: Deal, grid: list[list[int]]) -> list[list[list[int]]]:
    columns = [deal.expected_at(list(column)) for column in zip(*grid, strict=True)]
    return [list(rows) for rows in zip(*columns, strict=True)]


@pytest.mark.parametrize(("bits", "w"), [(1, 2), (3, 1), (5, 4), (6, 2)])
def test_every_key_of_a_small_domain_at_all_points_at_once(bits: int, w: int) -> None:
    size = 1 << bits
    deal = Deal(list(range(size)), bits, w, seed=bits)
    grid = [list(range(size))] * size
    assert sum_at_grid(deal, grid) == expected_at_grid(deal, grid)


@pytest.mark.parametrize(("n", "k"), [(1, 1), (1, 3), (2, 140), (3, 1), (7, 5)])
@pytest.mark.parametrize("bits", [20, 63, 64, 65, 81, 127])
def test_many_points_per_key_equal_as_many_single_evaluations(n: int, k: int, bits: int) -> None:
    rng, last, w = np.random.default_rng(bits), (1 << bits) - 1, 2
    thresholds = [int.from_bytes(rng.bytes(16), "little") & last for _ in range(n)]
    deal = Deal(thresholds, bits, w, seed=n)
    near = [[0, a, last, max(a - 1, 0), min(a + 1, last)] for a in thresholds]
    grid = [
        (row + [int.from_bytes(rng.bytes(16), "little") & last for _ in range(k)])[-k - 2 : -2]
        for row in near
    ]
    points = words([x for row in grid for x in row]).reshape(n, k, 2)
    for party in (0, 1):
        together = dcf.evaluate(party, deal.roots[party], deal.key, points, bits, w)
        for j in range(k):
            alone = dcf.evaluate(party, deal.roots[party], deal.key, points[:, j].copy(), bits, w)
            assert np.array_equal(together[:, j], alone)
    assert sum_at_grid(deal, grid) == expected_at_grid(deal, grid)


@pytest.mark.parametrize(
    ("n", "k"), [(1, 2047), (1, 2049), (2, 5000), (40, 60), (2050, 2), (3, 1400), (0, 3), (2, 0)]
)
def test_grids_across_the_chunk_boundary(n: int, k: int) -> None:
    rng = np.random.default_rng(n)
    thresholds = rng.integers(0, 1 << 20, n).tolist()
    deal = Deal(thresholds, 20, 2)
    grid = rng.integers(0, 1 << 20, (n, k)).tolist()
    if n * k:
        assert sum_at_grid(deal, grid) == expected_at_grid(deal, grid)
    else:
        empty = np.empty((n, k, 2), dtype=np.uint64)
        assert dcf.evaluate(0, deal.roots[0], deal.key, empty, 20, 2).shape == (n, k, 2, 2)


def test_a_grid_of_points_is_walked_in_tiles_of_bounded_size() -> None:
    for n, k in [(1, 5000), (5000, 1), (3, 700), (700, 3), (1025, 1025), (2, 1024), (8192, 140)]:
        covered = np.zeros((n, k), dtype=np.int64)
        for keys, points in tiles(n, k, 1024):
            covered[keys, points] += 1
            assert covered[keys, points].size <= 1024
        assert np.all(covered == 1)


# -- an independent evaluator of the key format on Python integers ------------------------------------


class SlowKey:
    """A key's blocks as integers, and the walk down either kind of tree."""

    def __init__(self, key: bytes, n: int, bits: int, w: int, digit_bits: int) -> None:
        blocks = [int.from_bytes(key[i : i + 16], "little") for i in range(0, len(key), 16)]
        label = b"spdz prf v1: fixed AES key" + blocks[0].to_bytes(4, "little")
        self.cipher = Cipher(algorithms.AES(hashlib.sha256(label).digest()[:16]), modes.ECB()).encryptor()
        self.blocks, self.n, self.bits, self.w, self.digit_bits = blocks[1:], n, bits, w, digit_bits

    def hashed(self, x: int) -> int:
        return int.from_bytes(self.cipher.update(x.to_bytes(16, "little")), "little") ^ x

    def path(self, party: int, root: int, k: int, x: int) -> list[tuple[int, list[int]]]:
        """The states on the path of x under key k, each with its corrected payload blocks."""
        walk = self.binary_path if self.digit_bits == 1 else self.radix_path
        return walk(party, root, k, x)

    def binary_path(self, party: int, root: int, k: int, x: int) -> list[tuple[int, list[int]]]:
        n, bits, w = self.n, self.bits, self.w
        seed_cw, payload_cw = self.blocks[: bits * n], self.blocks[bits * n :]
        assert len(payload_cw) == (bits + 1) * w * n
        state, nodes = root % TOP + party * TOP, []
        for i in range(bits + 1):
            t = state // TOP
            correction = [payload_cw[(i * w + j) * n + k] for j in range(w)]
            nodes.append((state, [self.hashed(state ^ 2 * j) ^ t * correction[j] for j in range(w)]))
            if i < bits:
                right = x >> (bits - 1 - i) & 1
                control = seed_cw[i * n + k] // TOP ^ right & correction[0] // TOP
                child = self.hashed(state ^ (1 + (right << 63)))
                state = child ^ t * (seed_cw[i * n + k] % TOP + control * TOP)
        return nodes

    def radix_path(self, party: int, root: int, k: int, x: int) -> list[tuple[int, list[int]]]:
        n, w, radix = self.n, self.w, 1 << self.digit_bits
        levels = -(-self.bits // self.digit_bits)
        child_cw, payload_cw = (
            self.blocks[: (levels - 1) * n * radix],
            self.blocks[(levels - 1) * n * radix :],
        )
        assert len(payload_cw) == w * levels * n * radix
        controls = TOP | 1 << 63
        state, nodes = root & ~controls | party * controls, []
        for i in range(levels):
            digit = x >> self.digit_bits * (levels - 1 - i) & radix - 1
            low, high = state >> 63 & 1, state >> 127
            payload = [
                self.hashed(state ^ digit ^ (j + 1) << 8)
                ^ high * payload_cw[((j * levels + i) * n + k) * radix + digit]
                for j in range(w)
            ]
            nodes.append((state, payload))
            if i < levels - 1:
                correction = child_cw[(i * n + k) * radix + digit]
                half = (1 << 64) - 1
                state = self.hashed(state ^ digit) ^ (correction & half) * low ^ (correction & ~half) * high
        return nodes


def integers(blocks: Block) -> list[int]:
    return [low | high << 64 for low, high in blocks.tolist()]


@pytest.mark.parametrize(("bits", "w"), [(1, 1), (5, 2), (64, 1), (78, 2), (127, 3)])
def test_each_share_equals_the_integer_reference(bits: int, w: int, digit_bits: int) -> None:
    last = (1 << bits) - 1
    thresholds = [last // 3, last, 0]
    deal = Deal(thresholds, bits, w, seed=bits)
    slow = SlowKey(deal.key, deal.n, bits, w, digit_bits)
    for points in (thresholds, [0, last, last // 2]):
        for party in (0, 1):
            fast = dcf.evaluate(party, deal.roots[party], deal.key, words(points), bits, w)
            for k, root in enumerate(integers(deal.roots[party])):
                payload = [blocks for _, blocks in slow.path(party, root, k, points[k])]
                sums = [sum(column) * (-1) ** party % P for column in zip(*payload, strict=True)]
                assert field.to_ints(fast[k]).tolist() == sums


# -- what keys hide, and what breaks them --------------------------------------------------------------


def on_path(a: int, bits: int, w: int, digit_bits: int) -> list[bool]:
    """Which blocks of one key are used at x = a."""
    if digit_bits == 1:
        return [True] * (bits + w * (bits + 1))
    levels, radix = -(-bits // digit_bits), 1 << digit_bits
    digits = [a >> digit_bits * (levels - 1 - i) & radix - 1 for i in range(levels)]
    used = [digit == d for digit in digits for d in range(radix)]
    return used[:-radix] + used * w


@pytest.mark.parametrize("bits", [11, 12])
def test_a_flipped_bit_on_the_path_is_used_by_exactly_one_party(bits: int, digit_bits: int) -> None:
    w, a = 2, 0b10110011000
    deal = Deal([a], bits, w)
    honest = deal.expected_at([a])
    rng = np.random.default_rng(5)
    expected_changes = on_path(a, bits, w, digit_bits)
    assert len(expected_changes) == len(deal.key) // 16 - 1
    for block, used in enumerate(expected_changes):
        # Below the top byte: a seed's flip reaches the last payload, a payload word's its node's.
        damaged = bytearray(deal.key)
        damaged[HEADER + 16 * block + int(rng.integers(15))] ^= 1 << int(rng.integers(8))
        changed = [
            deal.sum_at([a], keys) != honest
            for keys in ((bytes(damaged), deal.key), (deal.key, bytes(damaged)))
        ]
        assert sorted(changed) == [False, used], block


def test_a_flipped_control_bit_changes_the_sum(digit_bits: int) -> None:
    bits, a = 12, 0b101100111000
    deal = Deal([a], bits, 1)
    children = bits if digit_bits == 1 else (bits // digit_bits - 1) << digit_bits
    used = on_path(a, bits, 1, digit_bits)[:children]
    for block in (k for k, is_used in enumerate(used) if is_used):
        for byte in [15] if digit_bits == 1 else [7, 15]:
            damaged = bytearray(deal.key)
            damaged[HEADER + 16 * block + byte] ^= 0x80
            keys = (bytes(damaged), deal.key), (deal.key, bytes(damaged))
            assert sum(deal.sum_at([a], pair) != deal.expected_at([a]) for pair in keys) == 1


def test_a_damaged_hash_index_is_refused_or_changes_the_sum() -> None:
    deal = Deal([77], 7, 1)
    for byte in range(HEADER):
        damaged = bytearray(deal.key)
        damaged[byte] ^= 1
        keys = bytes(damaged), deal.key
        if byte < 4:
            assert deal.sum_at([5], keys) != deal.expected_at([5])
        else:
            with pytest.raises(ValueError, match="hash index"):
                deal.sum_at([5], keys)


def test_the_wrong_root_changes_the_sum() -> None:
    deal = Deal([77], 7, 1)
    deal.roots[0][0, 0] ^= np.uint64(1)
    assert deal.sum_at([5]) != deal.expected_at([5])


def test_the_places_of_the_control_bits_in_a_root_are_not_used(digit_bits: int) -> None:
    deal = Deal([77], 7, 1)
    for roots in deal.roots:
        roots[:, 0 if digit_bits > 1 else 1 :] ^= np.uint64(1 << 63)
    assert deal.sum_at([5]) == deal.expected_at([5])


def test_keys_of_two_thresholds_differ_in_about_half_of_all_bits(
    monkeypatch: pytest.MonkeyPatch, digit_bits: int
) -> None:
    monkeypatch.setattr("spdz.dcf.dealing.secrets.randbits", lambda bits: 1)
    n, bits = 64, 40
    ones = np.frombuffer(Deal([(1 << bits) - 1] * n, bits, 2).key, dtype=np.uint8)[HEADER:]
    # With the same roots, digits that neither number has would be corrected alike in trees of radix 4 and 16.
    zeros = np.frombuffer(Deal([0] * n, bits, 2, seed=int(digit_bits > 1)).key, dtype=np.uint8)[HEADER:]
    for key in (ones, zeros, ones ^ zeros):
        rows = np.unpackbits(key).reshape(-1, n * 128).mean(axis=1)
        # Rows of 64 words. At the binary leaf the top bit is 0 by definition, 1 bit in 128.
        assert np.all(np.abs(rows - 0.5) < 0.05)


def bit_means(blocks: list[int]) -> npt.NDArray[np.float64]:
    """How often each of the 128 bits is set; the standard deviation is 0.5 / sqrt(len(blocks))."""
    bits = np.unpackbits(words(blocks).copy().view(np.uint8).reshape(-1, 16), axis=1, bitorder="little")
    return np.asarray(bits.mean(axis=0))


@pytest.mark.parametrize("bits", [3, 8])
def test_on_the_path_states_and_corrected_payload_look_uniform_to_each_party(
    bits: int, digit_bits: int
) -> None:
    # Else a party would know that it is on the path.
    n, w = 400, 2
    for a in (0, 5):
        deal = Deal([a] * n, bits, w)
        slow = SlowKey(deal.key, n, bits, w, digit_bits)
        roots = [integers(deal.roots[party]) for party in (0, 1)]
        for x in (a, 6):
            paths = [[slow.path(party, roots[party][k], k, x) for k in range(n)] for party in (0, 1)]
            for party in (0, 1):
                for level in range(len(paths[party][0])):
                    nodes = [path[level] for path in paths[party]]
                    binary_leaf = digit_bits == 1 and level == bits
                    for blocks in zip(*[payload for _, payload in nodes], strict=True):
                        means = bit_means(list(blocks))[: 127 if binary_leaf else 128]
                        assert np.all(np.abs(means - 0.5) < 0.15)
                    if level:
                        assert np.all(np.abs(bit_means([state for state, _ in nodes]) - 0.5) < 0.15)


@pytest.mark.parametrize("bits", [3, 8])
def test_on_the_path_the_states_of_the_parties_are_independent_but_for_the_control_bits(
    bits: int, digit_bits: int
) -> None:
    n, a = 400, 5
    deal = Deal([a] * n, bits, 1)
    slow = SlowKey(deal.key, n, bits, 1, digit_bits)
    roots = [integers(deal.roots[party]) for party in (0, 1)]
    paths = [[slow.path(party, roots[party][k], k, a) for k in range(n)] for party in (0, 1)]
    controls = [127] if digit_bits == 1 else [63, 127]
    for level in range(len(paths[0][0])):
        pairs = zip(*[[path[level][0] for path in party] for party in paths], strict=True)
        means = bit_means([one ^ other for one, other in pairs])
        assert np.all(means[controls] == 1)
        assert np.all(np.abs(np.delete(means, controls) - 0.5) < 0.15)


def test_off_the_path_the_states_of_the_parties_are_equal(digit_bits: int) -> None:
    deal = Deal([0b10110110], 8, 1)
    slow = SlowKey(deal.key, 1, 8, 1, digit_bits)
    one, other = (slow.path(party, integers(deal.roots[party])[0], 0, 0b10010110) for party in (0, 1))
    differ = [a != b for (a, _), (b, _) in zip(one, other, strict=True)]
    assert differ == {1: [True] * 3 + [False] * 6, 2: [True] * 2 + [False] * 2, 4: [True, False]}[digit_bits]


def test_single_shares_look_uniform() -> None:
    n = 400
    deal = Deal([5] * n, 10, 1)
    for party in (0, 1):
        share = dcf.evaluate(party, deal.roots[party], deal.key, words([3] * n), 10, 1)
        bits = np.unpackbits(np.ascontiguousarray(share).view(np.uint8).reshape(n, 16), axis=1)
        means = np.delete(bits.mean(axis=0), 120)  # bit 127 is always 0
        assert np.all(np.abs(means - 0.5) < 0.15)


def test_batches_have_hash_keys_of_their_own() -> None:
    assert len({Deal([1], 2, 1).key[:HEADER] for _ in range(8)}) == 8


# -- keys made ready -------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [7, 64, 66, 127])
def test_keys_made_ready_sum_what_is_evaluated_whatever_the_higher_bits(bits: int) -> None:
    rng, n, k, w = np.random.default_rng(bits), 5, 3, 2
    last = (1 << bits) - 1
    thresholds, numbers = ([int.from_bytes(rng.bytes(16), "little") for _ in range(m)] for m in (n, n * k))
    deals = [Deal([a & last for a in some], bits, w) for some in (thresholds[:3], thresholds[3:])]
    raw, points = (words([x & mask for x in numbers]).reshape(n, k, 2) for mask in ((1 << 128) - 1, last))
    order = np.array([3, 0, 4, 1, 2])
    for party in (0, 1):
        roots = np.concatenate([deal.roots[party] for deal in deals])
        batches = [(slice(0, 3), deals[0].key), (slice(3, 5), deals[1].key)]
        together = dcf.Keys(party, bits, w, roots, batches, order=order)
        first = dcf.Keys(party, bits, w, roots[:3], batches[:1])
        evaluated = [
            dcf.evaluate(party, deal.roots[party], deal.key, points[order[keys]], bits, w)
            for deal, (keys, _) in zip(deals, batches, strict=True)
        ]
        for asked in (raw, points, *([raw[..., :1]] if bits <= 64 else [])):
            sums = together.sums(asked)
            assert sums.shape == (w, n, k, 4)
            assert np.abs(sums).max() < 1 << together.sum_bits
            shares = unreduced.elements(sums[:, order].transpose(1, 2, 0, 3))
            assert np.array_equal(shares, np.concatenate(evaluated))
            assert np.array_equal(first.sums(asked[order[:3]]), sums[:, order[:3]])
        with pytest.raises(ValueError, match="cannot take"):
            first.sums(raw)
        with pytest.raises(ValueError, match="cannot take"):
            together.sums(raw[..., : (bits - 1) // 64])


def test_a_damaged_key_is_refused_when_it_is_made_ready() -> None:
    deal = Deal([3, 4], 5, 1)
    for bad in (deal.key[:-16], b"\xff" * len(deal.key)):
        with pytest.raises(ValueError, match=r"bytes, not|hash index"):
            dcf.Keys(0, 5, 1, deal.roots[0], [(slice(0, 2), bad)])


# -- arguments -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "digits"), [(0, 1), (1, 4), (8, 4), (9, 2), (64, 2), (65, 1), (5000, 1)], ids=str
)
def test_the_number_of_keys_tells_which_tree_it_is(
    n: int, digits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    bits, w = 21, 2
    rng = np.random.default_rng(n)
    thresholds, points = (rng.integers(0, 1 << bits, n).tolist() for _ in range(2))
    deal = Deal(thresholds, bits, w)
    assert deal.sum_at(points) == deal.expected_at(points)
    levels = -(-bits // digits)
    blocks = bits + w * (bits + 1) if digits == 1 else (levels - 1 + w * levels) << digits
    assert len(deal.key) == dcf.key_bytes(n, bits, w) == 16 + 16 * n * blocks


@pytest.mark.parametrize(("n", "bits", "w"), [(1, 1, 1), (3, 63, 2), (16, 127, 1), (0, 5, 1)])
def test_the_key_has_the_announced_length(n: int, bits: int, w: int) -> None:
    size = dcf.key_bytes(n, bits, w)
    assert size % 16 == 0
    assert len(Deal([1] * n, bits, w).key) == size


@pytest.mark.parametrize("bits", [3, 63, 64, 65, 126])
def test_numbers_outside_the_domain_are_refused(bits: int) -> None:
    deal = Deal([0, 1], bits, 1)
    for bad in (1 << bits, (1 << 128) - 1, 1 << 127):
        with pytest.raises(ValueError, match="points must be below"):
            dcf.evaluate(0, deal.roots[0], deal.key, words([0, bad]), bits, 1)
        with pytest.raises(ValueError, match="points must be below"):
            dcf.evaluate(0, deal.roots[0], deal.key, words([0, 0, 0, bad]).reshape(2, 2, 2), bits, 1)
        with pytest.raises(ValueError, match="threshold must be below"):
            dcf.generate(*deal.roots, words([bad, 0]), deal.payload, bits)


def test_arguments_that_do_not_fit_are_refused() -> None:
    deal = Deal([3, 4], 5, 2)
    root, key, points = deal.roots[0], deal.key, words([1, 2])
    thresholds = words([3, 4])
    for bits in (0, 128):
        with pytest.raises(ValueError, match="1 to 127 bits"):
            dcf.evaluate(0, root, key, points, bits, 2)
        with pytest.raises(ValueError, match="1 to 127 bits"):
            dcf.generate(*deal.roots, thresholds, deal.payload, bits)
    for bad_key in (key[:-16], key + bytes(16), key[:-1], b""):
        with pytest.raises(ValueError, match="bytes, not"):
            dcf.evaluate(0, root, bad_key, points, 5, 2)
    with pytest.raises(ValueError, match="bytes, not"):
        dcf.evaluate(0, root, key, points, 5, 1)
    with pytest.raises(ValueError, match="party"):
        dcf.evaluate(2, root, key, points, 5, 2)
    with pytest.raises(ValueError, match="payload"):
        dcf.evaluate(0, root, key, points, 5, 0)
    with pytest.raises(ValueError, match="points must be uint64"):
        dcf.evaluate(0, root, key, points[:1], 5, 2)
    for shape in ((2, 1, 3), (1, 2, 2), (2, 1, 1, 2), (2,)):
        with pytest.raises(ValueError, match="points must be uint64"):
            dcf.evaluate(0, root, key, np.zeros(shape, dtype=np.uint64), 5, 2)
    with pytest.raises(ValueError, match="points must be uint64"):
        dcf.evaluate(0, root, key, points.astype(np.int64), 5, 2)
    with pytest.raises(ValueError, match="roots1 must be uint64"):
        dcf.generate(root, root[:1], thresholds, deal.payload, 5)
    with pytest.raises(ValueError, match="threshold must be uint64"):
        dcf.generate(root, root, thresholds[:1], deal.payload, 5)
    with pytest.raises(ValueError, match="shape"):
        dcf.generate(root, root, thresholds, deal.payload[0], 5)
    with pytest.raises(ValueError, match="below p"):
        dcf.generate(root, root, thresholds, deal.payload | np.uint64((1 << 64) - 1), 5)


def test_arguments_are_left_as_they_were() -> None:
    deal = Deal([9, 20], 5, 1)
    arrays = [*deal.roots, words([9, 20]).copy(), deal.payload, words([3, 4]).copy()]
    before = [array.copy() for array in arrays]
    dcf.generate(arrays[0], arrays[1], arrays[2], arrays[3], 5)
    dcf.evaluate(1, arrays[1], bytearray(deal.key), arrays[4], 5, 1)
    assert all(np.array_equal(a, b) for a, b in zip(arrays, before, strict=True))


def test_a_key_at_an_odd_address_and_read_only_roots_are_accepted() -> None:
    deal = Deal([9, 20], 5, 1)
    for roots in deal.roots:
        roots.flags.writeable = False
    shifted = memoryview(b"\0" + deal.key)[1:]
    total = [dcf.evaluate(i, deal.roots[i], shifted, words([8, 20]), 5, 1) for i in (0, 1)]
    assert field.to_ints(field.add(*total)).tolist() == deal.expected_at([8, 20])
