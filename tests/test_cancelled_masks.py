"""Where masks cancel, a comparison or truncation in place would wrap: refused, or masked anew.

Where masks are small integers nothing wraps, whatever cancels.
"""

import numpy as np
import pytest

from spdz import (
    divide,
    mask,
    nonnegative,
    reciprocal,
    round_exactly,
    run_clear,
    run_local,
    sign,
    sqrt,
    truncate,
)

SECURITIES = ["malicious", "semi-honest"]
X = [3.0, 4.0, -5.0]


def program(function, max_norm=2.0**22):
    async def run(engine, x, y):
        return await function(x, y)

    run.max_norm = max_norm
    return run


async def cut(z, frac):
    (result,) = await truncate(z, frac=frac)
    return result


async def rounded(z, frac):
    (result,) = await round_exactly(z, frac=frac)
    return result


async def fractional_part(x, y):
    return await sign(x - await cut(x, 8))


async def half_the_fractional_part(x, y):
    return await cut((x - await cut(x, 8)) * 0.5, 16)


async def masked_anew(x, y):
    (pairs,) = await mask(x[:, None] - x[None, :], fresh=True)
    return await sign(pairs)


WITH_A_ZERO = {
    "truncation": lambda x, y: cut(x * np.array([0.5, 0.0, 0.25]), 16),
    "exact truncation": lambda x, y: rounded(x * np.array([0.5, 0.0, 0.25]), 16),
    "sign": lambda x, y: sign(x * np.array([1, 0, 1])),
    "square root": lambda x, y: sqrt(0 * x),
    "masked anew": masked_anew,
}
REFUSED = {
    "sign of all pairs": lambda x, y: sign(x[:, None] - x[None, :]),
    "reciprocal of all pairs": lambda x, y: reciprocal(x[:, None] - x[None, :]),
    "truncation of all pairs": lambda x, y: cut((x[:, None] - x[None, :]) * 0.5, 16),
    "square root of nothing": lambda x, y: sqrt(x - x),
    "sign of a fractional part": fractional_part,
}


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", WITH_A_ZERO)
def test_a_public_zero_makes_a_new_mask(name, security):
    run = program(WITH_A_ZERO[name])
    assert np.array_equal(run_local(run, X, [0.0], security).value, run_clear(run, X, [0.0]).value)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", REFUSED)
def test_a_value_minus_itself_is_refused_with_what_to_do(name, security):
    with pytest.raises(ValueError, match="fresh=True"):
        run_local(program(REFUSED[name]), X, [0.0], security)


def test_a_mask_that_lost_its_high_bits_is_refused():
    with pytest.raises(ValueError, match="fresh=True"):
        run_local(program(half_the_fractional_part), X, [0.0])


SMALL = 8.0
"""A norm of which the masks are small integers."""


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(
    "name",
    sorted(WITH_A_ZERO | REFUSED),
)
def test_nothing_is_refused_where_masks_are_small_integers(name, security):
    run = program((WITH_A_ZERO | REFUSED)[name], max_norm=SMALL)
    right = run_clear(run, X, [0.0]).value
    assert run_local(run, X, [0.0], security).value == pytest.approx(right, rel=2**-16)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_small_mask_that_lost_its_high_bits_is_none_the_worse(security):
    run = program(half_the_fractional_part, max_norm=SMALL)
    x = [3.25, 4.5, -5.0 + 2**-8]
    right = run_clear(run, x, [0.0]).value
    assert run_local(run, x, [0.0], security).value == pytest.approx(right, abs=2**-8)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("frac", [4, 24, 30])
def test_a_quotient_is_as_fine_as_it_is_asked_to_be(frac, security):
    async def run(engine, x, y):
        return await divide(x, y, largest=1.0, frac=frac)

    x, y = [3 / 65536, 1.0, -7.0, 0.0], [1000.0, 3.0, 8.0, 5.0]
    exact = np.array(x) / np.array(y)
    error = np.abs(run_local(run, x, y, security).value - exact)
    assert (error <= np.abs(exact) * 2.0**-16 + 2.0**-frac).all()


@pytest.mark.parametrize("security", SECURITIES)
def test_counts_can_be_rooted_divided_by_and_added(security):
    async def run(engine, x, y):
        count = (await nonnegative(x)).sum()
        mean = await divide(x.sum(), count, largest=1e6)
        return mean + await sqrt(count * 20)

    assert run_local(run, X, [0.0], security).value == pytest.approx(1.0 + np.sqrt(40), abs=1e-4)


@pytest.mark.parametrize("bits", [63, 64, 65, 90])
def test_a_rescaled_value_is_the_same_number(bits):
    async def run(x, y):
        return x.rescaled(16 + bits) * (1 << 3)

    assert np.array_equal(run_local(program(run, max_norm=1.0), [0.25, -0.5], [0.0]).value, [2.0, -4.0])
