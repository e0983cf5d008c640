"""Sums that are reduced last equal those of Python integers, at the edges of what fits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field, unreduced
from spdz.arithmetic.field import P
from spdz.arithmetic.unreduced import MOST_TERMS, Weights, weigh

BITS = 40


def meaning(words):
    return sum(word << 32 * i for i, word in enumerate(words.tolist()))


def expected(rows, signs, numbers, half):
    columns, n = numbers.shape[:2]
    return [
        sum(
            weight * int(signs[x, i]) * (meaning(numbers[c, x, i]) - meaning(half[c, x, 0]))
            for i, weight in enumerate(row)
        )
        % P
        for row in rows
        for c in range(columns)
        for x in range(n)
    ]


def both_forms(words):
    reduced = [number % P for number in unreduced.integers(words)]
    assert field.to_list(unreduced.elements(words)) == reduced
    assert max(map(abs, unreduced.integers(words))) < 1 << unreduced.INTEGER_BITS
    return reduced


@pytest.mark.parametrize("extreme", [-1, 0, 1])
def test_words_at_their_limits_become_elements(extreme):
    words = np.full((3, 4), extreme * ((1 << 60) - 1))
    assert both_forms(words) == [meaning(words[0]) % P] * 3
    assert both_forms(np.repeat(words, 20, axis=0)) == [meaning(words[0]) % P] * 60


def test_words_of_elements_mean_them():
    numbers = [0, 1, P - 1, P >> 1, 1 << 126]
    assert both_forms(unreduced.words(field.from_ints(numbers))) == numbers


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    rows=st.integers(1, 4),
    k=st.sampled_from([1, 2, 7, 130]),
    n=st.integers(1, 3),
    bits=st.sampled_from([1, 19, 20, 21, 42, 64, 126, 140]),
)
def test_weighed_sums_are_exact(seed, rows, k, n, bits):
    rng = np.random.default_rng(seed)
    sizes = [[int.from_bytes(rng.bytes(18), "little") >> 144 - bits for _ in range(k)] for _ in range(rows)]
    weights = [[size * int(rng.choice([-1, 1])) for size in row] for row in sizes]
    limit = (1 << BITS) - (1 << 32)
    numbers = rng.integers(-limit, limit, (2, n, k, 4))
    signs, half = rng.choice([-1, 1], (n, k)), rng.integers(0, 1 << 32, (2, n, 1, 4))
    words = weigh(Weights(weights), signs, numbers, half, BITS)
    assert words.shape == (rows, 2, n, 4)
    assert both_forms(words) == expected(weights, signs, numbers, half)


@pytest.mark.parametrize("bits", [33, BITS])
@pytest.mark.parametrize("k", [1, 2, 255, 256, MOST_TERMS])
def test_the_largest_weights_and_words_fit(k, bits):
    # All terms add up: nothing larger can be asked for.
    for weight in (P >> 1, -(P >> 1), (1 << 20) - 1, 1 << 20, (1 << 64) - 1):
        numbers = np.full((1, 1, k, 4), (1 << bits) - 1)
        for sign, half in ((1, 0), (-1, (1 << 32) - 1)):
            numbers *= sign
            arguments = np.full((1, k), sign), numbers + half, np.full((1, 1, 1, 4), half)
            words = weigh(Weights([[weight] * k, [0] * k]), *arguments, bits)
            assert np.abs(words).max() < 1 << 60
            assert both_forms(words) == expected([[weight] * k, [0] * k], *arguments)
