"""Public numbers are rounded once, from whatever type, and refused where they are none."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from gate_helpers import SECURITIES, exactly
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz import divide, measure, multiply, nonnegative, round_exactly, run_local, truncate
from spdz.arithmetic.public import integers, is_whole, limit, magnitude, rounded

laws = settings(max_examples=150, deadline=None)
INT64, UINT64 = np.iinfo(np.int64), np.iinfo(np.uint64)

WHOLE = {
    "int": 2**100,
    "negative int": -(2**100),
    "bool": True,
    "np.bool_": np.True_,
    "int8": np.int8(-128),
    "int64's least": np.int64(INT64.min),
    "uint64's largest": np.uint64(UINT64.max),
    "0-d": np.array(-7),
    "0-d least": np.array(INT64.min),
    "int8 array": np.array([-128, 127], np.int8),
    "int64 array": np.array([INT64.min, INT64.max, 0]),
    "uint64 array": np.array([UINT64.max, 0], np.uint64),
    "bool array": np.array([[True], [False]]),
    "object array": np.array([2**70, -(2**80)], dtype=object),
    "list": [1, -2, 2**70],
    "empty": np.zeros((0, 2), np.int16),
}
REAL = {
    "float": -0.7,
    "large float": 1e35,
    "least float": 5e-324,
    "float16": np.float16(0.3),
    "float32": np.float32(-1e-3),
    "longdouble": np.longdouble(1) / 3,
    "0-d": np.array(2.5),
    "float16 array": np.array([0.3, 60000], np.float16),
    "float32 array": np.array([[1e30, -1e-3]], np.float32),
    "float64 array": np.array([0.7, -1e300, 2.0**53 + 2, 5e-324]),
    "longdouble array": np.array([1, 2]) / np.longdouble(3),
    "list": [1, -0.5],
    "empty": np.zeros(0),
}


def exact(number, frac):
    """Independent of the module: entry by entry, as fractions."""
    flat = np.asarray(number).ravel().tolist()
    whole = [one if isinstance(one, int) else Fraction(*one.as_integer_ratio()) for one in flat]
    return [round(Fraction(one) * (1 << frac)) for one in whole]


@pytest.mark.parametrize("frac", [0, 1, 16, 33, 60, 64, 100])
@pytest.mark.parametrize("number", [*WHOLE.values(), *REAL.values()], ids=[*WHOLE, *REAL])
def test_any_type_is_rounded_once(number, frac):
    raw = rounded(number, frac)
    assert np.asarray(raw, dtype=object).ravel().tolist() == exact(number, frac)
    assert np.shape(raw) == np.shape(number)
    assert type(raw) is int if np.ndim(number) == 0 else raw.dtype in (np.int64, object)
    assert magnitude(raw) == max(map(abs, exact(number, frac)), default=0)
    assert np.asarray(-raw, dtype=object).ravel().tolist() == [-one for one in exact(number, frac)]


@laws
@given(st.lists(st.floats(-1e25, 1e25), min_size=1, max_size=9), st.integers(0, 70))
def test_floats_are_rounded_to_the_nearest_with_ties_to_even(numbers, frac):
    assert np.asarray(rounded(np.array(numbers), frac)).tolist() == exact(numbers, frac)
    assert [rounded(number, frac) for number in numbers] == exact(numbers, frac)


@laws
@given(st.lists(st.integers(INT64.min, INT64.max), min_size=1, max_size=9), st.integers(0, 70))
def test_integers_stay_what_they_are(numbers, frac):
    assert np.asarray(rounded(np.array(numbers), frac), dtype=object).tolist() == exact(numbers, frac)


def test_ties_go_to_even():
    halves = [0.5, 1.5, 2.5, -0.5, -1.5]
    assert rounded(np.array(halves), 0).tolist() == [rounded(one, 0) for one in halves] == [0, 2, 2, 0, -2]
    assert rounded(np.array(halves, np.longdouble), 0).tolist() == [0, 2, 2, 0, -2]


def test_whole_numbers_are_told_from_real_ones():
    assert all(is_whole(number) for number in WHOLE.values())
    assert not any(is_whole(number) for number in REAL.values())


HIDDEN = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])
NONE = {
    "nan": float("nan"),
    "infinity": [1.0, -np.inf],
    "complex": 1j,
    "text": "1.0",
    "nothing": None,
    "dates": np.array(["2020-01-01"], dtype="M8[D]"),
    "mixed": np.array([1, 0.5], dtype=object),
}


@pytest.mark.parametrize("number", NONE.values(), ids=NONE)
def test_what_is_no_real_number_is_refused(number):
    with pytest.raises(ValueError, match="real and finite"):
        rounded(number, 16)


@pytest.mark.parametrize("number", [HIDDEN, [HIDDEN, HIDDEN], ([HIDDEN],), np.ma.masked, np.ma.array([1])])
def test_a_masked_array_is_refused(number):
    for use in (
        lambda x: x + number,
        lambda x: number - x,
        lambda x: x * number,
        lambda x: x.plus_raw(number),
    ):
        with pytest.raises(ValueError, match=r"masked array.*filled"):
            measured(lambda x, y, use=use: use(x))


@pytest.mark.parametrize("raw", [0.5, [1.0], np.float32(2), np.longdouble(1)])
def test_raw_numbers_are_whole(raw):
    with pytest.raises(ValueError, match="raw numbers are integers"):
        integers(raw)


@laws
@given(st.floats(0, 1e30), st.integers(0, 60))
def test_a_given_bound_is_rounded_up(number, frac):
    exact_bound = Fraction(number) * (1 << frac)
    assert exact_bound <= limit(number, frac, "entry") < exact_bound + 1


def test_a_given_bound_may_be_of_any_type():
    for number in (3, 2**90, np.int64(3), np.float32(3), np.float64(3), Fraction(3)):
        assert limit(number, 4, "entry") == int(number) << 4
        assert type(limit(number, 4, "entry")) is int


# -- in programs ----------------------------------------------------------------------------------------


def program(function, max_norm=8.0):
    async def run(engine, x, y):
        result = function(x, y)
        result = await result if hasattr(result, "__await__") else result
        return result[0] if isinstance(result, list) else result

    run.max_norm = max_norm
    return run


def measured(function, security="malicious"):
    return measure(program(function), ((3,), (3,)), security)


X = [5.0, -2.0, 3.0]
USES = {
    "added": lambda x, number: x + number,
    "subtracted": lambda x, number: number - x,
    "multiplied": lambda x, number: number * x,
}


USED = {
    name: number
    for name, number in {**REAL, **WHOLE}.items()
    if np.shape(number) in ((), (2, 1)) and magnitude(rounded(number, 20)) < 1 << 105
}


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("number", USED.values(), ids=USED)
def test_a_public_number_of_any_type_is_used_exactly(number, use, security):
    bits = 16 if use != "multiplied" or not is_whole(number) else 0
    plain = np.array(exact(number, bits), dtype=object).reshape(np.shape(number)) * Fraction(1, 1 << bits)
    x = np.array([Fraction(one) for one in X], dtype=object)
    value = exactly(program(lambda x, y: USES[use](x, number)), X, X, security).value
    assert np.array_equal(value, USES[use](x, plain))


ARRAYS = {
    name: np.ravel(number) for name, number in {**REAL, **WHOLE}.items() if np.shape(number) in ((2,), (1, 2))
}


@pytest.mark.parametrize("security", [*SECURITIES, None])
@pytest.mark.parametrize("numbers", ARRAYS.values(), ids=ARRAYS)
def test_public_arrays_are_added_exactly_at_any_scale(numbers, security):
    """Beside 16, also 44 fractional bits: raw integers of more than 64 bits."""
    for frac in (16, 44):
        if magnitude(rounded(numbers, frac)) < 1 << 120:
            run = program(lambda x, y, frac=frac: x[:2].rescaled(frac) - numbers)
            value = exactly(run, X, X, security).value
            assert (value * (1 << frac)).tolist() == [
                (int(one) << frac) - raw for one, raw in zip(X[:2], exact(numbers, frac), strict=True)
            ]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("number", [-(2**63), 2**64 - 1, 2**63])
def test_the_ends_of_integer_types_are_compared_rightly(number, security):
    for raw in (number, np.array([number] * 3, dtype=np.int64 if number < 0 else np.uint64)):
        run = program(lambda x, y, raw=raw: nonnegative(x.plus_raw(raw)))
        assert np.array_equal(run_local(run, X, X, security).value, [number > 0] * 3)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_real_number_is_not_rounded_to_a_whole_one_where_it_is_added_to_a_count(security):
    async def more_than_half(x, y):
        count = (await nonnegative(x)).sum()
        return await nonnegative(count - 2.5)

    assert run_local(program(more_than_half), X, X, security).value is False
    assert run_local(program(more_than_half), [1.0, 1.0, 1.0], X, security).value is True


REFUSED = {
    "negative frac": (lambda x, y: truncate(x, frac=-3), "frac must be 0 or more"),
    "negative frac, exactly": (lambda x, y: round_exactly(x, frac=-1), "frac must be 0 or more"),
    "real frac": (lambda x, y: truncate(x, frac=3.0), "whole number of bits"),
    "rescaled to a negative frac": (lambda x, y: x.rescaled(-1), "frac must be 0 or more"),
    "a quotient's negative frac": (lambda x, y: divide(x, y, largest=1.0, frac=-1), "frac must be 0 or more"),
    "no quotient": (lambda x, y: divide(x, y, largest=0.0), "above 0 and finite"),
    "an endless quotient": (lambda x, y: divide(x, y, largest=float("inf")), "above 0 and finite"),
    "negative entry": (lambda x, y: multiply(x, y, entry=-1.0), "entry must be finite and not negative"),
    "endless norm": (lambda x, y: multiply(x, y, norm=float("inf")), "norm must be finite"),
    "no entry": (lambda x, y: multiply(x, y, entry=float("nan")), "entry must be finite"),
    "negative bound": (lambda x, y: nonnegative(x, -1), "bound must be finite and not negative"),
}


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_no_sense_is_refused_when_it_is_metered(name, security):
    function, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        measured(function, security)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("cut", [truncate, round_exactly])
def test_bits_may_be_counted_in_numpy_integers(cut, security):
    run = program(lambda x, y: cut(x.rescaled(np.int64(40)), frac=np.int8(8)))
    assert np.array_equal(exactly(run, X, X, security).value, X)


@pytest.mark.parametrize("security", SECURITIES)
def test_a_bound_may_be_a_numpy_integer(security):
    run = program(partial(lambda x, y, bound: nonnegative(x, bound), bound=np.int32(2**31 - 1)))
    assert np.array_equal(run_local(run, X, X, security).value, [True, False, True])
