"""Comparisons as shared bits, and cuts of vectors, in any program."""

import numpy as np
import pytest

from spdz import (
    columns,
    decided,
    dot,
    mask,
    measure,
    multiply,
    nonnegative,
    parallel,
    run_clear,
    run_local,
    truncate,
)
from spdz.arithmetic.fixed_point import norm_bound

SECURITIES = ["malicious", "semi-honest"]


async def count(engine, x, y):
    """How many coordinates of x are at least as large as those of y."""
    (bits,) = await decided(await nonnegative(x - y))
    return bits.sum()


async def both(engine, x, y):
    """Comparisons of two shapes in one round, and a product of what they give."""
    larger, near = await decided(await nonnegative(x - y), await nonnegative(dot(x, y) - 0.25))
    larger, near = await mask(larger, near)
    return multiply(larger.sum(), near) + near


async def weighed(engine, x, y):
    (bits,) = await decided(await nonnegative(x - y))
    return await nonnegative((bits * np.array([4, 2, 1])).sum() - 5)


for program in (count, both, weighed):
    program.max_norm = 1.0

INPUTS = [
    ([0.5, 0.25, -0.5], [0.5, 0.25, -0.5]),
    ([0.5, 0.0, -0.5], [0.5, 2.0**-16, -0.5 - 2.0**-16]),
    ([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]),
]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("program", [count, both, weighed])
@pytest.mark.parametrize("x, y", INPUTS, ids=str)
def test_what_a_program_makes_of_decided_comparisons_is_the_clear_result(program, x, y, security):
    right = run_clear(program, np.array(x), np.array(y)).value
    for _ in range(3):
        assert run_local(program, np.array(x), np.array(y), security).value == right


@pytest.mark.parametrize("security", SECURITIES)
def test_many_comparisons_at_and_beside_zero(security):
    rng = np.random.default_rng(3)
    x = rng.integers(-3, 4, 600) / 65536
    y = rng.integers(-3, 4, 600) / 65536

    async def which(engine, a, b):
        (bits,) = await decided(await nonnegative(a - b))
        return bits * 3 - 1

    which.max_norm = 1.0
    assert np.array_equal(run_local(which, x, y, security).value, 3 * (x >= y) - 1)


def test_it_takes_a_round_a_check_and_an_element_more_than_a_sign():
    async def one(engine, x, y):
        (z,) = await mask(dot(x, y))
        (bit,) = await decided(await nonnegative(z))
        return bit

    async def signed(engine, x, y):
        (z,) = await mask(dot(x, y))
        return await nonnegative(z)

    async def used(engine, x, y):
        (z,) = await mask(dot(x, y))
        return (await nonnegative(z)) * 1

    for program in (one, signed, used):
        program.max_norm = 1.0
    decides, opens, keyed = (measure(program, ((3,), (3,)), "malicious") for program in (one, signed, used))
    assert decides.correction_bytes[0] - opens.correction_bytes[0] == 16
    assert decides.rounds - opens.rounds == decides.rounds - keyed.rounds == 2
    assert decides.correction_bytes[0] < keyed.correction_bytes[0] / 2


def test_what_is_decided_already_is_returned_as_it_is():
    async def twice(engine, x, y):
        (bits,) = await decided(await nonnegative(x - y))
        again, more = await decided(bits, await nonnegative(y - x))
        assert again is bits
        keyed = (await nonnegative(x))[:1]  # an index decides it
        (same,) = await decided(keyed)
        assert same is keyed
        return again.sum() + more.sum() + keyed.sum()

    twice.max_norm = 1.0
    x, y = (np.array(one) for one in INPUTS[1])
    for security in SECURITIES:
        assert run_local(twice, x, y, security).value == 3 + 2 == run_clear(twice, x, y).value + 0


def test_lanes_decide_in_the_same_rounds():
    async def lane(x, y):
        (bits,) = await decided(await nonnegative(multiply(x, y)))
        return bits

    async def lanes(engine, x, y):
        first, second = await parallel(lane(x, y), lane(y, x))
        return (first + second).sum()

    async def alone(engine, x, y):
        return (await lane(x, y)).sum() * 2

    for program in (lanes, alone):
        program.max_norm = 1.0
    shapes = ((3,), (3,))
    assert measure(lanes, shapes, "malicious").rounds == measure(alone, shapes, "malicious").rounds
    x, y = (np.array(one) for one in INPUTS[2])
    assert run_local(lanes, x, y).value == run_local(alone, x, y).value == 4


def test_only_comparisons_are_decided():
    async def wrong(engine, x, y):
        await decided(x - y)

    async def public(engine, x, y):
        await decided(np.array([True]))

    for program in (wrong, public):
        with pytest.raises(TypeError):
            run_clear(program, np.ones(3), np.ones(3))


# -- cuts ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("security", SECURITIES)
def test_products_of_cuts_are_those_of_the_parts(security):
    async def parts(engine, x, y):
        return dot(columns(x, 1, 4), columns(y, 0, 3)) + dot(columns(x, 0, 1), columns(y, 5, 6))

    x, y = np.arange(6) / 8, np.arange(6)[::-1] / 16
    assert run_local(parts, x, y, security).value == x[1:4] @ y[:3] + x[0] * y[5]


@pytest.mark.parametrize("security", SECURITIES)
def test_computed_values_and_truncated_ones_are_cut_as_well(security):
    async def parts(engine, x, y):
        (z,) = await truncate(multiply(x, y), frac=20)
        return columns(z, 2, 5) + columns(multiply(x, y), 0, 3)

    x, y = np.arange(6) / 8, np.arange(6)[::-1] / 16
    found = run_local(parts, x, y, security).value
    assert np.abs(found - (x * y)[2:5] - (x * y)[:3]).max() <= 2.0**-20


def test_a_bound_that_is_known_makes_keys_shorter():
    def comparing(norm):
        async def program(engine, x, y):
            z = dot(columns(x, 0, 2, max_norm=norm), columns(y, 0, 2, max_norm=norm))
            assert z.bound.entry <= norm_bound(norm, 2) ** 2
            return await nonnegative(z)

        program.max_norm = 1024.0
        return measure(program, ((8,), (8,)), "malicious").correction_bytes[0]

    assert comparing(1024.0) - comparing(1.0) == 16 * 20
    assert comparing(4096.0) == comparing(2048.0)  # the whole's is smaller


@pytest.mark.parametrize("ends", [(0, 0), (2, 1), (-1, 2), (0, 4)])
def test_columns_that_are_not_there_are_refused(ends):
    async def program(engine, x, y):
        return dot(columns(x, *ends), y)

    with pytest.raises(ValueError, match="no coordinates"):
        run_clear(program, np.ones(3), np.ones(3))
