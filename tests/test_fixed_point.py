"""Quantisation, its refusals, and reading results."""

from fractions import Fraction
from math import ceil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field
from spdz.arithmetic.fixed_point import (
    FRACTION_BITS,
    MAX_NORM,
    decode,
    decode_signed,
    encode,
    encode_few,
    norm_bound,
)

SECRET = 123.456
laws = settings(max_examples=100, deadline=None)


@laws
@given(st.lists(st.floats(-1000, 1000), min_size=1, max_size=30))
def test_quantisation_rounds_to_nearest_even(values):
    raw = encode(values, max_norm=MAX_NORM)
    assert raw.dtype == np.int64
    assert raw.tolist() == [round(Fraction(value) * 2**FRACTION_BITS) for value in values]


def test_ties_go_to_even():
    halves = np.array([0.5, 1.5, 2.5, -0.5, -1.5]) / 2**16
    assert encode(halves, max_norm=1.0).tolist() == [0, 2, 2, 0, -2]


AWKWARD = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 0.5 / 2**16, 1.5 / 2**16)


@laws
@given(
    st.lists(st.floats(-0.5, 0.5) | st.sampled_from(AWKWARD), min_size=1, max_size=64),
    st.sampled_from([0.3, 1.0, 40.0]),
)
def test_few_numbers_are_quantised_as_many_are_or_not_at_all(values, max_norm):
    few = encode_few(np.array(values), norm_bound(max_norm, len(values)) ** 2)
    if few is None:
        with pytest.raises(ValueError):
            encode(values, max_norm=max_norm)
    else:
        assert few == encode(values, max_norm=max_norm).tolist() and {type(one) for one in few} == {int}


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, np.int8, np.uint64])
def test_real_dtypes_are_accepted(dtype):
    x = np.array([[1, 2], [3, 0]], dtype=dtype)
    assert encode(x, max_norm=8).tolist() == [
        [65536, 131072],
        [196608, 0],
    ]


@pytest.mark.parametrize(
    "bad, match",
    [
        ([True, False], "dtype bool"),
        ([1j], "dtype complex"),
        (["1.0"], "dtype <U"),
        ([None], "dtype object"),
        (np.array(["2020-01-01"], dtype="M8[D]"), "dtype datetime64"),
        ([[1.0], [2.0, 3.0]], "rectangular"),
        ([], "empty"),
        (np.zeros((3, 0)), "empty"),
        (np.zeros((0, 3)), "empty"),
        (1.0, "single number"),
        ([1.0, SECRET, float("nan")], "index 2 is not finite"),
        ([float("inf")], "index 0 is not finite"),
        ([[1.0, 2.0], [SECRET, -float("inf")]], r"index \(1, 1\) is not finite"),
        ([1e300, SECRET], "L2 norm above"),
        ([1e308, -1e308], "L2 norm above"),
        ([[1.0, 2.0], [SECRET, 2.0**22]], "vector at index 1 has an L2 norm"),
        ([[[1.0]], [[2.0**23]]], r"vector at index \(1, 0\) has an L2 norm"),
        ([2**63 - 1], "L2 norm above"),
    ],
)
def test_bad_input_is_refused_in_words_without_values(bad, match):
    with pytest.raises(ValueError, match=match) as caught:
        encode(bad, max_norm=MAX_NORM, name="scan")
    assert str(caught.value).startswith("scan: ")
    assert "123" not in str(caught.value) and "1e" not in str(caught.value)


HIDDEN = np.ma.array([[0.6, 0.8], [0.6, 99.0]], mask=[[False, False], [False, True]])


@pytest.mark.parametrize("masked", [HIDDEN, list(HIDDEN), (HIDDEN[0],), HIDDEN[:1], [[HIDDEN]]], ids=repr)
def test_masked_arrays_are_refused_with_what_to_do(masked):
    with pytest.raises(ValueError, match=r"scan: a masked array .*filled"):
        encode(masked, max_norm=1.0, name="scan")
    assert encode(HIDDEN.filled(0), max_norm=1.0).shape == (2, 2)


def unit_rows(n, dtype, count=60):
    """Rows that were normalised in this precision, as a network's output is."""
    x = np.random.default_rng(n).standard_normal((count, n)).astype(dtype)
    return x / np.linalg.norm(x, axis=-1, keepdims=True).astype(dtype)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 16, 17, 256, 1536, 8192])
def test_rows_normalised_in_single_precision_are_accepted(n):
    """They are too long by 1e-7, which the room for rounding in the bound covers."""
    x = unit_rows(n, np.float32)
    if n > 2:
        assert (np.linalg.norm(x.astype(np.float64), axis=-1) > 1).any()
    raw = encode(x, max_norm=1.0)
    assert all(sum(one * one for one in row) <= norm_bound(1.0, n) ** 2 for row in raw.tolist())


def test_rows_normalised_in_half_precision_are_told_to_be_normalised_in_double_precision():
    x = unit_rows(256, np.float16)
    excess = np.linalg.norm(x.astype(np.float64), axis=-1).max() - 1
    assert 1e-4 < excess < 1e-2
    with pytest.raises(
        ValueError, match=r"by 0\.\d+ %; normalise it in float64, .*linalg\.norm.*keepdims=True"
    ):
        encode(x, max_norm=1.0)
    x = np.asarray(x, np.float64)
    encode(x / np.linalg.norm(x, axis=-1, keepdims=True), max_norm=1.0)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ([1.00123, 0.0], "by 0.123 %"),
        ([0.0, -1.5], "by 50 %"),
        ([12.0, 16.0], "by a factor of 20"),
        ([3e200, 4e200], r"by a factor of 5e\+200"),
        ([1e308, 1e308], "by a factor of 1.41e"),
    ],
)
def test_the_message_says_how_much_too_long_a_vector_is(row, says):
    with pytest.raises(ValueError, match=says):
        encode([[0.6, 0.8], row], max_norm=1.0)


def test_the_message_names_the_limit():
    with pytest.raises(ValueError, match=r"above 1\.5"):
        encode([3.0], max_norm=1.5)


@laws
@given(st.floats(min_value=0, max_value=MAX_NORM, exclude_min=True), st.integers(1, 10**9))
def test_norm_bound_in_exact_arithmetic(max_norm, n):
    half_root = 0
    while 4 * half_root**2 < n:
        half_root = max(2 * half_root, 1)
    low = half_root // 2
    while low < half_root:  # the least integer m with 2 m >= sqrt(n)
        middle = (low + half_root) // 2
        low, half_root = (low, middle) if 4 * middle**2 >= n else (middle + 1, half_root)
    assert norm_bound(max_norm, n) == ceil(Fraction(max_norm) * 2**16) + half_root


@pytest.mark.parametrize(
    "max_norm, n, expected",
    [
        (1.0, 1, 65537),
        (1.0, 4, 65537),
        (1.0, 5, 65538),
        (1.0, 16, 65538),
        (1.0, 17, 65539),
        (5e-324, 1, 2),
        (MAX_NORM, 4, 2**38 + 1),
    ],
)
def test_norm_bounds(max_norm, n, expected):
    bound = norm_bound(max_norm, n)
    assert bound == expected and isinstance(bound, int)


@pytest.mark.parametrize("max_norm", [0.0, -1.0, float("nan"), float("inf"), 2.0**22 + 1])
def test_impossible_norms_are_refused(max_norm):
    with pytest.raises(ValueError, match="max_norm"):
        norm_bound(max_norm, 8)
    with pytest.raises(ValueError, match="max_norm"):
        encode([0.5], max_norm=max_norm)


def test_a_vector_needs_a_coordinate():
    with pytest.raises(ValueError, match="coordinate"):
        norm_bound(1.0, 0)


@laws
@given(st.integers(1, 300), st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1.0, 100.0, MAX_NORM]))
def test_every_vector_of_the_allowed_norm_is_accepted(n, seed, max_norm):
    x = np.random.default_rng(seed).normal(size=n)
    x *= max_norm * (1 - 1e-12) / np.linalg.norm(x)
    raw = encode(x, max_norm=max_norm)
    assert sum(value * value for value in raw.tolist()) <= norm_bound(max_norm, n) ** 2


@pytest.mark.parametrize("max_norm", [1.0, MAX_NORM])
@pytest.mark.parametrize("n", [4, 9, 8100])
def test_the_limit_is_exact_to_one_raw_unit(max_norm, n):
    bound = norm_bound(max_norm, n)
    row = np.zeros((2, n))
    row[1, n // 2] = bound / 2**16
    assert encode(row, max_norm=max_norm)[1, n // 2] == bound
    row[1, 0] = 2.0**-16
    with pytest.raises(ValueError, match="vector at index 1"):
        encode(row, max_norm=max_norm)


def test_input_is_not_changed():
    x = np.array([0.1, 0.2])
    encode(x, max_norm=1.0)
    assert x.tolist() == [0.1, 0.2]


@laws
@given(st.integers(-(field.P // 2), field.P // 2), st.integers(0, 90))
def test_decoding_is_the_nearest_float(raw, frac):
    expected = float(Fraction(raw, 2**frac))
    assert decode(raw, frac) == expected
    assert decode(np.array([[raw, -raw]], dtype=object), frac).tolist() == [[expected, -expected]]
    assert decode_signed(field.from_ints([raw, -raw]), frac).tolist() == [expected, -expected]


def test_decoded_shapes():
    assert isinstance(decode(3 << 15, 16), float)
    single = decode_signed(field.from_int(-(3 << 15)), 16)
    assert single.shape == () and single == -1.5
    assert decode_signed(field.zeros((2, 0)), 16).shape == (2, 0)


@laws
@given(st.lists(st.floats(-1000, 1000), min_size=1, max_size=30))
def test_encoding_then_decoding_errs_by_half_a_unit(values):
    raw = encode(values, max_norm=MAX_NORM)
    back = decode_signed(field.from_int64(raw), FRACTION_BITS)
    assert np.abs(back - values).max() <= 0.5 / 2**16
