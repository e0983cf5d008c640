"""Every rule of the bounds at its edge: arrays that reach entry or norm, and none that exceeds it."""

from math import isqrt

import numpy as np
import pytest
from gate_helpers import SECURITIES
from watching import Watch

from protocols.cosine import cosine
from spdz import (
    absolute,
    divide,
    dot,
    l1_normalised,
    l2_normalised,
    largest,
    mask,
    maximum,
    multiply,
    nonnegative,
    reciprocal,
    reciprocal_sqrt,
    run_clear,
    run_local,
    sqrt,
    truncate,
)
from spdz.arithmetic.bound import Bound, root
from spdz.gates.masking import signed_bits, tightened
from spdz.gates.truncation import Truncate, TruncateExactly
from spdz.readings.clear import Clear
from spdz.values.value import aligned, concatenate


def longest(rows):
    """The largest squared norm along the last axis."""
    return int(np.max((np.atleast_1d(rows).astype(object) ** 2).sum(axis=-1)))


def holds(bound, rows):
    return np.abs(rows).max() <= bound.entry and longest(rows) <= bound.norm**2


def full(shape, number):
    return np.full(shape, number, dtype=object)


def test_root_is_the_square_root_rounded_up():
    assert root(0) == 1
    for n in [*range(1, 300), 10**12, 10**12 + 1]:
        assert (root(n) - 1) ** 2 < n <= root(n) ** 2


ENTRY, N = 1000, 9
ALIKE = full((2, N), ENTRY)
ONE = full((2, N), 0)
ONE[:, 3] = -ENTRY
RULES = {
    "entries alike": (Bound.of_entry(ENTRY, (2, N)), ALIKE),
    "one entry": (Bound.of_norm(ENTRY), ONE),
    "sum": (Bound.of_norm(ENTRY) + Bound.of_norm(500), ONE + ONE // 2),
    "sum of alike ones": (Bound.of_entry(ENTRY, (2, N)) + Bound.of_entry(1, (2, N)), ALIKE + 1),
    "scaled": (Bound.of_entry(ENTRY, (2, N)).scaled(7), ALIKE * -7),
    "broadcast along the last axis": (Bound.of_norm(ENTRY).broadcast((2, 1), (2, N)), ALIKE),
    "a number broadcast to a vector": (Bound.of_norm(ENTRY).broadcast((), (N,)), ALIKE[0]),
    "broadcast along another axis": (Bound.of_norm(ENTRY).broadcast((N,), (2, N)), ONE),
    "sum over an outer axis": (Bound.of_norm(ENTRY).summed((2, N), 0), ONE.sum(0)),
    "sum of alike rows over an outer axis": (Bound.of_entry(ENTRY, (2, N)).summed((2, N), 0), ALIKE.sum(0)),
    "sum over the last axis": (Bound.of_entry(ENTRY, (2, N)).summed((2, N), 1), ALIKE.sum(1)),
    "sum of a row of known norm": (Bound(ENTRY, 3 * ENTRY).summed((2, N), 1), ALIKE.sum(1)),
    "sum over the middle axis": (
        Bound.of_entry(ENTRY, (2, 5, N)).summed((2, 5, N), 1),
        full((2, N), 5 * ENTRY),
    ),
    "dot product": (
        Bound.of_entry(ENTRY, (2, N)).dot(Bound.of_entry(3, (2, N)), (2,)),
        full(2, N * ENTRY * 3),
    ),
    "all dot products": (Bound.of_norm(ENTRY).dot(Bound.of_norm(ENTRY), (2, 4)), full((2, 4), ENTRY**2)),
    "product": (Bound.of_norm(ENTRY).product(Bound.of_norm(3), (2, N)), full((2, N), -3 * ENTRY)),
    "larger": (Bound.of_norm(1).larger(Bound.of_entry(ENTRY, (2, N)), (2, N)), ALIKE),
    "larger of the other": (Bound.of_entry(ENTRY, (2, N)).larger(Bound.of_norm(1), (2, N)), ALIKE),
    "larger of two that are apart": (
        Bound.of_norm(ENTRY).larger(Bound.of_norm(ENTRY), (2, 2)),
        full((2, 2), ENTRY),
    ),
    "tightened entry": (tightened(Bound(2000, 9000), ENTRY, None), ALIKE),
    "tightened norm": (tightened(Bound(2000, 9000), None, ENTRY), ONE),
}
"""A bound, and an array that it has to hold."""


@pytest.mark.parametrize("rule", RULES)
def test_a_bound_holds_what_is_at_its_edge(rule):
    bound, rows = RULES[rule]
    assert holds(bound, rows)
    assert bound.entry <= bound.norm


@pytest.mark.parametrize("rule", RULES)
def test_the_entry_is_no_larger_than_it_must_be(rule):
    bound, rows = RULES[rule]
    assert bound.entry == np.abs(rows).max()


def test_a_sum_over_nothing_is_nothing():
    assert Bound.of_norm(7).summed((2, 0), 1) == Bound(0, 0)
    assert Bound.of_norm(7).summed((0, 2), 0) == Bound(0, 0)


def test_a_number_of_so_many_bits_and_its_negative_fit():
    for bound in [*range(1, 70), 2**64 - 1, 2**64]:
        assert -(1 << (signed_bits(bound) - 1)) < -bound <= bound < 1 << (signed_bits(bound) - 1)
        assert bound >= 1 << (signed_bits(bound) - 2)
    assert signed_bits(0) == 2


# -- where values are put together ----------------------------------------------------------------------


def value(rows, bound, frac=16):
    return Clear(0).value(np.array(rows, dtype=object), frac, bound)


def on_one_engine(*rows_bounds_fracs):
    engine = Clear(0)
    return [
        engine.value(np.array(rows, dtype=object), frac, bound) for rows, bound, frac in rows_bounds_fracs
    ]


def test_values_are_aligned_in_scale_and_shape():
    x, y = on_one_engine((ONE[:, :1] + 5, Bound.of_norm(5), 8), (ONE, Bound.of_norm(ENTRY), 16))
    for a, b in (aligned(x, y), aligned(y, x)[::-1]):
        assert (a.shape, a.frac) == (b.shape, b.frac) == ((2, N), 16)
        assert a.bound == Bound.of_entry(5 << 8, (2, N))
        assert b.bound == y.bound
        assert holds(a.bound, a.parts[0])
    with pytest.raises(ValueError, match="different runs"):
        aligned(x, value(ONE, Bound.of_norm(ENTRY)))


@pytest.mark.parametrize("first", [True, False])
def test_end_to_end_the_larger_bound_counts(first):
    pairs = [([3, 4], Bound(4, 5), 16), ([1, 0], Bound(1, 1), 16)]
    joined = concatenate(*on_one_engine(*pairs[:: 1 if first else -1]))
    assert joined.bound == Bound(4, 6)
    rows = [([[3, 4]], Bound(4, 5), 16), ([[1, 0]], Bound(1, 1), 16)]
    assert concatenate(*on_one_engine(*rows[:: 1 if first else -1])).bound == Bound(4, 5)


def test_end_to_end_bounds_are_on_one_scale():
    joined = concatenate(*on_one_engine(([[3, 4]], Bound(4, 5), 10), ([[1, 0]], Bound(1, 1), 16)))
    assert joined.frac == 16
    assert holds(joined.bound, joined.parts[0])
    assert joined.bound == Bound(4 << 6, 5 << 6)


REARRANGED = {
    "rows of another length": lambda z: z.reshape(9, 2),
    "one row": lambda z: z.reshape(-1),
    "a transposing index": lambda z: z[..., None],
    "a new axis in front": lambda z: z[None],
    "columns": lambda z: z[:, 3],
    "one row of many": lambda z: z[1],
    "an entry": lambda z: z[1, 3],
    "a part of each row": lambda z: z[:, 2:5],
}


@pytest.mark.parametrize("name", REARRANGED)
@pytest.mark.parametrize("rows", [ALIKE, ONE], ids=["alike", "one"])
def test_rearranged_values_keep_to_their_bound(name, rows):
    bound = Bound(ENTRY, isqrt(longest(rows)) + 1)
    moved = REARRANGED[name](value(rows, bound))
    assert holds(moved.bound, moved.parts[0])
    assert moved.bound.entry == ENTRY


def test_whole_rows_keep_their_norm():
    z = value(ONE, Bound.of_norm(ENTRY))
    for same in (z[1], z[None, 0][0], z.reshape(2, 1, N), z.reshape(1, 2, N)[0]):
        assert holds(same.bound, same.parts[0])
    assert z[1].bound == z.reshape(2, 1, N).bound == Bound.of_norm(ENTRY)


def test_added_numbers_count_in_each_entry():
    z = value(ONE, Bound.of_norm(ENTRY)).plus_raw(np.full(N, -(2**63)))
    assert holds(z.bound, z.parts[0])
    assert z.bound == Bound.of_norm(ENTRY) + Bound.of_entry(2**63, (2, N))


@pytest.mark.parametrize(
    "factor", [-3, np.array([-3, 1, 2] * 3), np.array([[2], [-3]]), -3.0, [[-3.0], [0.5]]]
)
def test_factors_count_with_their_magnitude(factor):
    z = value(ALIKE, Bound.of_entry(ENTRY, (2, N))) * factor
    assert holds(z.bound, z.parts[0])
    assert z.bound.entry == np.abs(z.parts[0]).max()


def test_a_column_times_a_row_of_factors_has_the_norm_of_a_whole_row():
    z = value(ALIKE[:, :1], Bound.of_norm(ENTRY)) * np.full(N, -2)
    assert z.bound == Bound.of_entry(2 * ENTRY, (2, N))
    assert holds(z.bound, z.parts[0])


def test_a_given_bound_is_believed_as_it_is():
    z = value(ALIKE, Bound.of_entry(ENTRY, (2, N)))
    assert z.bounded(Bound(7, 9)).bound == Bound(7, 9)
    assert z.bound == Bound.of_entry(ENTRY, (2, N))


LEAST = {
    "zero": (0, ALIKE, ENTRY),
    "beyond the value": (-5, ONE, 5 << 16),
    "fewer bits": (2.0**-16, ALIKE, ENTRY),
    "more than the value": (2000 / 65536, ALIKE, 2000),
    "one an entry": (np.full(N, 999 / 65536), ALIKE, ENTRY),
}


def largest_of(x, y):
    with pytest.raises(StopIteration) as done:
        maximum(x, y).send(None)
    return done.value.value


@pytest.mark.parametrize("name", LEAST)
def test_the_bound_of_a_maximum_with_public_numbers_is_the_larger_of_both(name):
    number, rows, entry = LEAST[name]
    z = value(rows, Bound.of_norm(ENTRY) if rows is ONE else Bound.of_entry(ENTRY, (2, N)))
    for result in (largest_of(z, number), largest_of(number, z), largest_of(z, -np.asarray(number))):
        assert holds(result.bound, result.parts[0])
        assert result.bound.entry == entry
        assert result.bound.norm <= 3 * entry


def test_a_maximum_with_zero_keeps_the_norm():
    assert largest_of(value(ONE, Bound.of_norm(ENTRY)), 0).bound == Bound.of_norm(ENTRY)


def test_a_maximum_of_a_column_and_public_rows_has_the_bound_of_whole_rows():
    z = value(ALIKE[:, :1], Bound.of_norm(ENTRY))
    assert largest_of(z, np.zeros(N, dtype=int)).bound == Bound.of_entry(ENTRY, (2, N))


def test_a_maximum_of_whole_and_real_numbers_is_bounded_on_the_finer_scale():
    result = largest_of(value([[3, 4]], Bound(4, 5), frac=0), 0.5)
    assert (result.frac, result.bound.entry) == (16, 4 << 16)
    assert holds(result.bound, result.parts[0])


def test_the_field_holds_what_is_output():
    largest_number = (1 << 126) - 1
    assert value([largest_number], Bound.of_norm(largest_number)).bound.entry == largest_number
    with pytest.raises(ValueError, match="do not fit the field"):
        value([0], Bound.of_norm(largest_number + 1))


# -- how long a mask is --------------------------------------------------------------------------------


async def shortest(x, y):
    """Of masks that are uniform on F_p, as the norm makes them (small integers: ``test_small_masks.py``)."""
    (cut,) = await truncate(x, frac=4)
    made = [cut + x, x - cut, cut * 3, cut[:1], cut.sum(), concatenate(cut, x), concatenate(x, cut), cut + 1]
    assert {z.mask_bits for z in (cut, *made)} == {x.mask_bits - 12}
    assert (cut * 0).mask_bits == (cut * np.array([1, 0])).mask_bits == 0
    return cut


@pytest.mark.parametrize("security", SECURITIES)
def test_what_is_put_together_has_the_shortest_of_the_masks(security):
    async def program(engine, x, y):
        return await shortest(x, y)

    program.max_norm = 2.0**22
    run_local(program, [1.0, -2.0], [1.0, 2.0], security)


# -- what went wrong where bounds were put together on different scales, or in different shapes ----------


async def masked_square(z):
    (z,) = await mask(z)
    return dot(z, z)


async def scale_of_the_second(x, y):
    return await nonnegative(await maximum(x, y * 0.001) - 5.0)


async def scale_of_the_first(x, y):
    return await nonnegative(await maximum(y * 0.001, x) - 5.0)


async def column_and_rows(x, y):
    return await nonnegative(await masked_square(await maximum(x[..., :1], y)) - 10.0)


async def root_of_column_and_rows(x, y):
    return await sqrt(await masked_square(await maximum(x[..., :1], y)))


async def all_pairs(x, y):
    return await nonnegative(30.0 - await masked_square(await maximum(x[:, None], y[None, :])))


async def largest_of_two_scales(x, y):
    return await nonnegative(await largest(concatenate(x, y * 0.001)) - 5.0)


async def magnitude_of_two_scales(x, y):
    return await nonnegative(await absolute(x - y * 0.001) - 5.0)


ON_TWO_SCALES = [scale_of_the_second, scale_of_the_first, largest_of_two_scales, magnitude_of_two_scales]
IN_TWO_SHAPES = [column_and_rows, root_of_column_and_rows, all_pairs]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("function", ON_TWO_SCALES)
def test_numbers_on_two_scales_are_compared_rightly(function, security):
    async def program(engine, x, y):
        return await function(x, y)

    program.max_norm = 1000.0
    for x in ([100.0, 7.0, 3.0], [-100.0, -7.0, -3.0]):
        secure, clear = (
            run_local(program, x, [1.0, 2.0, 3.0], security),
            run_clear(program, x, [1.0, 2.0, 3.0]),
        )
        assert np.array_equal(secure.value, clear.value)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("function", IN_TWO_SHAPES)
def test_numbers_in_two_shapes_are_compared_rightly(function, security):
    async def program(engine, x, y):
        return await function(x, y)

    program.max_norm = 1.0
    x = np.zeros(64)
    x[0] = 1.0
    secure, clear = run_local(program, x, np.zeros(64), security), run_clear(program, x, np.zeros(64))
    assert np.allclose(secure.value, clear.value, rtol=2**-29, atol=0)  # a root is not exact


@pytest.mark.parametrize("security", SECURITIES)
def test_a_cube_that_may_leave_the_field_is_refused(security):
    async def program(engine, x, y):
        (z,) = await mask(await maximum(x, y * 0.0001))
        return multiply(z, z, z)

    with pytest.raises(ValueError, match="truncate between them"):
        run_local(program, [2.0**21, 5.0], [1.0, 1.0], security)


# -- inside functions: every segment of the tables, quotients and vectors at the bounds that are claimed -----

GRID = 2.0 ** np.arange(-3, 4, 1 / 16)
UNIT = np.array([[0.6, -0.8]])


async def quotients(x, y):
    return await divide(x[:, 0] * 7, x[:, 0], largest=7.0)


async def unit_vectors(x, y):
    (rows,) = await l2_normalised(x)
    (columns,) = await l1_normalised(x)
    return rows + columns


FUNCTIONS = {
    "small root": lambda x, y: sqrt(x[:, 0] * 0.125),
    "root": lambda x, y: sqrt(x[:, 0] * 4),
    "root of a square": lambda x, y: sqrt(dot(x, x)),
    "reciprocal": lambda x, y: reciprocal(x[:, 0]),
    "reciprocal of negative numbers": lambda x, y: reciprocal(-x[:, 0]),
    "reciprocal root": lambda x, y: reciprocal_sqrt(x[:, 0]),
    "quotients": quotients,
    "unit vectors": unit_vectors,
    "cosine of parallel vectors": lambda x, y: cosine(x, x * 2),
    "cosine of opposite vectors": lambda x, y: cosine(x, -y),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_step_of_a_function_exceeds_its_bound(name):
    async def program(engine, x, y):
        return await FUNCTIONS[name](x, y)

    program.max_norm = 16.0
    x = GRID[:, None] * (np.eye(2)[:1] if name in ("root", "quotients") else np.abs(UNIT))
    with Watch() as watch:
        run_local(program, x, x, "malicious")
        run_clear(program, x, x)
    assert watch.beyond() == []
    assert len(watch.operands[0]) > 3
    assert len(watch.clear) > 3


@pytest.mark.parametrize("n", [1, 2, 3, 5, 9])
@pytest.mark.parametrize("drop", [1, 3, 20])
def test_the_bound_of_a_cut_vector_holds_however_it_is_rounded(n, drop):
    """All entries up, or all down: of vectors that point everywhere, just beyond a unit of the result."""
    unit, generator = 1 << drop, np.random.default_rng(n)
    rows = [np.full(n, k * unit + step) for k in range(-4, 5) for step in (-1, 0, 1, unit // 2)]
    rows += list(generator.integers(-5 * unit, 5 * unit, (50, n)))
    for row in rows:
        exact = row.astype(object)
        z = value(exact, Bound(int(np.abs(exact).max()), isqrt(longest(exact) - 1) + 1 if exact.any() else 0))
        for gate in (Truncate(drop), TruncateExactly(drop)):
            bound = gate.clear(z.engine, z).bound
            for rounded in (exact >> drop, -(-exact >> drop)):
                assert holds(bound, rounded)
