"""Products of several values and polynomials: exact, in every shape, at the bounds that are claimed."""

import secrets
from math import comb, prod

import numpy as np
import pytest
from gate_helpers import SECURITIES, exactly, integers, run_gate
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import dot, mask, measure, multiply, nonnegative, run_local, truncate
from spdz.arithmetic.bound import Bound
from spdz.gates.polynomial import polynomial

SHAPES = [
    [(), ()],
    [(), (4,)],
    [(4,), ()],
    [(1,), (4,)],
    [(3, 1), (1, 4)],
    [(2, 3), (3,)],
    [(2, 1, 3), (4, 1)],
    [(1, 1), ()],
    [(), (), ()],
    [(5,), (), (1,)],
    [(3, 1), (), (1, 2)],
    [(2, 1, 1), (3, 1), (4,)],
    [(2, 3), (2, 3), (2, 3)],
    [(), (2,), (), (2,)],
    [(1, 2), (3, 1), (), (2, 1, 1)],
    [(2, 2), (2, 2), (2, 2), (2, 2)],
]
"""Of two, three and four factors, which broadcast."""


def random_integers(bound, shape):
    numbers = [secrets.randbelow(2 * bound + 1) - bound for _ in range(prod(shape))]
    return integers(*numbers).reshape(shape)


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("shapes", SHAPES, ids=str)
def test_products_of_two_to_four_factors_are_exact(shapes, security):
    """Random numbers, and all numbers at their bound: the product fills the field to its edge."""
    bound = 1 << 125 // len(shapes)
    for operands in (
        [random_integers(bound, shape) for shape in shapes],
        [np.full(shape, bound, dtype=object) for shape in shapes],
        [np.full(shape, bound * (-1) ** i, dtype=object) for i, shape in enumerate(shapes)],
    ):
        value = run_gate(multiply, *operands, bound=bound, security=security).value
        expected = np.prod(np.broadcast_arrays(*operands), axis=0)
        assert np.shape(value) == np.broadcast_shapes(*shapes)
        assert np.array_equal(value, expected)


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=30, deadline=None)
@given(data=st.data(), shapes=st.sampled_from(SHAPES), frac=st.integers(0, 9))
def test_products_are_exact(security, data, shapes, frac):
    bits = 125 // len(shapes)
    bound = (1 << bits) - 1
    number = st.one_of(st.integers(-bound, bound), st.sampled_from([0, 1, -1, bound, -bound]))
    operands = [
        integers(*data.draw(st.lists(number, min_size=prod(shape), max_size=prod(shape)))).reshape(shape)
        for shape in shapes
    ]
    value = run_gate(multiply, *operands, bound=bound, frac=frac, security=security).value
    expected = np.prod(np.broadcast_arrays(*operands), axis=0)
    assert np.array_equal(np.asarray(value) * (1 << frac * len(shapes)), expected)


@pytest.mark.parametrize("security", [*SECURITIES, None])
def test_powers_of_one_value(security):
    z = random_integers(2**31, (2, 3))
    for function, power in (
        (lambda a: multiply(a, a), 2),
        (lambda a: multiply(a, a, a), 3),
        (lambda a: multiply(a, a, a, a), 4),
    ):
        assert np.array_equal(run_gate(function, z, bound=2**31, security=security).value, z**power)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_value_and_what_is_made_of_it_are_multiplied(security):
    """Masks that depend on one another: slices, sums, multiples, truncated values, computed ones."""
    z = random_integers(2**30, (4,))

    async def several(a, b):
        (cut,) = await truncate(a, frac=0)
        (computed,) = await mask(multiply(a, b) * 1)
        computed.bound = Bound.of_entry(2**61, computed.shape)
        same = multiply(cut, cut) - multiply(cut, cut[:]) + multiply(computed, a, b[:1]) * 0
        return same + multiply(a[1:2], a, a.sum()) + multiply(a * 3 - b, b, a[0])

    b = random_integers(2**30, (4,))
    expected = z[1] * z * z.sum() + (3 * z - b) * b * z[0]
    value = run_gate(several, z * 1, b, bound=2**30, security=security)
    assert np.array_equal(value.value, expected)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_product_costs_no_round_and_is_masked_again_for_one(security):
    async def once(engine, x, y):
        return multiply(x, y, x)

    async def twice(engine, x, y):
        (z,) = await mask(multiply(x, y))
        return multiply(z, x)

    x, y = [1.0, -2.0], [0.5, 3.0]
    check = security == "malicious"
    for program, rounds in ((once, 2 + check), (twice, 3 + 2 * check)):
        outcome = run_local(program, x, y, security)
        assert outcome.stats[0].rounds == rounds
        assert np.array_equal(outcome.value, [0.5, 12.0])


@pytest.mark.parametrize("security", SECURITIES)
def test_a_scalar_times_a_vector_costs_an_element_a_coordinate(security):
    """And each further scalar one more: corrections have the shape of their own factors."""

    def stored(n, scalars):
        async def program(engine, x, y):
            return multiply(x, *(y[i] for i in range(scalars)))

        program.max_norm = 1.0
        return sum(measure(program, ((n,), (4,)), security).correction_bytes)

    copies = 2 if security == "malicious" else 1
    # The input x itself has one MAC correction an entry, and y four.
    inputs = copies - 1
    for scalars, subsets_with_x in ((1, 1), (2, 3), (3, 7)):
        assert stored(1000, scalars) - stored(999, scalars) == 16 * (subsets_with_x * copies + inputs)
        constant = sum(comb(scalars, k) for k in range(2, scalars + 1)) * copies + 4 * inputs
        assert stored(1000, scalars) == 16 * (1000 * (subsets_with_x * copies + inputs) + constant)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_known_bound_replaces_the_tracked_one_where_it_is_smaller(security):
    seen = []

    def program(**limits):
        def product(a, b):
            z = multiply(a, b, **limits)
            seen.append(z.bound)
            return z

        return product

    operands = integers(3, -4), integers(5, 6)
    for limits, entry, norm in (
        ({}, 100, 200),
        ({"entry": 30.0}, 30, 200),
        ({"entry": 24.5}, 25, 200),
        ({"entry": 1e9}, 100, 200),
        ({"norm": 40.0}, 40, 40),
        ({"norm": 150.0}, 100, 150),
        ({"entry": 20.0, "norm": 40.0}, 20, 40),
    ):
        seen.clear()
        value = run_gate(program(**limits), *operands, bound=10, security=security).value
        assert list(value) == [15, -24]
        assert {(bound.entry, bound.norm) for bound in seen} == {(entry, norm)}


def test_a_known_bound_is_in_units_of_the_number_and_not_of_its_raw_integer():
    seen = []

    def product(a, b):
        z = multiply(a, b, entry=0.5)
        seen.append(z.bound.entry)
        return z

    run_gate(product, 1 << 10, 1 << 9, bound=1 << 40, frac=10, security="semi-honest")
    assert set(seen) == {1 << 19}


@pytest.mark.parametrize("security", SECURITIES)
def test_a_known_bound_makes_the_next_comparison_smaller(security):
    def stored(entry):
        async def program(engine, x, y):
            return await nonnegative(multiply(x, y, entry=entry))

        return measure(program, ((4,), (4,)), security).correction_bytes[0]

    assert stored(1.0) < 0.6 * stored(None)


def test_a_product_that_leaves_the_field_is_refused():
    for factors in (2, 3, 4):
        bound = 1 << -(-127 // factors)
        with pytest.raises(ValueError, match="do not fit the field"):
            run_gate(multiply, *[integers(1)] * factors, bound=bound, security="malicious")


def test_what_cannot_be_multiplied_is_told():
    with pytest.raises(ValueError, match="two factors"):
        run_gate(multiply, 1, bound=1, security="malicious")
    with pytest.raises(TypeError, match="mask"):
        run_gate(multiply, 1, 1, bound=1, security="malicious", shared=True)
    with pytest.raises(ValueError, match="broadcast"):
        run_gate(multiply, integers(1, 2), integers(1, 2, 3), bound=3, security="malicious")


def test_programs_that_multiply_otherwise_have_other_recipes():
    functions = [
        lambda x, y: multiply(x, y),
        lambda x, y: multiply(y, x),
        lambda x, y: multiply(x, x),
        lambda x, y: multiply(x, x, y),
        lambda x, y: multiply(x, y, y),
        lambda x, y: multiply(x[:1], y),
        lambda x, y: multiply(x, y[0]),
    ]

    def program(function):
        async def run(engine, x, y):
            return function(x, y)

        return run

    recipes = [measure(program(one), ((3,), (3,)), "malicious").recipe for one in functions]
    assert len(set(recipes)) == len(recipes)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("n", [1, 2, 33])
def test_the_same_inputs_in_dot_products_and_in_products(n, security):
    async def program(engine, x, y):
        return dot(x, y) + multiply(x, y).sum() * 2 + multiply(x, x).sum() * 4

    x, y = np.linspace(-2, 1, n).round(2), np.linspace(3, 5, n).round(2)
    expected = exactly(program, x, y).value
    a, b = (integers(*(round(one * 65536) for one in side)) for side in (x, y))
    assert expected * (1 << 32) == 3 * (a * b).sum() + 4 * (a * a).sum()
    assert exactly(program, x, y, security).value == expected


@pytest.mark.parametrize("security", [*SECURITIES, None])
@settings(max_examples=30, deadline=None)
@given(
    data=st.data(),
    coefficients=st.lists(st.integers(-(2**30), 2**30), min_size=2, max_size=6),
    shape=st.sampled_from([(), (1,), (3,), (2, 2)]),
)
def test_polynomials_are_exact(security, data, coefficients, shape):
    """Degrees 1 to 5; zero coefficients and a zero factor among them."""
    bits = 85 // len(coefficients)
    bound = (1 << bits) - 1
    number = st.one_of(st.integers(-bound, bound), st.sampled_from([0, 1, -1, bound, -bound]))
    w, y = (
        integers(*data.draw(st.lists(number, min_size=prod(shape), max_size=prod(shape)))).reshape(shape)
        for _ in range(2)
    )

    async def apply(factor, argument):
        factor, argument = await mask(factor, argument)
        return polynomial(factor, argument, tuple(coefficients), 7, 1 << 125)

    value = run_gate(apply, w, y, bound=bound, security=security, shared=True).value
    expected = w * sum(a * y**k for k, a in enumerate(coefficients))
    assert np.array_equal(np.asarray(value) * 128, expected)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_polynomial_of_a_value_times_that_value(security):
    async def apply(a, b):
        a, b = await mask(a, b)
        return polynomial(a, a, (3, -1, 2), 0, 1 << 90) - polynomial(a - b, b, (0, 1), 0, 1 << 90)

    a, b = random_integers(2**20, (4,)), random_integers(2**20, (4,))
    value = run_gate(apply, a, b, bound=2**20, security=security, shared=True).value
    assert np.array_equal(value, a * (3 - a + 2 * a**2) - (a - b) * b)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 8, 16, 17, 33, 64, 65, 300])
def test_polynomials_of_any_number_of_entries(size, security):
    """A few are computed one by one, more of them as arrays."""

    async def apply(w, y):
        w, y = await mask(w, y)
        return polynomial(w, y, (5, -3, 0, 2), 0, 1 << 100)

    w, y = random_integers(2**20, (size,)), random_integers(2**20, (size,))
    value = run_gate(apply, w, y, bound=2**20, security=security, shared=True).value
    assert np.array_equal(value, w * (5 - 3 * y + 2 * y**3))


@pytest.mark.parametrize("security", SECURITIES)
def test_a_polynomial_of_an_input(security):
    def apply(a, b):
        return polynomial(a, b, (3, -1, 2), 0, 1 << 90)

    assert run_gate(apply, 5, -7, bound=9, security=security).value == 5 * (3 + 7 + 2 * 49)


def test_a_polynomial_needs_masked_values_of_one_shape():
    def apply(a, b):
        return polynomial(a, b, (1, 1), 0, 100)

    for operands, shared in (((integers(1), integers(1)), True), ((integers(1), integers(1, 2)), False)):
        with pytest.raises(TypeError, match="masked"):
            run_gate(apply, *operands, bound=2, security="malicious", shared=shared)


def test_other_coefficients_are_another_program():
    """What is stored depends on the degree alone, but the text tells them apart."""

    def program(coefficients):
        async def run(engine, x, y):
            return polynomial(x, y, coefficients, 0, 1 << 100)

        return run

    plans = [measure(program(a), ((2,), (2,)), "malicious") for a in ((1, 2), (1, 3), (1, 2, 3))]
    assert len({plan.text for plan in plans}) == 3
    assert plans[2].correction_bytes > plans[0].correction_bytes == plans[1].correction_bytes
