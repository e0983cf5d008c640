"""Products of short vectors against Python integers."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field, short
from spdz.arithmetic.field import P
from spdz.arithmetic.short import MOST_BITS, outer, split, widths

BITS = [(17, 44), (44, 17), (44, 44), (58, 58), (1, 58), (26, 26), (50, 50), (1, 1)]


def integers(shape: tuple[int, int], bits: int, seed: int) -> np.ndarray:
    """Random integers, half of them at an edge of the range or of a limb."""
    rng = random.Random(seed)
    top = 2**bits - 1
    edges = [top, -top, 0, -1, *(sign * 2**k for k in range(bits) for sign in (1, -1))]
    size = shape[0] * shape[1]
    values = [rng.choice(edges) if rng.random() < 0.5 else rng.randint(-top, top) for _ in range(size)]
    return np.array(values, dtype=np.int64).reshape(shape)


def exact(x: np.ndarray, y: np.ndarray) -> list[int]:
    rows, columns = (a.astype(object) for a in (x, y))
    return [int((row * column).sum()) % P for row in rows for column in columns]


def check(result: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    assert result.dtype == np.uint64 and result.shape == (len(x), len(y), 2)
    assert field.is_canonical(result)
    assert field.to_list(result) == exact(x, y)


def largest_limbs(bits: int, width: int) -> int:
    """The number below 2^bits whose lower limbs are all -2^(width - 1), the largest in size."""
    count = -(-(bits + 1) // width)
    lower = -sum(1 << (width - 1 + width * i) for i in range(count - 1))
    return lower + ((2**bits - 1 - lower) >> width * (count - 1) << width * (count - 1))


@pytest.mark.parametrize("bits", BITS)
@pytest.mark.parametrize("n", [1, 7, 300])
def test_products_are_exact(bits, n):
    x, y = integers((3, n), bits[0], 1), integers((4, n), bits[1], 2)
    check(outer(x, y, *bits), x, y)


@pytest.mark.parametrize("bits", BITS)
def test_extremes_do_not_round(bits):
    """Sums of the largest numbers and largest limbs, made odd by a last 1, over whole chunks or not."""
    x_width, y_width = widths(*bits)
    xs, ys = (
        [2**b - 1, 1 - 2**b, largest_limbs(b, w), -largest_limbs(b, w)]
        for b, w in zip(bits, (x_width, y_width), strict=True)
    )
    chunk = short._chunk(x_width, y_width)
    borders = {k * chunk + more for k in (1, 2, short._CHUNKS) for more in (-1, 0, 1)}
    for n in {1536, 8192, 100_000} | {n for n in borders if n < 100_000}:
        x, y = (np.repeat(np.array(values)[:, None], n, axis=1) for values in (xs, ys))
        x[:, -1] = y[:, -1] = 1
        assert field.to_list(outer(x, y, *bits)) == [((n - 1) * a * b + 1) % P for a in xs for b in ys]


@pytest.mark.parametrize("bits", BITS)
def test_an_exact_sum_is_as_long_as_float64_allows(bits):
    """No product of two limbs is larger than 2^53 a chunk, and twice the chunk would not be exact."""
    x_width, y_width = widths(*bits)
    largest = (1 << x_width >> 1) * (1 << y_width >> 1)
    assert short._chunk(x_width, y_width) * largest == 2**53


@pytest.mark.parametrize("bits, width", [(44, 23), (44, 22), (58, 15), (58, 30), (17, 18), (17, 53), (1, 1)])
def test_limbs_are_balanced(bits, width):
    top, edge = 2**bits - 1, largest_limbs(bits, width)
    x = np.concatenate([integers((1, 500), bits, 4), [[top, -top, edge, -edge, 0]]], axis=1)
    limbs = split(x, bits, width)
    assert np.abs(limbs.values).max() <= 2 ** (width - 1)
    digits = [limb.astype(np.int64).astype(object) for limb in limbs.values]
    assert (sum(digit << width * i for i, digit in enumerate(digits)) == x).all()
    assert len(digits) == 1 or np.abs(limbs.values[0]).max() == 2 ** (width - 1)


def test_the_usual_operands_take_few_limbs():
    counts = {
        bits: [
            len(split(np.zeros((1, 1), dtype=np.int64), *pair).values)
            for pair in zip(bits, widths(*bits), strict=True)
        ]
        for bits in BITS
    }
    assert counts[17, 44] == [1, 2] and counts[44, 44] == [2, 2] and sorted(counts[58, 58]) == [2, 4]


@pytest.mark.parametrize("r, c", [(0, 3), (3, 0), (0, 0), (1, 1), (1, 9), (9, 1), (9, 10)])
@pytest.mark.parametrize("n", [0, 1, 20])
def test_any_number_of_rows_and_columns(r, c, n, monkeypatch):
    monkeypatch.setattr(short, "_ROWS", 4)
    monkeypatch.setattr(short, "_COLUMNS", 3)
    monkeypatch.setattr(short, "_SPLIT", 40)
    x, y = integers((r, n), 44, 5), integers((c, n), 44, 6)
    check(outer(x, y, 44, 44), x, y)


@pytest.mark.parametrize("chunks", [1, 2, 3])
@pytest.mark.parametrize("bits", [(44, 44), (58, 58)])
def test_parts_add_up(chunks, bits, monkeypatch):
    monkeypatch.setattr(short, "_EXACT", 46 if bits == (44, 44) else 45)
    monkeypatch.setattr(short, "_CHUNKS", chunks)
    for n in (3, 4, 5, 8, 11):
        x, y = integers((2, n), bits[0], 7), integers((3, n), bits[1], 8)
        check(outer(x, y, *bits), x, y)


def test_tiles_of_the_true_size():
    x, y = integers((300, 5), 44, 9), integers((290, 5), 17, 10)
    check(outer(x, y, 44, 17), x, y)


@pytest.mark.parametrize("bits", BITS)
def test_split_operands_give_the_same(bits):
    x, y = integers((3, 600), bits[0], 11), integers((4, 600), bits[1], 12)
    left, right = (split(a, b, w) for a, b, w in zip((x, y), bits, widths(*bits), strict=True))
    for a in (x, left):
        for b in (y, right):
            check(outer(a, b, *bits), x, y)


def test_one_split_serves_several_products():
    y = integers((4, 600), 44, 13)
    words = split(y, 44, widths(44, 44)[1])
    for bits in (17, 44, 58):
        x = integers((3, 600), bits, 14)
        check(outer(x, words, bits, 44), x, y)
        check(outer(words, x, 44, bits), y, x)
    check(outer(words, words, 44, 44), y, y)


def test_narrow_limbs_of_long_numbers():
    """Here the joined sum, at most 2^126, is shorter than an exact sum of limb products."""
    x, y = integers((2, 3000), 58, 18), integers((3, 3000), 58, 19)
    x[0], y[0] = 2**58 - 1, 2**58 - 1
    x[1], y[1] = 1 - 2**58, 1 - 2**58
    check(outer(split(x, 58, 15), split(y, 58, 15), 58, 58), x, y)


def test_many_short_chunks():
    """Limbs so wide that one product is an exact sum: 2,000 of 2^53 do not fit an integer of 64 bits."""
    x, y = (np.full((1, 2000), largest_limbs(50, width)) for width in (27, 28))
    check(outer(split(x, 50, 27), split(y, 50, 28), 50, 50), x, y)


def test_powers_of_two():
    """The words of these sums are 0, so that 1 is borrowed from the upper one below 0."""
    powers = np.array([[sign << k] for k in range(MOST_BITS) for sign in (1, -1)])
    check(outer(powers, powers, MOST_BITS, MOST_BITS), powers, powers)


def test_views_are_multiplied_like_copies():
    x, y = integers((40, 6), 44, 15), integers((9, 80), 44, 16)
    check(outer(x.T, y[::2, ::-2], 44, 44), x.T, y[::2, ::-2])


@settings(max_examples=60, deadline=None)
@given(st.data(), st.integers(1, MOST_BITS), st.integers(1, MOST_BITS), st.integers(1, 12))
def test_every_pair_of_lengths(data, x_bits, y_bits, n):
    def draw(bits):
        numbers = st.integers(1 - 2**bits, 2**bits - 1)
        return np.array([data.draw(st.lists(numbers, min_size=n, max_size=n)) for _ in range(2)])

    x, y = draw(x_bits), draw(y_bits)
    check(outer(x, y, x_bits, y_bits), x, y)


def test_the_operands_are_left_alone():
    x = integers((2, 50), 44, 17)
    before, words = x.copy(), split(x, 44, 23)
    values = words.values.copy()
    outer(x, words, 44, 44)
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(words.values, values)


@pytest.mark.parametrize("bits", [0, MOST_BITS + 1])
def test_bits_out_of_range_are_refused(bits):
    x = np.zeros((1, 3), dtype=np.int64)
    for pair in ((bits, 5), (5, bits)):
        with pytest.raises(ValueError, match="bits"):
            outer(x, x, *pair)
    with pytest.raises(ValueError, match="bits"):
        split(x, bits, 20)


@pytest.mark.parametrize("width", [0, 5, 54, -3])
def test_widths_out_of_range_are_refused(width):
    with pytest.raises(ValueError, match="cannot split 20"):
        split(np.zeros((1, 3), dtype=np.int64), 20, width)


def test_limbs_that_do_not_fit_are_refused():
    x = np.zeros((1, 3), dtype=np.int64)
    with pytest.raises(ValueError, match="too wide"):
        outer(split(x, 44, 45), split(x, 44, 23), 44, 44)
    with pytest.raises(ValueError, match="limbs have others"):
        outer(split(x, 44, 23), x, 43, 44)
    with pytest.raises(ValueError, match="length"):
        outer(x, x[:, :2], 44, 44)


def test_repr_shows_no_number():
    assert "values" not in repr(split(np.full((1, 3), 77, dtype=np.int64), 44, 23))
