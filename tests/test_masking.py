"""Masking: what it costs, that it changes nothing, hides everything, and refuses what it cannot hide."""

import secrets

import numpy as np
import pytest
from gate_helpers import SECURITIES, WIDEST, edges, exactly, integers, run_gate
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import dot, mask, measure, multiply, nonnegative, round_exactly, run_local, truncate
from spdz.arithmetic.bound import Bound
from spdz.arithmetic.field import P

X = np.array([[0.5, -1.0, 2.0], [0.25, -0.125, 3.0]])
Y = np.array([[1.0, 0.5, -0.5], [4.0, 2.0, -1.5]])


def program(function):
    async def run(engine, x, y):
        return await function(x, y)

    return run


async def nothing_masked(x, y):
    return dot(x, y).sum() + x.sum(0).sum()


async def one_masked(x, y):
    (z,) = await mask(dot(x, y))
    return z.sum() + x.sum(0).sum()


async def three_masked(x, y):
    a, b, c = await mask(dot(x, y), multiply(x, y), dot(x, x)[0])
    return a.sum() + b.sum(0).sum() + c


async def inputs_masked(x, y):
    x, y = await mask(x, y)
    return dot(x, y).sum() + x.sum(0).sum()


async def some_masked(x, y):
    x, a, y, b = await mask(x, dot(x, y), y, dot(x, x))
    return dot(x, y).sum() + a.sum() + b.sum()


async def masked_twice(x, y):
    (z,) = await mask(dot(x, y))
    (z,) = await mask(z)
    return z.sum()


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(
    ("function", "rounds", "entries"),
    [
        (nothing_masked, 0, 0),
        (one_masked, 1, 2),
        (three_masked, 1, 2 + 6 + 1),
        (inputs_masked, 0, 0),
        (some_masked, 1, 2 + 2),
        (masked_twice, 1, 2),
    ],
)
def test_one_round_and_one_element_for_each_entry_that_is_not_masked_yet(function, rounds, entries, security):
    base = run_local(program(nothing_masked), X, Y, security).stats
    stats = run_local(program(function), X, Y, security).stats
    check = 1 if security == "malicious" and rounds else 0
    for before, after in zip(base, stats, strict=True):
        assert after.rounds - before.rounds == rounds + check
        assert after.field_elements_sent - before.field_elements_sent == entries
        assert after.correlations["mask"] == entries


@pytest.mark.parametrize("security", [*SECURITIES, None])
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_masking_changes_no_number_and_keeps_the_order(security, data):
    shapes = data.draw(st.lists(st.sampled_from([(), (1,), (3,), (2, 2), (2, 1, 3)]), min_size=1, max_size=4))
    bound = data.draw(st.sampled_from([1, 2**20, WIDEST, 2**90]))
    generator = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    operands = []
    for shape in shapes:
        size = int(np.prod(shape))
        numbers = [int(sign) * secrets.randbelow(bound + 1) for sign in generator.choice([-1, 1], size)]
        operands.append(integers(*numbers).reshape(shape))
    for i, operand in enumerate(operands):

        async def pick(*values, i=i):
            masked = await mask(*values)
            assert [z.masked for z in masked] == [True] * len(masked)
            assert [(z.shape, z.frac, z.bound) for z in masked] == [
                (z.shape, z.frac, z.bound) for z in values
            ]
            return masked[i]

        value = run_gate(pick, *operands, bound=bound, frac=3, security=security, shared=True).value
        assert np.array_equal(np.asarray(value) * 8, operand)


@pytest.mark.parametrize("z", [0, 1, -1, WIDEST, -WIDEST, 2**100, -(2**100)], ids=str)
@pytest.mark.parametrize("bound", [1, 2**40, WIDEST, 2**90], ids=lambda bound: f"{bound.bit_length()} bits")
def test_what_is_opened_is_uniform_whatever_the_value(z, bound):
    """Also for a value out of its range, which a cheating peer can cause, and for one too long to compare."""
    size, frames = 4000, []

    async def masked(engine, x, y):
        a = engine.shared(x[..., 0] + y[..., 0]).plus_raw(z)
        a.bound = Bound.of_entry(bound, a.shape)
        (a,) = await mask(a)
        return a[0]

    def watch(number, sender, frame):
        if number == 1:
            frames.append(np.frombuffer(frame, dtype="<u8").reshape(-1, 2))
        return frame

    zeros = np.zeros((size, 1))
    run_local(masked, zeros, zeros, "semi-honest", tamper=watch)
    shares = [[int(low) + (int(high) << 64) for low, high in frame.tolist()] for frame in frames]
    opened = [(a + b) % P for a, b in zip(*shares, strict=True)]
    for classes in ([c * 8 // P for c in opened], [c % 8 for c in opened]):
        counts = np.bincount(classes, minlength=8)
        assert ((counts - size / 8) ** 2 / (size / 8)).sum() < 70  # by chance once in 10^12


def test_a_second_run_opens_other_numbers():
    seen = []

    def watch(number, sender, frame):
        if number == 1:
            seen.append(bytes(frame))
        return frame

    for _ in range(3):
        run_local(program(one_masked), X, Y, tamper=watch)
    assert len(set(seen)) == len(seen) == 6


async def compared(z):
    return await nonnegative(z)


async def cut(z):
    return (await truncate(z, frac=0))[0]


async def rounded(z):
    return (await round_exactly(z, frac=0))[0]


@pytest.mark.parametrize("shared", [False, True], ids=["masked", "shared"])
@pytest.mark.parametrize("gate", [compared, cut, rounded])
@pytest.mark.parametrize("security", SECURITIES)
def test_86_bits_are_compared_and_truncated_and_87_refused(gate, shared, security):
    for z in (WIDEST - 1, -WIDEST + 1, 0, -1):
        value = run_gate(gate, z, bound=WIDEST - 1, frac=1, security=security, shared=shared).value
        assert value in ((z >= 0,) if gate is compared else (z >> 1, (z >> 1) + 1))
    with pytest.raises(
        ValueError, match=r"over 87 bits .* 127 bits: lower max_norm, truncate first, or mask"
    ):
        run_gate(gate, 0, bound=WIDEST + 1, frac=1, security=security, shared=shared)


@pytest.mark.parametrize("gate", [cut, rounded])
def test_more_bits_than_a_mask_can_spare_are_not_cut_off(gate):
    """Cutting needs a mask that is much longer than what goes, however small the value is."""
    for frac in (86, 87, 100, 121, 126):
        with pytest.raises(ValueError, match="truncate first"):
            run_gate(gate, integers(1, -1), bound=1, frac=frac, security="malicious")


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("gate", [compared, cut])
def test_a_truncated_value_is_masked_anew_where_its_mask_has_become_too_short(gate, security):
    """What is left of the mask after 50 bits went is 77 bits: enough for 36 bits and not for 37."""
    rounds = []
    for bound in ((1 << 35) - 1, 1 << 35):

        async def again(z, bound=bound):
            (z,) = await truncate(z, frac=30)
            assert z.mask_bits == 77
            z.bound = Bound.of_entry(bound, z.shape)
            return await gate(z)

        z = 5 << 80
        outcome = run_gate(again, z, bound=WIDEST, frac=80, security=security)
        assert outcome.value == (gate is compared or 5)
        rounds.append(outcome.stats[0].rounds)
    assert rounds[1] - rounds[0] == (2 if security == "malicious" else 1)  # it is checked, too


def test_a_shared_value_is_not_multiplied_but_told_to_be_masked():
    for gate in (dot, multiply):

        async def product(engine, x, y, gate=gate):
            return gate(engine.shared(x), y)

        with pytest.raises(TypeError, match="mask"):
            exactly(product, X, Y, "malicious")


def test_a_long_value_is_masked_for_products():
    async def product(a, b):
        a, b = await mask(a, b)
        b.bound = Bound.of_entry(1, b.shape)
        return multiply(a, b)

    z = integers(2**97, -(2**97) + 1, -1, 0)
    for security in SECURITIES:
        value = run_gate(product, z, integers(1), bound=2**97, security=security, shared=True)
        assert np.array_equal(value.value, z)


def test_programs_that_mask_differently_have_other_recipes():
    shapes = (X.shape, Y.shape)
    functions = [nothing_masked, one_masked, three_masked, some_masked]
    recipes = {measure(program(function), shapes, "malicious").recipe for function in functions}
    assert len(recipes) == len(functions)


def test_edges_are_within_their_bound():
    """The helper that other tests rely on."""
    for bound in (1, 5, WIDEST):
        assert abs(edges(bound)).max() == bound
