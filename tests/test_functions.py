"""Roots, reciprocals, division and normalisation: errors over the whole range, and every special value.

Errors are measured against exact arithmetic (fractions, integer square roots, gmpy2 with 300 bits), which
shares nothing with the tables but the inputs.
"""

import random
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import isqrt

import gmpy2
import numpy as np
import pytest
from gate_helpers import SECURITIES, WIDEST, exactly, integers, run_gate
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.cosine import cosine
from protocols.scores import rounded
from spdz import (
    absolute,
    divide,
    dot,
    l1_normalised,
    l2_normalised,
    mask,
    measure,
    multiply,
    power,
    reciprocal,
    reciprocal_sqrt,
    run_local,
    sign,
    sqrt,
    truncate,
)
from spdz.functions.power import FINE_BITS, T_BITS
from spdz.functions.segments import DEGREE, EXTRA, MANTISSA_BITS, table

HALF = Fraction(1, 2)
ALPHAS = [Fraction(-1), -HALF, HALF]
MANTISSA_ERROR = {Fraction(-1): 2**-16.3, -HALF: 2**-17.3, HALF: 2**-18.1}
"""Of the mantissa cut to 22 bits, relative."""

INTERPOLATION_ERROR = {Fraction(-1): 2**-17, -HALF: 2**-18.8, HALF: 2**-21}
REFINED_ERROR = 2.0**-30
FRAC, BITS = 32, 79
"""Of a dot product of two inputs and its double: the numbers 2^-32 to 2^46, in raw units 1 to 2^78."""


def true_power(u, frac, alpha):
    """``(u 2^-frac)^alpha`` as a fraction, precise to 2^-290 of itself; 0 for 0."""
    if not u:
        return Fraction(0)
    with gmpy2.context(precision=300):
        value = gmpy2.mpfr(gmpy2.mpq(abs(u), 1 << frac)) ** gmpy2.mpfr(gmpy2.mpq(alpha))
        return Fraction(*map(int, value.as_integer_ratio())) * (1 if u > 0 else -1)


def relative(value, truth):
    """Largest relative error; what should be zero must be."""
    pairs = list(zip(np.atleast_1d(value), truth, strict=True))
    assert all(value == 0 for value, true in pairs if true == 0)
    return max((float(abs(value / true - 1)) for value, true in pairs if true), default=0.0)


@cache
def sample(largest, seed=1, ends=60, others=30):
    """Powers of two and their neighbours, ends of segments, random numbers of every length."""
    generator = random.Random(f"{largest} {seed}")
    starts = [segment.start for segment in table(HALF, largest).segments]
    some = generator.sample(starts, min(ends, len(starts)))
    numbers = {largest, largest - 1, *(1 << k for k in range(largest.bit_length())), *some}
    numbers |= {number + step for number in numbers for step in (-1, 1)}
    numbers |= {int(2 ** generator.uniform(0, largest.bit_length())) for _ in range(others)}
    return integers(*sorted(number for number in numbers if 1 <= number <= largest))


# -- the tables -----------------------------------------------------------------------------------------

LARGEST = [1, 2, 3, 7, 100, 2**10 - 1, 2**16, 2**20 + 5, 2**39, 2**62 + 12345, 2**78, WIDEST]


@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
@pytest.mark.parametrize("largest", LARGEST, ids=hex)
def test_segments_cover_the_range_and_are_as_narrow_as_promised(alpha, largest):
    known = table(alpha, largest)
    assert known.segments[0].start == 1
    assert known.segments[-1].start <= largest
    assert len(known.segments) <= 4 * largest.bit_length()
    assert known.deviation < Fraction(91, 1000)
    one = 1 << known.length
    stops = [segment.start for segment in known.segments[1:]] + [largest + 1]
    for segment, stop in zip(known.segments, stops, strict=True):
        assert segment.start < stop
        for u in (segment.start, stop - 1):
            assert abs(Fraction(u * segment.reciprocal, one) - 1) <= known.deviation
        middle = Fraction(segment.start + stop - 1, 2)
        assert abs(middle * segment.reciprocal / one - 1) <= Fraction(1, 1 << (EXTRA + 1))
        assert segment.reciprocal.bit_length() > EXTRA
        scale = Fraction(2) ** segment.exponent
        exact = true_power(one, 0, alpha) / true_power(segment.reciprocal, 0, alpha)
        assert abs(segment.mantissa * scale / (1 << MANTISSA_BITS) / exact - 1) < Fraction(1, 1 << 20)
        assert 1 << MANTISSA_BITS <= segment.mantissa <= 2 << MANTISSA_BITS


@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
@pytest.mark.parametrize("largest", LARGEST, ids=hex)
def test_the_polynomial_is_as_close_as_promised(alpha, largest):
    known = table(alpha, largest)
    worst = 0.0
    for i in range(-400, 401):
        t = known.deviation * i / 400
        value = sum(a * t**k for k, a in enumerate(known.coefficients))
        exact = true_power((1 + t).numerator, 0, alpha) / true_power((1 + t).denominator, 0, alpha)
        worst = max(worst, float(abs(value / exact - 1)))
    assert worst < INTERPOLATION_ERROR[alpha]
    if largest > 2**16:
        assert worst > INTERPOLATION_ERROR[alpha] * 2**-0.7  # the promise is not idle


@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
@pytest.mark.parametrize("largest", LARGEST, ids=hex)
def test_the_mantissa_is_as_precise_as_promised(alpha, largest):
    """The algorithm on integers, with the worst dither: both ways to cut t, and both to cut the mantissa."""
    known = table(alpha, largest)
    coefficients = [round(a * (1 << FINE_BITS) / (1 << T_BITS * k)) for k, a in enumerate(known.coefficients)]
    assert len(coefficients) == DEGREE + 1
    generator = random.Random(largest)
    stops = [segment.start for segment in known.segments[1:]] + [largest + 1]
    drop, cut = known.length - T_BITS, MANTISSA_BITS + FINE_BITS - 22
    worst = 0.0
    for segment, stop in zip(known.segments, stops, strict=True):
        ends = {segment.start + i for i in range(3)} | {stop - 1 - i for i in range(3)}
        inside = {generator.randrange(segment.start, stop) for _ in range(8)}
        for u in ends | inside | {(segment.start + stop) // 2}:
            if not segment.start <= u < stop:
                continue
            deviation = u * segment.reciprocal - (1 << known.length)
            exact = true_power(u, 0, alpha) / Fraction(2) ** segment.exponent * (1 << 22)
            for t in {deviation >> drop, -(-deviation >> drop)}:
                mantissa = segment.mantissa * sum(a * t**k for k, a in enumerate(coefficients))
                assert 0.9 * 2**cut * 2**22 < mantissa < 2.2 * 2**cut * 2**22
                for result in (mantissa >> cut, -(-mantissa >> cut)):
                    worst = max(worst, float(abs(result / exact - 1)))
    assert worst < MANTISSA_ERROR[alpha]
    if largest > 2**30:
        assert worst > MANTISSA_ERROR[alpha] * 2**-0.3


CONTEXTS = [
    {"round": gmpy2.RoundUp},
    {"round": gmpy2.RoundDown, "precision": 2},
    {"round": gmpy2.RoundToZero, "precision": 1000},
    {"emax": 40, "emin": -40, "subnormalize": True},
    {"trap_inexact": True, "trap_underflow": True},
]


@pytest.mark.parametrize("context", CONTEXTS, ids=str)
@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
def test_tables_do_not_depend_on_the_callers_arithmetic(alpha, context):
    expected = [table.__wrapped__(alpha, largest) for largest in (1000, 2**78)]
    with gmpy2.context(**context) as mine:
        before = str(mine)
        assert [table.__wrapped__(alpha, largest) for largest in (1000, 2**78)] == expected
        assert str(gmpy2.get_context()) == before


def test_coefficients_are_plain_numbers():
    """So that programs are hashed alike whatever library made them."""
    known = table(-HALF, 1000)
    assert {type(a.numerator) for a in known.coefficients} == {int}
    assert {type(s.reciprocal) for s in known.segments} == {type(s.mantissa) for s in known.segments} == {int}


# -- roots and reciprocals ------------------------------------------------------------------------------

FUNCTIONS = [
    pytest.param(sqrt, HALF, REFINED_ERROR, id="sqrt"),
    pytest.param(reciprocal_sqrt, -HALF, MANTISSA_ERROR[-HALF], id="reciprocal_sqrt"),
    pytest.param(reciprocal, Fraction(-1), MANTISSA_ERROR[Fraction(-1)], id="reciprocal"),
]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(("function", "alpha", "error"), FUNCTIONS)
def test_the_whole_range(function, alpha, error, security):
    """2^-32 to 2^46, one unit and all powers of two and their neighbours among them."""
    u = sample(1 << (BITS - 1), seed=security)
    value = run_gate(function, u, bound=1 << (BITS - 1), frac=FRAC, security=security, shared=True).value
    assert relative(value, [true_power(one, FRAC, alpha) for one in u]) < error


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("frac", [0, 1, 16, 31])
@pytest.mark.parametrize(("function", "alpha", "error"), FUNCTIONS)
def test_short_ranges(function, alpha, error, frac, security):
    """Odd numbers of fractional bits too; where a square root cannot exceed 4 it is not refined."""
    bound = 300
    u = integers(*range(-2, bound + 1)) if frac == 1 else sample(bound)
    value = run_gate(function, u, bound=bound, frac=frac, security=security).value
    signs = integers(*(1 if alpha == -1 else int(one >= 0) for one in u))
    truth = [true_power(one, frac, alpha) for one in u * signs]
    error = MANTISSA_ERROR[HALF] if function is sqrt and bound <= 16 << frac else error
    assert relative(value, truth) < error


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("bound", [1, 2, 3, 2**20, 2**40 - 1], ids=hex)
@pytest.mark.parametrize(("function", "alpha", "error"), FUNCTIONS)
def test_zero_and_one_unit_and_the_bound_itself(function, alpha, error, bound, security):
    for frac in (16, 34):
        u = integers(0, 1, bound, 0, bound)
        value = run_gate(function, u, bound=bound, frac=frac, security=security).value
        error = MANTISSA_ERROR[HALF] if function is sqrt and bound <= 16 << frac else error
        assert relative(value, [true_power(one, frac, alpha) for one in u]) < error


@pytest.mark.parametrize("security", [*SECURITIES, None])
def test_signs(security):
    bound = 2**50
    u = integers(*(one * sign for one in sample(bound, ends=3, others=9)[::5] for sign in (1, -1)))
    both, positive = (
        run_gate(lambda z, p=p: reciprocal(z, positive=p), u, bound=bound, frac=16, security=security).value
        for p in (False, True)
    )
    assert relative(both, [true_power(one, 16, -1) for one in u]) < MANTISSA_ERROR[Fraction(-1)]
    truth = [true_power(max(one, 0), 16, -1) for one in u]
    assert relative(positive, truth) < MANTISSA_ERROR[Fraction(-1)]
    for function, alpha in ((sqrt, HALF), (reciprocal_sqrt, -HALF)):
        value = run_gate(function, u, bound=bound, frac=16, security=security).value
        truth = [true_power(max(one, 0), 16, alpha) for one in u]
        assert relative(value, truth) < MANTISSA_ERROR[-HALF]


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=15, deadline=None)
@given(data=st.data(), bits=st.integers(1, 80), frac=st.integers(0, 40), which=st.sampled_from(FUNCTIONS))
def test_roots_and_reciprocals(security, data, bits, frac, which):
    function, alpha, error = which.values
    bits -= bits == 80 and frac % 2 == 1 and alpha != -1  # an odd number of fractional bits takes one more
    bound = (1 << bits) - 1
    length = st.integers(0, bits - 1).flatmap(lambda k: st.integers(1 << k, (2 << k) - 1))
    u = integers(*data.draw(st.lists(st.one_of(length, st.just(0)), min_size=1, max_size=4)))
    value = run_gate(function, u, bound=bound, frac=frac, security=security).value
    error = MANTISSA_ERROR[HALF] if function is sqrt and bound <= 16 << frac else error
    assert relative(value, [true_power(one, frac, alpha) for one in u]) < error


@pytest.mark.parametrize(("function", "alpha", "error"), FUNCTIONS)
def test_the_clear_reading_is_the_function_rounded(function, alpha, error):
    for frac, bits in ((32, 78), (16, 20), (31, 33)):
        u = sample((1 << bits) - 1, others=60)
        value = run_gate(function, u, bound=(1 << bits) - 1, frac=frac).value
        assert relative(value, [true_power(one, frac, alpha) for one in u]) < 2.0**-22


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("number", [2.0**-16, 3.0, 2.0**21 + 0.5, 2.0**22])
def test_of_real_inputs(number, security):
    """From one unit of an input to the square of the largest one, and times four: 2^-16 to 2^46."""

    for i, truth in enumerate((2 * number, -1 / (4 * number**2), 1 / (2 * number))):

        async def one(engine, x, y, i=i):
            square = dot(x, y)
            function = (sqrt, lambda u: reciprocal(-u), reciprocal_sqrt)[i]
            return await function(square * 4)

        value = exactly(one, [number], [number], security).value
        assert abs(value / Fraction(truth) - 1) < (REFINED_ERROR, 2**-16.3, 2**-17.3)[i]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 2), (2, 1, 3)], ids=str)
def test_shapes_are_kept(shape, security):
    size = int(np.prod(shape))
    u = sample(2**30)[:size].reshape(shape)
    for function in (sqrt, reciprocal_sqrt, reciprocal):
        assert np.shape(run_gate(function, u, bound=2**30, frac=4, security=security).value) == shape


@pytest.mark.parametrize("security", SECURITIES)
def test_several_powers_at_once_are_the_single_ones(security):
    """Values on different scales and in different shapes, in one batch."""
    operands = integers(1, 64, 0), np.array(4, dtype=object), integers(256, 17)
    fractions = [3, 9, 3]
    for i, (operand, frac) in enumerate(zip(operands, fractions, strict=True)):

        async def together(a, b, c, i=i):
            b.frac = 9
            powers = await power(a, b, c.reshape(2, 1), alpha=-HALF)
            shapes = [(p.mantissa.shape, p.scale.shape) for p in powers]
            assert shapes == [((3,), (3,)), ((), ()), ((2, 1), (2, 1))]
            mantissas = await truncate(*(p.mantissa for p in powers), frac=22)
            return multiply(mantissas[i], powers[i].scale).reshape(-1)

        value = run_gate(together, *operands, bound=300, frac=3, security=security).value
        truth = [true_power(one, frac, -HALF) for one in operand.ravel()]
        assert relative(value, truth) < MANTISSA_ERROR[-HALF]


@pytest.mark.parametrize("alpha", [0.5, -0.5, -1, -1.0, np.float32(-0.5), np.int64(-1)], ids=repr)
def test_a_power_is_a_number_of_any_type(alpha):
    async def function(u):
        (result,) = await power(u, alpha=alpha)
        return result.scale

    async def exact(u):
        (result,) = await power(u, alpha=Fraction(float(alpha)))
        return result.scale

    u = integers(1, 7, 2**20)
    for security in (*SECURITIES, None):
        value = run_gate(function, u, bound=2**30, frac=5, security=security).value
        assert np.array_equal(value, run_gate(exact, u, bound=2**30, frac=5, security=security).value)


OTHER_POWERS = [Fraction(1), Fraction(2), Fraction(1, 3), 0, 0.25, np.nan, None, "x"]


@pytest.mark.parametrize("alpha", OTHER_POWERS, ids=str)
def test_other_powers_are_refused(alpha):
    async def other(u):
        return (await power(u, alpha=alpha))[0].scale

    with pytest.raises(ValueError, match="1/2, -1/2 or -1"):
        run_gate(other, 4, bound=9, security="malicious")


def test_what_is_too_long_is_refused():
    for function in (sqrt, reciprocal, reciprocal_sqrt):
        with pytest.raises(ValueError, match="lower max_norm"):
            run_gate(function, 1, bound=1 << 87, frac=0, security="malicious")


@pytest.mark.parametrize("security", SECURITIES)
def test_rounds(security):
    def rounds(function, *, max_norm=2.0):
        async def program(engine, x, y):
            return await function(dot(x, y))

        program.max_norm = max_norm
        plan = measure(program, ((3,), (3,)), security)
        assert run_local(program, [0.5, 0, 1], [1, 0, 1], security).stats[0].rounds == plan.rounds
        return plan.rounds - (4 if security == "malicious" else 2)  # input, output, two checks

    assert rounds(sqrt) == rounds(reciprocal) == rounds(reciprocal_sqrt) == 3
    assert rounds(sqrt, max_norm=100.0) == 5
    assert rounds(lambda u: divide(u, u, largest=1.0)) == 4


# -- division -------------------------------------------------------------------------------------------


def quotient_error(truth, frac):
    return abs(truth) * Fraction(2**-16.3) + Fraction(1.3) / (1 << frac)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("frac", [8, 24, 36])
@pytest.mark.parametrize("largest", [1.0, 1000.0, 2.0**20])
def test_division(largest, frac, security):
    """Divisors from one unit to 2^22, of either sign, quotients of every size up to the largest."""
    generator = random.Random(f"{largest} {frac} {security}")
    bound = 1 << 38
    y = [1, -1, bound, -bound, *(int(2 ** generator.uniform(0, 38)) for _ in range(40))]
    y = [one * generator.choice([1, -1]) for one in y]
    limits = [min(bound, abs(one) * int(largest)) for one in y]
    x = [
        generator.choice([1, -1])
        * min(limit, int(limit * 2 ** -generator.uniform(0, 25)) + (i % 5 == 0) * limit)
        for i, limit in enumerate(limits)
    ]
    x, y = integers(*x, 0, 77), integers(*y, 5, 0)

    async def quotient(a, b):
        return await divide(a, b, largest=largest, frac=frac)

    value = run_gate(quotient, x, y, bound=bound, frac=16, security=security).value
    for a, b, q in zip(x, y, value, strict=True):
        truth = Fraction(a, b) if b else Fraction(0)
        assert abs(q - truth) <= quotient_error(truth, frac)
        assert b or not q
        assert (q * (1 << frac)).denominator == 1


@pytest.mark.parametrize("security", SECURITIES)
def test_division_by_what_is_never_negative(security):
    async def quotient(a, b):
        return await divide(a, b, largest=100.0, positive=True)

    x, y = integers(7, -7, 5, 0, 99), integers(2, 3, 0, 4, 1)
    for operands in ((x, y), (x[:, None], y[None, :]), (x, np.array(2, dtype=object))):
        value = run_gate(quotient, *operands, bound=99, security=security).value
        a, b = np.broadcast_arrays(*operands)
        assert value.shape == a.shape
        for one, other, q in zip(a.flat, b.flat, value.flat, strict=True):
            truth = Fraction(int(one), int(other)) if other else Fraction(0)
            assert abs(q - truth) <= quotient_error(truth, 24)
    value = run_gate(quotient, integers(5), integers(-2), bound=99, security=security).value
    assert value == 0


@pytest.mark.parametrize("security", [*SECURITIES, None])
def test_a_quotient_is_masked_and_can_be_used_at_once(security):
    async def compared(a, b):
        quotient = await divide(a, b, largest=10.0)
        assert quotient.masked
        return await absolute(quotient)

    value = run_gate(compared, integers(-9, 9), integers(3, -4), bound=9, security=security).value
    for q, truth in zip(value, (Fraction(3), Fraction(9, 4)), strict=True):
        assert abs(q - truth) <= quotient_error(truth, 24)


@settings(max_examples=60, deadline=None)
@given(x=st.integers(-(2**20), 2**20), y=st.integers(-(2**20), 2**20))
def test_division_in_the_clear(x, y):
    async def quotient(a, b):
        return await divide(a, b, largest=2.0**20)

    truth = Fraction(x, y) if y else Fraction(0)
    value = run_gate(quotient, integers(x), integers(y), bound=2**20, frac=3).value
    assert abs(value[0] - truth) <= abs(truth) * Fraction(1, 1 << 22) + Fraction(1, 1 << 22)


# -- normalisation --------------------------------------------------------------------------------------


def root(square):
    return Fraction(isqrt(square << 200), 1 << 100)


NORMS = {
    l1_normalised: (lambda row: Fraction(int(abs(row).sum())), 2**-16.3),
    l2_normalised: (lambda row: root(int((row**2).sum())), 2**-17.3),
}


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("normalise", NORMS)
@pytest.mark.parametrize("n", [1, 2, 7, 64])
def test_normalised_vectors(n, normalise, security):
    """Rows of every length that the range allows, one unit among them, one-hot ones, and zero."""
    generator = np.random.default_rng(n)
    norm, error = NORMS[normalise]
    rows = [generator.standard_normal(n) * 2.0**k for k in (-8, 0, 7, 15)]
    one_hot = np.eye(n)[n // 2]
    rows += [one_hot * 2.0**-16, one_hot * 2.0**22, -one_hot, np.full(n, 2.0**-16), np.zeros(n)]
    rows.append(np.full(n, 2.0**22 / n**0.5))
    rows = np.array(rows)
    raw = np.array([[round(one * 65536) for one in row] for row in rows.tolist()], dtype=object)

    async def program(engine, x, y):
        (x,) = await normalise(x)
        assert x.frac == 24
        assert x.masked
        return x

    value = exactly(program, rows, [[0.0]], security).value
    for row, result in zip(raw, value, strict=True):
        length = norm(row)
        if not length:
            assert not result.any()
            continue
        truth = row / length
        for one, exact in zip(result, truth, strict=True):
            assert abs(one - exact) <= abs(exact) * Fraction(error) + Fraction(1, 1 << 24)
        scaled = norm(integers(*(int(one * (1 << 24)) for one in result))) / (1 << 24)
        slack = n if normalise is l1_normalised else root(n)
        assert abs(scaled - 1) <= Fraction(error) + Fraction(slack) / (1 << 24)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("normalise", NORMS)
def test_the_public_bound_holds_normalised_vectors(normalise, security):
    seen = []

    async def program(engine, x, y):
        x, y = await normalise(x, y)
        seen.append((x.bound, y.bound))
        return (x[:, None] - y).reshape(-1, 3)

    x = np.array([[1.0, 0, 0], [2.0**22, 0, 0], [0, -(2.0**-16), 0]])
    y = np.array([3.0, -4.0, 12.0])
    exactly(program, x, y, security)
    for bounds in seen:
        for bound in bounds:
            assert 1 << 24 <= bound.entry <= bound.norm <= 1.01 * 2**24


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("normalise", NORMS)
def test_vectors_of_whole_numbers_are_normalised(normalise, security):
    """Signs and bits have no fractional bits."""
    norm, _ = NORMS[normalise]

    async def program(engine, x, y):
        (signs,) = await mask(await sign(x))
        return (await normalise(signs))[0]

    value = exactly(program, [3.0, 0.0, -0.5], [0.0], security).value
    length = float(norm(integers(1, 0, -1)))
    assert np.abs(np.array(value, dtype=np.float64) - np.array([1, 0, -1]) / length).max() < 2**-15.9


@pytest.mark.parametrize("security", [*SECURITIES, None])
def test_the_cosine_of_whole_numbers_and_a_count_as_a_score(security):
    async def program(engine, x, y):
        signs, others = await mask(await sign(x), await sign(y))
        return await rounded(await cosine(signs, others) + await rounded(signs.sum()))

    value = exactly(program, [3.0, 0.0, -0.5, 1.0], [1.0, 1.0, -2.0, -1.0], security).value
    assert abs(float(value) - (1 + 1 / 12**0.5)) < 2**-15.9


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("units", [0.5, 0.99, 1, 9.9, 100.99, 2.0**20 - 0.001])
def test_the_public_bound_holds_a_quotient_and_its_rounding(units, security):
    """Of ``largest`` itself, whose last bits the cuts of mantissa and quotient move."""
    seen = []

    async def quotient(a, b):
        result = await divide(a, b, largest=units * 2.0**-24)
        seen.append(result.bound)
        return result

    x, y = integers(*[int(units * 2**16)] * 50), integers(*[1 << 40] * 50)
    run_gate(quotient, x, y, bound=1 << 40, security=security)
    largest_cut = units * (1 + 2**-16) + 2.25 / 8
    assert {bound.entry > largest_cut for bound in seen} == {True}


@pytest.mark.parametrize("security", SECURITIES)
def test_vectors_of_different_shapes_are_normalised_together(security):
    async def program(engine, x, y):
        a, b = await l2_normalised(x, y)
        assert (a.shape, b.shape) == ((2, 1, 2), (1, 3, 2))
        return dot(a, b)

    x = np.array([[[3.0, 4.0]], [[-1.0, 0.0]]])
    y = np.array([[[0.0, 7.0], [1.0, 1.0], [0.0, 0.0]]])
    value = np.asarray(exactly(program, x, y, security).value, dtype=np.float64)
    expected = [[0.8, 7 / 50**0.5, 0], [0, -(0.5**0.5), 0]]
    assert np.abs(value - expected).max() < 2**-16.2


def test_vectors_of_different_length_are_not_normalised_together():
    for normalise in NORMS:

        async def program(engine, x, y, normalise=normalise):
            x, y = await normalise(x, y)
            return x

        with pytest.raises(ValueError, match="equal length"):
            run_local(program, [1.0, 2.0], [1.0, 2.0, 3.0])


def test_every_segment_is_met_by_the_samples():
    """The helper: of each octave at least one end."""
    u = sample(1 << 78)
    assert all(any(low <= one < high for one in u) for low, high in pairwise(1 << k for k in range(79)))
