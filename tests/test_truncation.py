"""Truncation: floor or one more and right in the mean; exact rounding: to the nearest, in every run."""

import secrets
from fractions import Fraction
from functools import partial
from math import floor

import numpy as np
import pytest
from gate_helpers import SECURITIES, WIDEST, edges, exactly, integers, run_gate
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import dot, mask, multiply, nonnegative, round_exactly, run_local, sign, truncate

FARTHEST = 85
"""The most bits that can go from a fresh mask."""


async def cut(z, frac=0):
    return (await truncate(z, frac=frac))[0]


async def rounded(z, frac=0):
    return (await round_exactly(z, frac=frac))[0]


def nearest(z, drop):
    return (z + (1 << drop >> 1)) >> drop


def assert_floor_or_one_more(value, z, drop):
    above = np.asarray(value) - (z >> drop)
    exact = z == z >> drop << drop
    assert ((above == 0) | ((above == 1) & ~exact)).all()


@pytest.mark.parametrize("security", SECURITIES)
def test_every_number_of_bits_goes_from_the_longest_values(security):
    for drop in range(1, FARTHEST + 1):
        z = edges(WIDEST, unit=1 << drop)
        value = run_gate(cut, z, bound=WIDEST, frac=drop, security=security, shared=drop % 2).value
        assert_floor_or_one_more(value, z, drop)


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=40, deadline=None)
@given(data=st.data(), bits=st.integers(1, 85), drop=st.integers(1, FARTHEST), shared=st.booleans())
def test_a_truncated_value_is_the_floor_or_one_more(security, data, bits, drop, shared):
    bound = (1 << bits) - 1
    numbers = st.one_of(
        st.integers(-bound, bound),
        st.sampled_from(list(edges(bound))),
        st.integers(-(bound >> drop), bound >> drop).map(lambda k: k << drop),
    )
    z = integers(*data.draw(st.lists(numbers, min_size=1, max_size=6)))
    value = run_gate(cut, z, bound=bound, frac=drop, security=security, shared=shared).value
    assert_floor_or_one_more(value, z, drop)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3), (2, 1, 3), (3, 2, 1)], ids=str)
def test_shapes_are_kept(shape, security):
    z = integers(*(secrets.randbelow(2**60) - 2**59 for _ in range(int(np.prod(shape))))).reshape(shape)
    for gate in (cut, rounded):
        value = np.asarray(run_gate(gate, z, bound=2**59, frac=21, security=security).value)
        assert value.shape == shape
        assert_floor_or_one_more(value, z, 21)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("drop", [3, 20, 64, 84])
@pytest.mark.parametrize("part", [Fraction(1, 8), Fraction(1, 2), Fraction(7, 8)], ids=str)
def test_the_mean_over_many_runs_is_right(part, drop, security):
    size, whole = 8192, secrets.randbelow(2) - 1
    z = (whole << drop) + int(part * (1 << drop))
    value = run_gate(cut, integers(*[z] * size), bound=WIDEST, frac=drop, security=security).value
    up = sum(value - whole)
    assert abs(up - size * part) < 7 * (size * part * (1 - part)) ** 0.5  # by chance once in 10^11


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=25, deadline=None)
@given(z=st.integers(-WIDEST, WIDEST), first=st.integers(1, 60), second=st.integers(1, 25))
def test_truncating_twice_is_truncating_once(security, z, first, second):
    async def twice(value):
        (value,) = await truncate(value, frac=second)
        (value,) = await truncate(value, frac=0)
        return value

    drop = first + second
    value = run_gate(twice, integers(z), bound=WIDEST, frac=drop, security=security).value
    assert_floor_or_one_more(value, integers(z), drop)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_truncated_value_can_be_multiplied_at_once(security):
    async def product(a, b):
        a, b = await truncate(a, b, frac=0)
        return multiply(a, b) * 4 + a * 2 + b

    a, b = 77 << 40, (-5 << 40) + 1
    value = run_gate(product, a, b, bound=2**50, frac=40, security=security).value
    assert value in {4 * 77 * c + 2 * 77 + c for c in (-5, -4)}


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("drop", [1, 30, 69])
def test_a_truncated_value_is_compared_as_it_was_opened(drop, security):
    """The bit belongs to the number that this run's dither made."""

    async def with_bit(z):
        (z,) = await truncate(z, frac=0)
        bit = await nonnegative(z)
        return z * 2 + bit

    z = edges(WIDEST, unit=1 << drop)
    value = run_gate(with_bit, z, bound=WIDEST, frac=drop, security=security).value
    assert_floor_or_one_more(value // 2, z, drop)
    assert (value % 2 == (value // 2 >= 0)).all()
    assert {0, 1} == set(value % 2)


@pytest.mark.parametrize("security", SECURITIES)
def test_differences_of_truncated_values_are_compared_exactly(security):
    async def with_sign(a, b):
        a, b = await truncate(a, b, frac=0)
        difference = a - b
        assert difference.masked
        return difference * 4 + await sign(difference)

    drop = 33
    b = integers(*(secrets.randbelow(2**80) - 2**79 for _ in range(90)))
    a = b + integers(*(secrets.randbelow(5 << drop) - (5 << drop >> 1) for _ in range(90)))
    value = run_gate(with_sign, a, b, bound=2**81, frac=drop, security=security).value
    difference = (value + 1) // 4
    assert (abs((a - b) * Fraction(1, 1 << drop) - difference) < 2).all()
    assert (value - 4 * difference == np.sign(difference)).all()
    assert {-1, 0, 1} == set(np.sign(difference))


@pytest.mark.parametrize("security", SECURITIES)
def test_sums_of_truncated_values_are_compared_exactly(security):
    async def with_bit(a):
        (a,) = await truncate(a, frac=0)
        total = a.sum() - 3 * a[..., 0]
        return total * 2 + await nonnegative(total)

    a = integers(*(secrets.randbelow(2**60) - 2**59 for _ in range(40))).reshape(8, 5)
    value = run_gate(with_bit, a, bound=2**59, frac=50, security=security).value
    assert (value % 2 == (value // 2 >= 0)).all()


@pytest.mark.parametrize("security", SECURITIES)
def test_every_number_of_bits_is_rounded_exactly(security):
    for drop in (1, 2, 3, 7, 8, 15, 16, 31, 32, 33, 48, 63, 64, 65, 77, 84):
        bound = WIDEST - (1 << drop)
        z = edges(bound, unit=1 << (drop - 1))
        value = run_gate(rounded, z, bound=bound, frac=drop, security=security, shared=drop % 2).value
        assert (value == nearest(z, drop)).all()


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=30, deadline=None)
@given(data=st.data(), bits=st.integers(1, 84), drop=st.integers(1, 84), shared=st.booleans())
def test_exact_rounding_is_to_the_nearest_with_ties_up(security, data, bits, drop, shared):
    bound = (1 << bits) - 1
    halves = st.integers(-(bound >> drop), bound >> drop).map(lambda k: (k << drop) - (1 << drop >> 1))
    numbers = st.one_of(st.integers(-bound, bound), halves.filter(lambda z: abs(z) <= bound))
    z = integers(*data.draw(st.lists(numbers, min_size=1, max_size=6)))
    value = run_gate(rounded, z, bound=bound, frac=drop, security=security, shared=shared).value
    assert (value == nearest(z, drop)).all()
    assert (value == [floor(Fraction(int(one), 1 << drop) + Fraction(1, 2)) for one in z]).all()


def test_exact_rounding_is_the_same_in_every_run_and_truncation_is_not():
    z = integers(*(secrets.randbelow(2**60) for _ in range(64)))
    runs = {gate: set() for gate in (cut, rounded)}
    for gate, seen in runs.items():
        for _ in range(4):
            seen.add(tuple(run_gate(gate, z, bound=2**60, frac=30, security="malicious").value))
    assert (len(runs[rounded]), len(runs[cut])) == (1, 4)


@settings(max_examples=50, deadline=None)
@given(z=st.integers(-WIDEST, WIDEST), drop=st.integers(1, FARTHEST))
def test_both_mean_rounding_to_the_nearest_in_the_clear(z, drop):
    for gate in (cut, rounded):
        assert run_gate(gate, integers(z), bound=WIDEST, frac=drop).value == nearest(z, drop)


@pytest.mark.parametrize("gate", [cut, rounded])
def test_the_public_bound_holds_what_comes_out(gate):
    """Both ends, and both ways to round."""
    for bound in (1, 2**20 - 1, 2**20, 2**60 + 1):
        for drop in (1, 4, 20, 61):
            seen = []

            async def bounded(z, drop=drop, seen=seen):
                z = await gate(z)
                seen.append(z.bound)
                return z

            z = integers(bound, -bound, bound, -bound, 0)
            value = run_gate(bounded, z, bound=bound, frac=drop, security="semi-honest").value
            assert abs(value).max() <= seen[0].entry
            assert (value**2).sum() <= seen[0].norm ** 2


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("gate", [truncate, round_exactly])
def test_rounds(gate, security):
    """None for masked values, one for any number of computed ones, none where no bit goes."""

    def rounds(function):
        async def program(engine, x, y):
            return await function(x, y)

        return run_local(program, [1.0, 2.0], [3.0, -4.0], security).stats[0].rounds

    async def inputs(x, y):
        a, b = await gate(x, y, frac=3)
        return a + b

    async def computed(x, y):
        a, b = await gate(dot(x, y), dot(x, x), frac=16)
        return a + b

    async def both(x, y):
        a, b = await gate(x, dot(x, x), frac=16)
        return a + b

    check = security == "malicious"
    assert rounds(inputs) == 2 + check
    assert rounds(computed) == rounds(both) == 3 + 2 * check


def test_fractional_bits_cannot_be_made():
    for gate in (truncate, round_exactly):

        async def more(z, gate=gate):
            return (await gate(z, frac=17))[0]

        with pytest.raises(ValueError, match="16 fractional bits cannot be cut to 17"):
            run_gate(more, 1, bound=1, frac=16, security="malicious")


def test_a_value_with_no_bit_to_cut_is_returned():
    for gate in (cut, rounded):
        for security in (*SECURITIES, None):
            assert run_gate(gate, 5, bound=9, frac=0, security=security).value == 5


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("gate", [cut, rounded])
def test_where_masks_cancel_a_truncation_is_refused_or_masked_anew(gate, security):
    """The integers behind such a mask may wrap, whatever its length."""

    async def first_subtracted(x):
        return x - x[..., :1]

    async def cut_subtracted(x):
        return x - await cut(x, 8)

    for function, expected in ((first_subtracted, [0, -3, Fraction(5, 2)]), (cut_subtracted, [0, 0, 0])):

        async def program(engine, x, y, fresh=False, function=function):
            z = await function(x)
            if fresh:
                (z,) = await mask(z, fresh=True)
            return await gate(z, 8)

        data = [1.0, -2.0, 3.5], [0.0]
        with pytest.raises(ValueError, match="masks cancel"):
            exactly(program, *data, security)
        assert np.array_equal(exactly(partial(program, fresh=True), *data, security).value, expected)
