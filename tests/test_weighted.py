"""Weighted sums of rows against Python integers."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field, weighted
from spdz.arithmetic.field import P
from spdz.arithmetic.weighted import bilinear, weigh_elements, weigh_words

LARGEST_WEIGHT = (1 << 127) - 1 - sum(1 << (15 + 16 * i) for i in range(7))
"""Its balanced limbs are -2^15, and 2^15 - 1 at the top."""

SHAPES = [
    (1, 1),
    (1, 9),
    (2, 1),
    (9, 4),
    (127, 3),
    (128, 3),
    (129, 3),
    (5, 300),
    (0, 4),
    (4, 0),
    (1, 0),
    (0, 0),
]


def elements(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Python integers below p, half of them at edges of limbs."""
    rng = random.Random(seed)
    edges = [P - 1, 0, 1, LARGEST_WEIGHT, sum(1 << (15 + 16 * i) for i in range(7)), 2**64 - 1, 2**126]
    values = [
        rng.choice(edges) if rng.random() < 0.5 else rng.randrange(P) for _ in range(int(np.prod(shape)))
    ]
    return np.array(values, dtype=object).reshape(shape)


def words(shape: tuple[int, int], bits: int, seed: int) -> np.ndarray:
    rng = random.Random(seed)
    top = 2**bits - 1
    edges = [top, -top, 0, -1, 1] + [sign * 2**31 for sign in (1, -1) if bits > 31]
    values = [
        rng.choice(edges) if rng.random() < 0.5 else rng.randint(-top, top)
        for _ in range(int(np.prod(shape)))
    ]
    return np.array(values, dtype=np.int64).reshape(shape)


def check(result: np.ndarray, u: np.ndarray, rows: np.ndarray) -> None:
    expected = [sum(int(w) * int(e) for w, e in zip(u, column, strict=True)) % P for column in rows.T]
    assert result.dtype == np.uint64 and result.shape == (rows.shape[1], 2)
    assert field.is_canonical(result)
    assert field.to_list(result) == expected


@pytest.mark.parametrize("shape", SHAPES)
def test_weighted_sums(shape):
    u = elements(shape[:1], 1)
    weights = field.from_ints(u)
    m = elements(shape, 2)
    check(weigh_elements(weights, field.from_ints(m)), u, m)
    for bits in (1, 17, 31, 32, 44, 58, 63):
        x = words(shape, bits, bits)
        check(weigh_words(weights, x, bits), u, x)


@pytest.mark.parametrize("rows", [128, 5000, weighted._MOST_ROWS, weighted._MOST_ROWS + 1, 100_000])
@pytest.mark.parametrize("weight", [LARGEST_WEIGHT, P - 1, 2**127 - 2**112])
def test_extremes_do_not_round(rows, weight):
    """Limbs of the largest size in all places and rows, and with one weight that makes every sum odd."""
    u = field.from_ints([weight] * (rows - 1) + [1])
    numbers = [P - 1, 0, sum(1 << (31 + 32 * i) for i in range(3)), 2**96 - 1, 2**127 - 2**96]
    m = np.broadcast_to(field.from_ints(numbers), (rows, len(numbers), 2))
    total = (rows - 1) * weight + 1
    assert field.to_list(weigh_elements(u, m)) == [total * number % P for number in numbers]
    for bits in (31, 63):
        short = [2**bits - 1, 1 - 2**bits, -(2**31 - 1), 1]
        x = np.broadcast_to(np.array(short), (rows, len(short)))
        assert field.to_list(weigh_words(u, x, bits)) == [total * number % P for number in short]


def test_a_product_is_as_long_as_float64_allows():
    assert weighted._ROWS * 2**15 * 2**31 == 2**53
    # At most 4 sums of one weight, which count twice.
    assert weighted._MOST_ROWS * 2**15 * 2**31 * 8 == 2**62


def test_weights_are_balanced():
    u = elements((400,), 3)
    limbs = weighted._balanced(field.from_ints(u))
    assert np.abs(limbs).max() <= 2**15
    assert [sum(int(limb) << 16 * i for i, limb in enumerate(row)) for row in limbs] == u.tolist()


def test_long_rows():
    u, m, x = elements((3,), 4), elements((3, 5000), 5), words((3, 5000), 44, 6)
    check(weigh_elements(field.from_ints(u), field.from_ints(m)), u, m)
    check(weigh_words(field.from_ints(u), x, 44), u, x)
    check(weigh_words(field.from_ints(u), x >> 20, 31), u, x >> 20)


@pytest.mark.parametrize("rows", [1, 2, 6, 7, 8, 20])
def test_parts_add_up(rows, monkeypatch):
    monkeypatch.setattr(weighted, "_ROWS", 3)
    monkeypatch.setattr(weighted, "_COLUMNS", 8)
    monkeypatch.setattr(weighted, "_TILE", 5)
    monkeypatch.setattr(weighted, "_MOST_ROWS", 7)
    u, m, x = elements((rows,), 7), elements((rows, 13), 8), words((rows, 13), 44, 9)
    check(weigh_elements(field.from_ints(u), field.from_ints(m)), u, m)
    check(weigh_words(field.from_ints(u), x, 44), u, x)
    check(weigh_words(field.from_ints(u), x >> 20, 31), u, x >> 20)


def test_views_are_weighed_like_copies():
    u, m, x = elements((12,), 10), elements((9, 12), 11), words((9, 12), 44, 12)
    weights, numbers = field.from_ints(u), field.from_ints(m)
    check(weigh_elements(weights[::-2], numbers[:6, ::2]), u[::-2], m[:6, ::2])
    check(weigh_elements(weights, numbers.transpose(1, 0, 2)), u, m.T)
    check(weigh_words(weights, x.T, 44), u, x.T)
    check(weigh_words(weights[:9], x[:, ::-3], 44), u[:9], x[:, ::-3])


def test_the_operands_are_left_alone():
    u, m, x = (
        field.from_ints(elements((5,), 13)),
        field.from_ints(elements((5, 6), 14)),
        words((5, 6), 44, 15),
    )
    before = [a.copy() for a in (u, m, x)]
    weigh_elements(u, m), weigh_words(u, x, 44)
    for now, then in zip((u, m, x), before, strict=True):
        np.testing.assert_array_equal(now, then)


@pytest.mark.parametrize("shape", SHAPES)
def test_bilinear(shape):
    u, m, v = elements(shape[:1], 16), elements(shape, 17), elements(shape[1:], 18)
    expected = sum(int(a) * int(m[j, k]) * int(b) for j, a in enumerate(u) for k, b in enumerate(v)) % P
    result = bilinear(field.from_ints(u), field.from_ints(m).reshape((*shape, 2)), field.from_ints(v))
    assert type(result) is int and result == expected


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, P - 1), st.integers(0, P - 1)), min_size=1, max_size=20))
def test_a_weighted_sum_is_a_sum_of_products(pairs):
    u, m = (field.from_ints(list(column)) for column in zip(*pairs, strict=True))
    np.testing.assert_array_equal(weigh_elements(u, m[:, None])[0], field.sum(field.mul(u, m), 0))


def test_shapes_that_do_not_fit_are_refused():
    u, m = field.zeros(3), field.zeros((4, 5))
    for rows in (3, 5, 1):
        with pytest.raises(ValueError, match="4 rows"):
            weigh_elements(field.zeros(rows), m)
        with pytest.raises(ValueError, match="4 rows"):
            weigh_words(field.zeros(rows), np.zeros((4, 5), dtype=np.int64), 44)
    with pytest.raises(ValueError, match="4 rows"):
        bilinear(u, m, field.zeros(5))
    for columns in (1, 4):
        with pytest.raises(ValueError, match="5 columns"):
            bilinear(field.zeros(4), m, field.zeros(columns))
