"""Comparisons and piecewise linear functions are exact, everywhere in the range and at its edges."""

import secrets
from bisect import bisect_right
from functools import partial
from itertools import accumulate

import numpy as np
import pytest
from gate_helpers import SECURITIES, WIDEST, edges, exactly, integers, run_gate
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import (
    absolute,
    dot,
    largest,
    mask,
    maximum,
    measure,
    multiply,
    nonnegative,
    run_clear,
    run_local,
    sign,
)
from spdz.gates.pieces import Function, Pieces
from spdz.gates.piecewise import piecewise

ONE = [
    (nonnegative, lambda z: z >= 0),
    (sign, lambda z: (z > 0) * 1 - (z < 0) * 1),
    (absolute, abs),
]
BOUNDS = [1, 2, 3, 4, 255, 256, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64, WIDEST - 1]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(("gate", "meaning"), ONE)
@pytest.mark.parametrize("bound", BOUNDS, ids=hex)
def test_comparisons_are_exact_at_the_edges(bound, gate, meaning, security):
    for shared in (False, True):
        z = edges(bound)
        value = run_gate(gate, z, bound=bound, security=security, shared=shared).value
        assert np.array_equal(value, meaning(z))
        assert np.array_equal(run_gate(gate, z, bound=bound).value, value)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(("gate", "meaning"), ONE)
@settings(max_examples=25, deadline=None)
@given(data=st.data(), bits=st.integers(1, 84), shared=st.booleans())
def test_comparisons_are_exact(gate, meaning, security, data, bits, shared):
    bound = (1 << bits) - 1
    numbers = st.one_of(st.integers(-bound, bound), st.integers(-1, 1))
    z = integers(*data.draw(st.lists(numbers, min_size=1, max_size=6)))
    assert np.array_equal(run_gate(gate, z, bound=bound, security=security, shared=shared).value, meaning(z))


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("bound", [1, 2, 255, 2**38, 2**63, WIDEST >> 1], ids=hex)
def test_the_larger_of_two_is_exact_at_the_edges(bound, security):
    column, row = edges(bound)[:, None], edges(bound)[None, ::3]
    for shared in (False, True):
        value = run_gate(maximum, column, row, bound=bound, security=security, shared=shared).value
        assert np.array_equal(value, np.maximum(column, row))
    assert np.array_equal(run_gate(maximum, column, row, bound=bound).value, np.maximum(column, row))


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 3), (2, 1, 2)], ids=str)
def test_shapes_are_kept(shape, security):
    z = integers(*(secrets.randbelow(2**40) - 2**39 for _ in range(int(np.prod(shape))))).reshape(shape)
    for gate, meaning in ONE:
        value = run_gate(gate, z, bound=2**39, security=security).value
        assert np.shape(value) == shape
        assert np.array_equal(value, meaning(z))


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(
    ("first", "second"),
    [((), (4,)), ((4,), ()), ((3, 1), (1, 4)), ((2, 1, 3), (4, 1)), ((1,), (5,)), ((2, 2), (2, 2))],
    ids=str,
)
def test_maximum_broadcasts(first, second, security):
    x, y = (
        integers(*(secrets.randbelow(2**20) - 2**19 for _ in range(int(np.prod(shape))))).reshape(shape)
        for shape in (first, second)
    )
    for shared in (False, True):
        value = run_gate(maximum, x, y, bound=2**19, security=security, shared=shared).value
        assert np.array_equal(value, np.maximum(x, y))


PUBLIC = {
    "zero": 0,
    "a whole number": -1,
    "a real one": 0.25,
    "more digits than are kept": 1 / 3,
    "beyond all inputs": 100.0,
    "below all inputs": -100,
    "one an entry": [0.5, -2.0, 7.0, 0.0],
    "rows": np.array([[0], [1], [-3]], dtype=np.int8),
}


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("name", PUBLIC)
def test_the_larger_of_a_value_and_public_numbers(name, security):
    """On an input, on a product, and on whole numbers, where a real one brings its fractional bits along."""
    number = PUBLIC[name]
    coarse, fine = (np.rint(np.asarray(number, np.float64) * 2**bits) / 2**bits for bits in (16, 32))

    async def of_input(engine, x, y):
        return await maximum(x, number)

    async def of_product(engine, x, y):
        return await maximum(number, multiply(x, y))

    async def of_signs(engine, x, y):
        return await maximum(await sign(x), number)

    async def smaller(engine, x, y):
        return -await maximum(-x, -np.asarray(number))

    x, y = np.array([1.5, -2.0, 0.25, -0.125]), np.array([3.0, 2.0, -1.0, 1.0])
    for program, meaning in (
        (of_input, np.maximum(x, coarse)),
        (of_product, np.maximum(x * y, fine)),
        (of_signs, np.maximum(np.sign(x), coarse)),
        (smaller, np.minimum(x, coarse)),
    ):
        program.max_norm = 8.0
        run = run_clear(program, x, y) if security is None else run_local(program, x, y, security)
        assert np.array_equal(run.value, meaning)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_public_operand_of_the_maximum_costs_what_a_secret_one_does(security):
    assert rounds(lambda x, y: maximum(x, 0.5), security) == rounds(maximum, security)
    assert rounds(lambda x, y: maximum(0, dot(x, y)), security) == rounds(
        lambda x, y: maximum(dot(x, y), x[0]), security
    )


@pytest.mark.parametrize("number", [float("nan"), np.inf, 1j, "1", np.array([1, 2])])
def test_a_public_operand_of_the_maximum_is_real_finite_and_broadcasts(number):
    async def program(engine, x, y):
        return await maximum(x, number)

    with pytest.raises(ValueError, match=r"real and finite|broadcast"):
        measure(program, ((3,), (3,)), "malicious")


def test_the_maximum_of_values_on_different_scales():
    async def program(engine, x, y):
        return await maximum(x, dot(x, y))

    for x, y in (([0.5, -2.0], [3.0, 1.0]), ([1.0, -1.0], [3.0, -1.0])):
        expected = np.maximum(x, np.dot(x, y))
        assert np.array_equal(run_local(program, x, y).value, expected)
        assert np.array_equal(run_clear(program, x, y).value, expected)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 9, 16])
def test_the_largest_of_n_wherever_it_stands(n, security):
    """One row for each place of the largest, one with all of them equal, and one with a tie."""
    rows = [[-7] * n, [5] * (n - 1) + [6] if n < 2 else [6, *[-1] * (n - 2), 6]]
    for place in range(n):
        row = [secrets.randbelow(1000) - 2000 for _ in range(n)]
        row[place] = -secrets.randbelow(3)
        rows.append(row)
    z = integers(*rows)
    for shared in (False, True):
        value = run_gate(largest, z, bound=2**60, security=security, shared=shared).value
        assert np.array_equal(value, z.max(axis=-1))


@pytest.mark.parametrize("security", SECURITIES)
def test_the_largest_of_single_vectors_at_the_ends_of_the_range(security):
    bound = 2**70
    for z in ([bound, -bound, bound - 1], [-bound, -bound, -bound], [-bound + 1, -bound], [-bound]):
        assert run_gate(largest, integers(*z), bound=bound, security=security).value == max(z)


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("gate", [nonnegative, sign, absolute, largest])
def test_a_public_zero_is_compared_as_any_other_number(gate, security):
    async def program(engine, x, y):
        return await gate(x * 0)

    run = exactly(program, [1.0, -2.0], [0.0], security).value
    assert np.all(run == (gate is nonnegative))


@pytest.mark.parametrize("security", [*SECURITIES, None])
def test_the_largest_of_nothing_is_refused_when_it_is_metered(security):
    for function in (lambda x: largest(x[0]), lambda x: largest(x[:0])):

        async def program(engine, x, y, function=function):
            return await function(x)

        with pytest.raises(ValueError, match="a last axis of one entry or more"):
            run_clear(program, [1.0], [1.0]) if security is None else measure(program, ((1,), (1,)), security)


def rounds(function, security, x=(1.0, -2.0, 0.5), y=(3.0, -4.0, 0.25)):
    async def program(engine, x, y):
        return await function(x, y)

    return run_local(program, x, y, security).stats[0].rounds


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("gate", [nonnegative, sign, absolute])
def test_no_round_on_inputs_and_one_on_computed_values(gate, security):
    check = security == "malicious"
    assert rounds(lambda x, y: gate(x), security) == 2 + check
    assert rounds(lambda x, y: gate(x * 3 - y + 1), security) == 2 + check
    assert rounds(lambda x, y: gate(dot(x, y)), security) == 3 + 2 * check


@pytest.mark.parametrize("security", SECURITIES)
def test_rounds_of_the_maximum_and_of_a_tournament(security):
    check = security == "malicious"
    assert rounds(maximum, security) == 2 + check
    assert rounds(lambda x, y: maximum(x, dot(x, y)), security) == 3 + 2 * check
    for n, levels in ((1, 0), (2, 1), (3, 2), (4, 2), (5, 3), (8, 3), (9, 4)):
        x = np.linspace(-1, 1, n)
        after_the_first = max(levels - 1, 0)
        assert rounds(lambda x, y: largest(x), security, x, x) == (
            2 + after_the_first + check * (1 + (after_the_first > 0))
        )


@pytest.mark.parametrize("security", SECURITIES)
@settings(max_examples=40, deadline=None)
@given(
    data=st.data(), bits=st.integers(2, 40), k=st.integers(1, 9), shape=st.sampled_from([(), (5,), (2, 2)])
)
def test_random_piecewise_functions(security, data, bits, k, shape):
    """Against the definition and the clear reading; constants, slopes, both, or neither may jump."""
    bound = (1 << bits) - 1
    thresholds = sorted(data.draw(st.sets(st.integers(-2 * bound, 2 * bound), min_size=1, max_size=k)))
    column = st.one_of(
        st.lists(st.integers(-(2**40), 2**40), min_size=len(thresholds) + 1, max_size=len(thresholds) + 1),
        st.integers(-9, 9).map(lambda first: [first, *[0] * len(thresholds)]),
    )
    tables = data.draw(st.lists(st.tuples(column, column), max_size=2))
    tables.append(([5] * (len(thresholds) + 1), [0] * len(thresholds) + [3]))
    near = st.sampled_from([t + step for t in thresholds for step in (-1, 0, 1)])
    numbers = st.one_of(st.integers(-bound, bound), near.filter(lambda z: abs(z) <= bound))
    size = int(np.prod(shape))
    z = integers(*data.draw(st.lists(numbers, min_size=size, max_size=size))).reshape(shape)
    functions = [Function(tuple(a), tuple(b), 0, 2**90) for a, b in tables]
    for i, (constants, slopes) in enumerate(tables):

        async def apply(value, i=i):
            (value,) = await mask(value)
            return piecewise(value, Pieces(thresholds, *functions))[i]

        constants, slopes = list(accumulate(constants)), list(accumulate(slopes))

        def meaning(one, constants=constants, slopes=slopes):
            piece = bisect_right(thresholds, one)
            return constants[piece] + slopes[piece] * one

        expected = np.vectorize(meaning, otypes=[object])(z)
        for shared in (False, True):
            value = run_gate(apply, z, bound=bound, security=security, shared=shared).value
            assert np.array_equal(value, expected)
        assert np.array_equal(run_gate(apply, z, bound=bound).value, expected)


@pytest.mark.parametrize("security", SECURITIES)
def test_many_thresholds_in_the_widest_domain(security):
    """Every point on both sides of every threshold."""
    thresholds = [t for t in edges(WIDEST >> 1, unit=1 << 70) if t % 2]
    pieces = Pieces(
        thresholds, Function((0, *[1] * len(thresholds)), (0,) * (len(thresholds) + 1), 0, len(thresholds))
    )
    z = integers(*(t + step for t in thresholds for step in (-1, 0, 1)))
    value = run_gate(lambda z: piecewise(z, pieces)[0], z, bound=WIDEST >> 1, security=security).value
    assert list(value) == [bisect_right(thresholds, one) for one in z]


@pytest.mark.parametrize(
    ("thresholds", "columns"),
    [([1, 1], 3), ([2, 1], 3), ([1], 3), ([1, 2], 2)],
)
def test_pieces_that_make_no_sense_are_refused(thresholds, columns):
    with pytest.raises(ValueError, match="ascend"):
        Pieces(thresholds, Function((0,) * columns, (0,) * columns, 0, 1))


@pytest.mark.parametrize("security", SECURITIES)
def test_a_smaller_norm_makes_smaller_keys(security):
    """Input bounds of 2^6 to 2^38 raw units: the domain of the comparison follows them."""

    def stored(max_norm, gate):
        async def program(engine, x, y):
            return await gate(x - y)

        program.max_norm = max_norm
        return measure(program, ((4,), (4,)), security).correction_bytes[0]

    for gate in (nonnegative, absolute):
        sizes = [stored(2.0**power, gate) for power in (-10, -5, 0, 6, 14, 22)]
        assert sizes == sorted(set(sizes))
        assert sizes[-1] > 2.5 * sizes[0]


@pytest.mark.parametrize("security", SECURITIES)
def test_a_tighter_bound_that_the_caller_knows_makes_smaller_keys(security):
    def program(bound):
        async def run(engine, x, y):
            return await nonnegative(dot(x, y), bound)

        return run

    shapes = ((8,), (8,))
    tight, loose = (
        measure(program(bound), shapes, security).correction_bytes[0] for bound in (1 << 33, None)
    )
    assert tight < 0.6 * loose
    x, y = np.eye(8)[0] / 2, np.linspace(-1, 1, 8)
    assert run_local(program(1 << 33), x, y, security).value is False
    assert run_local(program(1 << 33), -x, y, security).value is True


@pytest.mark.parametrize("security", SECURITIES)
def test_only_a_comparison_is_a_bit(security):
    for gate, _ in ONE:
        value = run_gate(gate, integers(1, -1), bound=1, security=security).value
        assert (value.dtype == np.bool_) is (gate is nonnegative)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(("gate", "meaning"), ONE)
def test_where_masks_cancel_a_comparison_is_refused_or_masked_anew(gate, meaning, security):
    """The integers behind such a mask may wrap, whatever its length."""
    data = [1.0, -2.0, 3.5], [0.0]

    async def program(engine, x, y, fresh=False):
        z = x - x[..., :1]
        if fresh:
            (z,) = await mask(z, fresh=True)
        return await gate(z)

    with pytest.raises(ValueError, match="masks cancel"):
        exactly(program, *data, security)
    value = exactly(partial(program, fresh=True), *data, security).value
    assert np.array_equal(value, meaning(integers(0, -3, 2.5)))
