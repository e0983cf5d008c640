"""Linear maps agree with the clear engine, and the public bounds are never exceeded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols import is_candidate
from protocols.scores import S6, S10, SCORES, Score
from spdz import (
    Value,
    absolute,
    beaver_dot,
    beaver_multiply,
    divide,
    dot,
    l2_normalised,
    maximum,
    measure,
    multiply,
    nonnegative,
    round_exactly,
    run_clear,
    run_local,
    sqrt,
    truncate,
)
from spdz.arithmetic.bound import Bound
from spdz.readings.clear import Clear
from spdz.rounds.coroutine import parallel
from spdz.values.value import concatenate

N = 6
X = np.array([0.5, -1.0, 2.0, 0.25, -0.125, 3.0])
Y = np.array([1.0, 0.5, -0.5, 4.0, 2.0, -1.5])


def formula(function):
    async def program(engine, x, y):
        return function(x, y)

    return program


LINEAR = {
    "public on the left": lambda x, y: 2 - x,
    "array": lambda x, y: x * np.arange(N) + y * 0.5,
    "broadcast a scalar": lambda x, y: x[:1] + y,
    "broadcast a public matrix": lambda x, y: (x + np.ones((3, 1))).sum(0) - y,
    "index": lambda x, y: x[..., ::2] - y[3:],
    "new axis": lambda x, y: x[:, None] + y[None, :],
    "reshape": lambda x, y: x.reshape(2, 3) - y.reshape(2, 3),
    "sums": lambda x, y: x.reshape(2, 3).sum(0).sum() + y.sum(),
    "different scales": lambda x, y: dot(x, y) + x[0],
    "products": lambda x, y: multiply(x - y, x + y)[1:] * 3,
    "dots of public combinations": lambda x, y: dot(x * 2 - y, y + 1),
}


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("name", LINEAR)
def test_linear_maps_and_products_are_exact(name, security):
    program = formula(LINEAR[name])
    assert np.array_equal(run_local(program, X, Y, security).value, run_clear(program, X, Y).value)


@pytest.mark.parametrize(
    ("function", "threshold"),
    [
        (lambda x, y: dot(x - 0.5, y - 0.5), 3.8),
        (lambda x, y: dot(x - 0.5, y - 0.5), 382.0),
        (lambda x, y: (x[:1] + y).sum(), -10.0),
        (lambda x, y: dot(x[:, None], y[:, None]).sum(), 0.0),
    ],
)
def test_a_candidate_bit_is_right_whatever_was_added_or_broadcast(function, threshold):
    """Constants and broadcasting lengthen a vector more than its entries: the comparison must hold both."""

    async def score(engine, x, y):
        return function(x, y)

    program = is_candidate(Score("mine", "", similarity=True, formula=score, max_norm=1.0), threshold)
    x = np.full(1536, -1 / 40.0)
    opened = run_clear(program.score, x, x).value
    assert run_local(program, x, x).value is bool(opened >= threshold)
    assert run_clear(program, x, x).value is bool(opened >= threshold)


def test_bits_can_be_counted_and_compared():
    async def most(engine, x, y):
        bits = await nonnegative(x - y)
        return await nonnegative(bits.sum() - 50)

    x = np.linspace(1, 2, 60)
    assert run_local(most, x, -x).value is True
    assert run_local(most, -x, x).value is False


@pytest.mark.parametrize("name", LINEAR)
def test_a_value_never_exceeds_its_own_bound(name):
    """Judged in the clear engine, with inputs at their bound and constants that lengthen them."""
    clear = Clear(0)
    data = np.rint(np.array([X, Y]) * 65536).astype(np.int64)
    norm = int(np.ceil(max(np.linalg.norm(row) for row in data)))
    x, y = (clear.value(row, 16, Bound.of_norm(norm), masked=True) for row in data)
    for value in (LINEAR[name](x, y), LINEAR[name](x - 9, y + np.full(N, 7.5))):
        raw = np.asarray(value.parts[0]).astype(np.float64)
        assert np.abs(raw).max() <= value.bound.entry
        assert np.linalg.norm(np.atleast_1d(raw), axis=-1).max() <= value.bound.norm


@pytest.mark.parametrize("max_norm", [1.0, 2.0**22])
@pytest.mark.parametrize("name", SCORES)
def test_no_step_of_a_score_exceeds_its_bound(name, max_norm, monkeypatch):
    """Every value that reaches a gate in the clear, for vectors at the ends of the range."""
    read, seen = Clear.read, []

    def check(value):
        rows = np.atleast_1d(np.asarray(value.parts[0]).astype(object))
        assert np.abs(rows).max() <= value.bound.entry
        assert np.max((rows**2).sum(axis=-1)) <= value.bound.norm**2
        seen.append(value)

    def checked(engine, gate, *operands):
        for operand in operands:
            if isinstance(operand, Value):
                check(operand)
        return read(engine, gate, *operands)

    monkeypatch.setattr(Clear, "read", checked)
    generator = np.random.default_rng(3)
    x, y = generator.standard_normal((2, 12, 5))
    x, y = (side / np.linalg.norm(side, axis=-1, keepdims=True) * max_norm * (1 - 1e-9) for side in (x, y))
    x[0] = y[1] = 0
    x[2], y[2], y[3], y[4] = max_norm * np.eye(5)[0], max_norm * np.eye(5)[0], x[3], -x[4]
    x[5], y[5] = 2.0**-16 * np.eye(5)[1], 2.0**-16 * np.eye(5)[2]
    x[6:] *= 2.0 ** -np.arange(6)[:, None]
    run_clear(SCORES[name].within(max_norm), x, y)
    for threshold in (-1e300, 0.3, 1e300):
        run_clear(is_candidate(SCORES[name].within(max_norm), threshold), x, y)
    assert len(seen) > 8


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 3),
    n=st.integers(1, 9),
    constant=st.integers(-50, 50),
    factor=st.integers(-9, 9),
    seed=st.integers(0, 2**32 - 1),
)
def test_bounds_hold(rows, n, constant, factor, seed):
    generator = np.random.default_rng(seed)
    shape = (rows, n)
    raw = generator.integers(-100, 101, shape)
    bound = Bound.of_norm(int(np.ceil(np.linalg.norm(raw, axis=-1).max())))
    steps = [
        (raw + constant, bound + Bound.of_entry(abs(constant), shape)),
        (raw * factor, bound.scaled(abs(factor))),
        (raw.sum(0), bound.summed(shape, 0)),
        (raw.sum(1), bound.summed(shape, 1)),
        (np.broadcast_to(raw[:, :1], shape), Bound(bound.entry, bound.entry).broadcast((rows, 1), shape)),
        (raw @ raw.T, bound.dot(bound, (rows, rows))),
        (raw * raw, bound.product(bound, shape)),
    ]
    for value, claimed in steps:
        assert np.abs(value).max() <= claimed.entry
        assert np.linalg.norm(np.atleast_1d(value), axis=-1).max() <= claimed.norm + 1e-6


WITHOUT_ENTRIES = {
    "inputs": lambda x, y: x - y,
    "public numbers": lambda x, y: x * np.zeros(0) + np.zeros((2, 0)),
    "a product": lambda x, y: multiply(x, y),
    "a Beaver product": beaver_multiply,
    "a bit": lambda x, y: nonnegative(x),
    "a magnitude": lambda x, y: absolute(x),
    "a maximum": maximum,
    "a cut number": lambda x, y: truncate(x, frac=3),
    "a rounded number": lambda x, y: round_exactly(x, frac=3),
    "a root": lambda x, y: sqrt(x),
    "a quotient": lambda x, y: divide(x, y, largest=9.0),
    "unit vectors": lambda x, y: l2_normalised(x.reshape(0, 3)),
}


@pytest.mark.parametrize("security", ["malicious", "semi-honest", None])
@pytest.mark.parametrize("name", WITHOUT_ENTRIES)
def test_an_array_without_entries_passes_through(name, security):
    async def program(engine, x, y):
        result = WITHOUT_ENTRIES[name](x[:0], y[:0])
        result = await result if hasattr(result, "__await__") else result
        return result[0] if isinstance(result, list) else result

    outcome = run_clear(program, X, Y) if security is None else run_local(program, X, Y, security)
    assert np.size(outcome.value) == 0


@pytest.mark.parametrize(
    "function", [dot, beaver_dot, lambda x, y: l2_normalised(x)], ids=["dot", "beaver", "l2"]
)
def test_vectors_without_coordinates_are_refused_when_they_are_metered(function):
    async def program(engine, x, y):
        result = function(x[:0], y[:0])
        return await result if hasattr(result, "__await__") else result

    with pytest.raises(ValueError, match="at least 1"):
        measure(program, ((N,), (N,)), "malicious")
    with pytest.raises(ValueError, match="at least 1"):
        run_clear(program, X, Y)


@pytest.mark.parametrize("doublings", [0, 1, 2, 10, 25, 40])
def test_the_clear_reading_is_exact_however_long_its_integers_grow(doublings):
    """Sums, negations, joins and dot products of numbers around 2^40, 2^63 and 2^64."""
    raw = np.array([2**38 - 1, -(2**38), 2**37 + 1], dtype=object)
    for step in range(doublings + 1):
        total = raw * 2**step
        z = Clear(0).value(raw.astype(np.int64), 16, Bound.of_norm(2**39), masked=True)
        for _ in range(step):
            z = z + z
        clear = [
            (-z, -total),
            (z - (z + z), -total),
            (-z[0], -total[0]),
            (concatenate(z[0].reshape(1), -z[1].reshape(1), z), [total[0], -total[1], *total]),
            ((z.sum() - z[2]).plus_raw(2**63), total[0] + total[1] + 2**63),
            (dot(z, z) if step < 20 else z, (total * total).sum() if step < 20 else total),
        ]
        for value, exact in clear:
            assert np.array_equal(np.asarray(value.parts[0]).astype(object), np.asarray(exact, dtype=object))


def test_a_program_that_could_leave_the_field_is_refused_before_it_runs():
    async def fourth_power(engine, x, y):
        return await beaver_multiply(dot(x, y), dot(x, y))

    with pytest.raises(ValueError, match="do not fit the field"):
        run_local(fourth_power, [2.0**20], [2.0**20])


def test_a_score_that_is_too_wide_to_compare_is_refused_before_it_runs():
    wide = Score("wide", "", similarity=True, formula=formula(lambda x, y: dot(x, y) * 2**20))
    with pytest.raises(ValueError, match="wrap more often"):
        run_local(is_candidate(wide, 0.5), X, Y)


@pytest.mark.parametrize("score", [S6, S10], ids=["S6", "S10"])
def test_vectors_of_different_length_are_refused(score):
    for x, y in (([1.0], [1.0, 2.0, 3.0]), ([1.0, 2.0], [1.0])):
        with pytest.raises(ValueError, match="equal length"):
            run_local(score, x, y)


def test_programs_that_need_other_correlations_have_other_recipes():
    shapes = ((2, 4), (2, 4))
    programs = [
        lambda x, y: dot(x, y),
        lambda x, y: dot(y, x * 2),
        lambda x, y: dot(x, x),
        lambda x, y: dot(x[::-1], y),
        lambda x, y: dot(x[:1], y),
        lambda x, y: dot((x + np.zeros((3, 1, 1))).sum(0), y),
        lambda x, y: dot((x + np.zeros((5, 1, 1))).sum(0), y),
        lambda x, y: multiply(x, y),
        lambda x, y: multiply(x, y)[0],
    ]
    recipes = [measure(formula(function), shapes, "malicious").recipe for function in programs]
    assert len(set(recipes)) == len(recipes)
    thresholds = [measure(is_candidate(S10, t), shapes, "malicious") for t in (0.25, 0.5)]
    assert thresholds[0].recipe == thresholds[1].recipe
    assert thresholds[0].text != thresholds[1].text


@pytest.mark.parametrize("key", [[0, 1], np.array([1]), 1.0, "a", (slice(None), [0])])
def test_an_index_is_basic_or_refused(key):
    with pytest.raises(TypeError, match="indexed by"):
        run_local(formula(lambda x, y: x[key]), X, Y)


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_a_program_may_run_parts_of_itself_in_parallel(security):
    async def both(engine, x, y):
        first, second = await parallel(nonnegative(x - y), nonnegative(y - x))
        return first + second

    outcome = run_local(both, X, Y, security)
    assert np.array_equal(outcome.value, np.ones(N))
    assert outcome.stats[0].rounds == run_local(S10, X, Y, security).stats[0].rounds  # local on inputs


@pytest.mark.parametrize("security", ["semihonest", "Malicious", "MALICIOUS", "", None, "semi_honest"])
def test_a_misspelt_security_model_never_becomes_the_weaker_one(security):
    with pytest.raises(ValueError, match="security must be one of"):
        run_local(S10, X, Y, security)
    with pytest.raises(ValueError, match="security must be one of"):
        measure(S10, ((N,), (N,)), security)
