"""Gates in place on inputs whose masks are small integers: exact at all ends, in no round, or refused."""

from contextlib import contextmanager
from itertools import product
from unittest.mock import patch

import numpy as np
import pytest

from dealer.recipe import deal_job
from spdz import (
    absolute,
    largest,
    mask,
    maximum,
    measure,
    multiply,
    nonnegative,
    power,
    round_exactly,
    run_clear,
    run_local,
    sign,
    truncate,
)
from spdz.arithmetic.field import P
from spdz.arithmetic.fixed_point import norm_bound
from spdz.gates.masking import in_place
from spdz.values import input_mask
from spdz.values.value import concatenate

SECURITIES = ["malicious", "semi-honest"]
both_modes = pytest.mark.parametrize("security", SECURITIES)
NORM = norm_bound(1.0, 1)
BITS = input_mask.job_bits((1,), NORM)


def program(function, max_norm=1.0):
    async def run(engine, x, y):
        result = function(x, y)
        return await result if hasattr(result, "__await__") else result

    run.max_norm = max_norm
    return run


async def cut(z, frac):
    (result,) = await truncate(z, frac=frac)
    return result


async def rounded(z, frac):
    (result,) = await round_exactly(z, frac=frac)
    return result


@contextmanager
def masks(of_x, of_y):
    """The masks s of party 0's coordinate, of shape (1,), and of party 1's, of shape (1, 1)."""

    def offsets(words, bits):
        return np.full(words.shape, of_x if words.shape == (1,) else of_y, dtype=np.int64)

    with patch.object(input_mask, "offsets", offsets):
        yield


def ends(x):
    """The least and the largest s under which a raw coordinate is sent."""
    return max(0, NORM - x), min(1 << BITS, (1 << BITS) - NORM - x) - 1


# -- the ends of everything ------------------------------------------------------------------------------

COMPARED = {
    "x": lambda x, y: nonnegative(x),
    "-x": lambda x, y: nonnegative(-x),
    "x - y": lambda x, y: sign(x - y),
    "y - x": lambda x, y: sign(y - x),
    "x + y": lambda x, y: sign(x + y),
    "-x - y": lambda x, y: sign(-x - y),
    "x - x": lambda x, y: sign(x - x),
    "2 x - 2 y - x + y": lambda x, y: sign(x * 2 - y * 2 - x + y),
    "-255 x": lambda x, y: sign(x * -255),
    "255 y - 257 x": lambda x, y: sign(y * 255 - x * 257),
    "|x - y|": lambda x, y: absolute(x - y),
    "max(x, y)": lambda x, y: maximum(x, y),
    "max(y - x, 3)": lambda x, y: maximum(y - x, 3),
    "the largest": lambda x, y: largest(concatenate(x, y[0], -y[0], -x)),
    "a comparison with far more than the mask": lambda x, y: sign(x.plus_raw(1 << 70) - (1 << 54)),
    "x rounded": lambda x, y: rounded(x, 5),
    "x - y rounded": lambda x, y: rounded(x - y, 0),
    "y - x rounded from far": lambda x, y: rounded((y - x).rescaled(70), 3),
}
EXTREMES = (65536, -65536, 0, 1, -1)


@both_modes
@pytest.mark.parametrize("name", COMPARED)
def test_comparisons_are_exact_at_both_ends_of_inputs_and_masks(name, security):
    run = program(COMPARED[name])
    for x, y in product(EXTREMES, EXTREMES[:3]):
        inputs = np.array([x / 65536]), np.array([[y / 65536]])
        right = run_clear(run, *inputs).value
        for s, t in product(ends(x), ends(y)):
            with masks(s, t):
                assert np.array_equal(run_local(run, *inputs, security).value, right), (x, y, s, t)


CUT = {
    "x by 1": (15, lambda x, y: cut(x, 15)),
    "-x by 16": (0, lambda x, y: cut(-x, 0)),
    "x - y by 9": (7, lambda x, y: cut(x - y, 7)),
    "x - x by 16": (0, lambda x, y: cut(x - x, 0)),
    "y by more than it has": (0, lambda x, y: cut(y.rescaled(90), 0)),
    "-31 x by 3": (13, lambda x, y: cut(x * -31, 13)),
}


@both_modes
@pytest.mark.parametrize("name", CUT)
def test_cuts_are_off_by_less_than_a_unit_at_both_ends_of_inputs_and_masks(name, security):
    frac, function = CUT[name]
    exact = {"x": 1, "-x": -1, "-31 x": -31, "x - y": 1, "x - x": 0, "y": 0}[name.partition(" by")[0]]
    for x, y in product(EXTREMES, EXTREMES[:3]):
        right = exact * x - y * name.startswith("x - y") + y * name.startswith("y")
        for s, t in product(ends(x), ends(y)):
            with masks(s, t):
                value = run_local(
                    program(function), np.array([x / 65536]), np.array([[y / 65536]]), security
                ).value
            assert abs(value.item() * 2**frac - right * 2.0 ** (frac - 16)) < 1, (x, y, s, t)


async def bit_by_bit(x, y):
    z = x - y
    for frac in reversed(range(16)):
        z = await cut(z, frac)
    return z


async def cut_and_scaled(x, y):
    """The mask loses bits and gets them back, many times."""
    z = x - y
    for _ in range(12):
        z = (await cut(z, 6)).rescaled(16)
    return z


async def cut_then_compared(x, y):
    z = await cut(await cut(x - y, 9), 4)
    return await sign(z * 16 - await cut(x - y, 4) * 16 + 3)


@both_modes
def test_cuts_of_cuts_stay_exact(security):
    x, y = np.array([0.25, -0.5, 0.5, 0.0]), np.array([-0.25, 0.5, -0.5, 0.125])
    for function, error in ((bit_by_bit, 2), (cut_and_scaled, 12 * 2**-6), (cut_then_compared, 0)):
        run = program(function)
        for _ in range(5):
            value = run_local(run, x, y, security).value
            assert (np.abs(value - run_clear(run, x, y).value) <= error).all()


# -- how large masks are ---------------------------------------------------------------------------------


async def derived(x, y):
    """All that keeps a small mask."""
    table = x[:, None] - y[None, :]
    once = await cut(x - y, 8)
    twice = await cut(once, 3)
    return [
        *(x, y, -x, x - y, x - x, x * 7, x * -3 - y * 5, x * np.arange(-32, 32), x * 0.75, x.rescaled(40)),
        *(x.sum(), (x - y).sum(), table, table.sum(0), table.sum().sum(), x.reshape(8, 8).sum(0), x[3:9]),
        *(x + 1000, x.plus_raw(1 << 60), x.broadcast((3, 64)).sum(0), x.bounded(x.bound)),
        *(
            concatenate(x, y * 9),
            concatenate(y * 9, x).sum(),
            once,
            twice,
            twice.sum(),
            once - x,
            x - twice * 5,
        ),
        await cut(x.plus_raw(1 << 60), 0),
        await cut((x * 1000).rescaled(60), 2),
        await cut(x * 2.0**-16 * 2.0**-16 * 2.0**-16, 0),  # more goes than the mask has
    ]


@pytest.mark.parametrize("most", [False, True])
def test_no_mask_is_larger_than_its_span(most):
    """Of all values that the dealer sees, with masks s anywhere, and with all of them at their largest."""
    seen = []

    async def run(x, y):
        seen[:] = await derived(x, y)
        return x

    plan = measure(program(run), ((64,), (64,)), "semi-honest")
    offsets = (lambda words, bits: np.full(words.shape, (1 << bits) - 1)) if most else input_mask.offsets
    with patch.object(input_mask, "offsets", offsets):
        deal_job(program(run), plan, "semi-honest", (b"a" * 32, b"b" * 32), None)
    for z in seen:
        numbers = [low + (high << 64) for low, high in z.parts[0].reshape(-1, 2).tolist()]
        assert max(min(number, P - number) for number in numbers) <= z.span
        assert z.mask_bits == 127


# -- refusals --------------------------------------------------------------------------------------------


@both_modes
@pytest.mark.parametrize("gate", [sign, lambda z: cut(z, 3), lambda z: rounded(z, 3)])
def test_inputs_are_scaled_up_until_they_no_longer_fit_and_are_then_refused_before_dealing(gate, security):
    x, y = np.array([0.5, -0.75, 0.25]), np.array([0.0, 0.5, -0.25])
    fitted = []
    for by in range(0, 100, 3):
        run = program(lambda x, y: gate((x - y) * (1 << by)))  # noqa: B023
        try:
            measure(run, ((3,), (3,)), security)
        except ValueError as error:
            assert "lower max_norm" in str(error)
            with pytest.raises(ValueError, match="lower max_norm"):
                run_local(run, x, y, security)
            continue
        fitted.append(by)
        assert np.abs(run_local(run, x, y, security).value - run_clear(run, x, y).value).max() <= 2**-3
    assert fitted == list(range(0, fitted[-1] + 1, 3)) and 66 <= fitted[-1] <= 75


def test_what_is_refused_is_what_would_wrap():
    async def run(x, y):
        for span, fits in (((1 << 124) - 1, True), (1 << 124, False)):
            x.span = span
            if fits:
                moved, bits = in_place(x)
                assert (moved.span, moved.mask_bits, bits) == (0, 127, 18)
            else:
                with pytest.raises(ValueError, match="lower max_norm"):
                    in_place(x)
        x.span = 1
        return x

    measure(program(run), ((1,), (1,)), "malicious")


# -- costs -----------------------------------------------------------------------------------------------


@both_modes
def test_gates_in_place_take_no_round(security):
    x, y = np.array([0.5, -0.5]), np.array([0.25, -0.25])
    plain = run_local(program(lambda x, y: x + y), x, y, security).stats[0]
    for name in ("x - y", "max(x, y)", "|x - y|", "x - y rounded", "y - x"):
        stats = run_local(program(COMPARED[name]), x, y, security).stats[0]
        assert stats.rounds == plain.rounds and stats.bytes_sent == plain.bytes_sent


# -- what is put together with other masks ---------------------------------------------------------------


async def masked_product(x, y, scale):
    (z,) = await mask(multiply(x, y) * scale)
    return z


async def sum_with_a_fresh_mask(x, y):
    return await nonnegative(x * 2**30 + await masked_product(x, y, 2**20))


async def sum_with_what_is_left_of_one(x, y):
    return await nonnegative(await cut((await masked_product(x, y, 1)).rescaled(64), 16) - x * 2**20)


async def beside_a_fresh_mask(x, y):
    return await nonnegative(concatenate(x, await masked_product(x, y, 2**34)))


async def roots_beside_a_fresh_mask(x, y):
    a, b = await power(x, await masked_product(x, y, 2**34), alpha=0.5)
    return concatenate(a.mantissa, b.mantissa)


async def nothing_compared(x, y):
    return await sign(x * 0)


async def nothing_cut(x, y):
    return await cut(0 * (x - y), 4)


@both_modes
@pytest.mark.parametrize(
    "function",
    [
        sum_with_a_fresh_mask,
        sum_with_what_is_left_of_one,
        beside_a_fresh_mask,
        roots_beside_a_fresh_mask,
        nothing_compared,
        nothing_cut,
    ],
    ids=lambda function: function.__name__,
)
def test_other_masks_beside_small_ones_and_none_change_nothing(function, security):
    x, y = np.array([0.25, 0.5, 0.125]), np.array([0.5, -0.25, 0.75])
    run = program(function)
    assert run_local(run, x, y, security).value == pytest.approx(run_clear(run, x, y).value, rel=2**-16)
