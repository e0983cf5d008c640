"""BLAS dot products against Python integers."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field, inner_product
from spdz.arithmetic.field import P
from spdz.arithmetic.inner_product import dot, limbs, small_dot

SMALL = 2**40 - 1
LENGTHS = (1, 7, 1999, 2000, 2001, 8192)


def elements(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """An object array of random elements, a quarter of them p - 1 and a quarter limb boundaries."""
    rng = random.Random(seed)
    edges = [P - 1] * 4 + [0, 1, 2**16 - 1, 2**64 - 1, 2**112]
    size = int(np.prod(shape))
    values = [rng.choice(edges) if rng.random() < 0.5 else rng.randrange(P) for _ in range(size)]
    return np.array(values, dtype=object).reshape(shape)


def short_integers(shape: tuple[int, ...], seed: int) -> np.ndarray:
    rng = random.Random(seed)
    edges = [SMALL, -SMALL, 0, -1, 2**20, -(2**20), 2**20 - 1]
    size = int(np.prod(shape))
    values = [rng.choice(edges) if rng.random() < 0.5 else rng.randint(-SMALL, SMALL) for _ in range(size)]
    return np.array(values, dtype=np.int64).reshape(shape)


def exact(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The dot products mod p, by Python integers."""
    return np.asarray((a.astype(object) * b.astype(object)).sum(axis=-1) % P, dtype=object)


def check(result: np.ndarray, expected: np.ndarray) -> None:
    assert result.dtype == np.uint64 and result.shape == (*expected.shape, 2)
    assert field.is_canonical(result)
    assert field.to_ints(result).ravel().tolist() == expected.ravel().tolist()


@pytest.mark.parametrize("n", LENGTHS)
def test_one_dot_product(n):
    a, b, x = elements((n,), 1), elements((n,), 2), short_integers((n,), 3)
    fa, fb = field.from_ints(a), field.from_ints(b)
    for left in (fa, limbs(fa)):
        for right in (fb, limbs(fb)):
            check(dot(left, right), exact(a, b))
    check(small_dot(x, fb), exact(x, b))
    check(small_dot(x, limbs(fb)), exact(x, b))
    check(dot(fa, fa), exact(a, a))


@pytest.mark.parametrize("n", [1, 8192, inner_product._CHUNK, inner_product._CHUNK + 1])
def test_largest_values_do_not_round(n):
    full = np.broadcast_to(field.from_int(P - 1), (n, 2))
    assert field.to_int(dot(full, full)) == n % P
    for sign in (1, -1):
        x = np.full(n, sign * SMALL, dtype=np.int64)
        assert field.to_int(small_dot(x, full)) == -sign * SMALL * n % P
    # The largest limbs in every place but the top one.
    ones = field.from_int(2**112 - 1)
    full = np.broadcast_to(ones, (1, n, 2))
    assert field.to_int(dot(full, full)) == n * (2**112 - 1) ** 2 % P
    x = np.full((1, n), -SMALL, dtype=np.int64)
    assert field.to_int(small_dot(x, full)) == -n * SMALL * (2**112 - 1) % P


def test_a_long_vector():
    n = 100_000
    rng = np.random.default_rng(4)
    blocks = rng.integers(0, 2**64, size=(2, n, 2), dtype=np.uint64)
    fa, fb = field.from_blocks(blocks[0]), field.from_blocks(blocks[1])
    x = rng.integers(-SMALL, SMALL, size=n, endpoint=True)
    a, b = field.to_ints(fa), field.to_ints(fb)
    check(dot(fa, fb), exact(a, b))
    check(small_dot(x, fb), exact(x, b))


@pytest.mark.parametrize("chunk", [1, 4, 9, 10, 11])
@pytest.mark.parametrize("lead", [(), (3,)])
def test_chunks_add_up(chunk, lead, monkeypatch):
    monkeypatch.setattr(inner_product, "_CHUNK", chunk)
    monkeypatch.setattr(inner_product, "_BLOCK", 3)
    a, b, x = elements((*lead, 10), 5), elements((*lead, 10), 6), short_integers((*lead, 10), 7)
    fa, fb = field.from_ints(a), field.from_ints(b)
    check(dot(fa, fb), exact(a, b))
    check(dot(limbs(fa), fb), exact(a, b))
    check(small_dot(x, fb), exact(x, b))
    check(small_dot(x, limbs(fb)), exact(x, b))


LEADS = [
    ((4, 1), (1, 5)),
    ((1, 4), (5, 1)),
    ((1, 4, 1), (1, 1, 5)),
    ((4, 1), (5,)),
    ((4, 1), ()),
    ((4,), ()),
    ((), (5,)),
    ((1,), (1,)),
    ((4,), (4,)),
    ((2, 4, 1), (2, 1, 5)),
    ((2, 1, 3), (1, 4, 1)),
    ((2, 3, 1, 1), (4, 2)),
    ((0, 1), (1, 5)),
    ((4, 1), (1, 0)),
    ((0,), (0,)),
]


@pytest.mark.parametrize("left, right", LEADS)
def test_leading_axes_broadcast(left, right):
    a, b, x = elements((*left, 9), 8), elements((*right, 9), 9), short_integers((*left, 9), 10)
    fa, fb = field.from_ints(a), field.from_ints(b)
    check(dot(fa, fb), exact(a, b))
    check(dot(limbs(fa), limbs(fb)), exact(a, b))
    check(small_dot(x, fb), exact(x, b))


def test_many_against_many_in_tiles(monkeypatch):
    monkeypatch.setattr(inner_product, "_TILE", 700)
    a, b, x = elements((7, 1, 20), 11), elements((1, 5, 20), 12), short_integers((7, 1, 20), 13)
    check(dot(field.from_ints(a), field.from_ints(b)), exact(a, b))
    check(small_dot(x, field.from_ints(b)), exact(x, b))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, P - 1), st.integers(0, P - 1)), min_size=1, max_size=20))
def test_dot_is_the_sum_of_products(pairs):
    a, b = (field.from_ints(list(column)) for column in zip(*pairs, strict=True))
    np.testing.assert_array_equal(dot(a, b), field.sum(field.mul(a, b), 0))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(-SMALL, SMALL), st.integers(0, P - 1)), min_size=1, max_size=20))
def test_small_dot_agrees_with_dot(pairs):
    column, column_b = zip(*pairs, strict=True)
    x, b = np.array(column, dtype=np.int64), field.from_ints(list(column_b))
    np.testing.assert_array_equal(small_dot(x, b), dot(field.from_int64(x), b))
    np.testing.assert_array_equal(small_dot(x[None], b[None])[0], dot(field.from_int64(x), b))


@pytest.mark.parametrize("left, right", [(0, 0), (3, 4), (1, 3)])
def test_empty_and_unequal_vectors_are_refused(left, right):
    with pytest.raises(ValueError, match="dot product"):
        dot(field.zeros(left), field.zeros(right))
    with pytest.raises(ValueError, match="dot product"):
        small_dot(np.zeros(left, dtype=np.int64), field.zeros(right))


def test_leading_axes_that_do_not_broadcast_are_refused():
    with pytest.raises(ValueError, match="broadcast"):
        dot(field.zeros((3, 2)), field.zeros((4, 2)))


def test_views_are_split_like_copies():
    a, b = elements((12,), 14), elements((12,), 15)
    fa, fb = field.from_ints(a), field.from_ints(b)
    check(dot(fa[::2], fb[::-2]), exact(a[::2], b[::-2]))
    check(small_dot(np.arange(12)[::3], fb[::3]), exact(np.arange(12)[::3], b[::3]))


def test_repr_shows_no_element():
    assert "values" not in repr(limbs(field.zeros(3)))
