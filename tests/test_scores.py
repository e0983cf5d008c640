"""Secure readings agree with the clear one, exactly, and with an oracle of plain Python integers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols import is_candidate
from protocols.scores import S6, S10, SCORES
from spdz import run_clear, run_local

SECURITIES = ["malicious", "semi-honest"]


def raw(x) -> list[int]:
    return [int(v) for v in np.rint(np.asarray(x) * 65536)]


def exact(name: str, x, y) -> Fraction:
    """The score of the quantised inputs, as an exact fraction."""
    pairs = list(zip(raw(x), raw(y), strict=True))
    total = sum(a * b for a, b in pairs) if name == "S10" else sum((a - b) ** 2 for a, b in pairs)
    return Fraction(total, 1 << 32)


@st.composite
def vectors(draw, largest: float = 2.0**20):
    n = draw(st.sampled_from([1, 2, 3, 16, 33]))
    element = st.floats(-largest, largest, allow_nan=False, width=64)
    return [draw(st.lists(element, min_size=n, max_size=n)) for _ in range(2)]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", ["S6", "S10"])
@settings(max_examples=25, deadline=None)
@given(pair=vectors(largest=2.0**19))
def test_a_secure_score_is_exact(name, security, pair):
    x, y = pair
    truth = exact(name, x, y)
    assert run_local(SCORES[name], x, y, security).value == float(truth)
    assert run_clear(SCORES[name], x, y).value == float(truth)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("score", [S6, S10], ids=lambda score: score.name)
@settings(max_examples=25, deadline=None)
@given(pair=vectors(largest=100.0), offset=st.integers(-2, 2))
def test_a_candidate_bit_is_exact_at_the_threshold(score, security, pair, offset):
    x, y = pair
    truth = exact(score.name, x, y)
    threshold = float(truth + Fraction(offset, 1 << 32))
    expected = truth >= Fraction(threshold) if score.similarity else truth <= Fraction(threshold)
    assert run_local(is_candidate(score, threshold), x, y, security).value is expected


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("n", [1, 7, 8192, 100_000])
def test_odd_lengths_work(n, security):
    generator = np.random.default_rng(n)
    x, y = generator.standard_normal((2, n))
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    for name in ("S6", "S10"):
        score = SCORES[name].within(1.0)
        assert run_local(score, x, y, security).value == float(exact(name, x, y))
        threshold = 0.5 if score.similarity else 1.0
        assert run_local(is_candidate(score, threshold), x, y, security).value is bool(
            n == 1 and x[0] == y[0]
        )


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("score", [S6, S10], ids=lambda score: score.name)
def test_inputs_at_the_edge_of_the_range_do_not_overflow(score, security):
    edge = 2.0**22
    for x, y in ([edge], [edge]), ([edge], [-edge]), ([edge, 0], [0, edge]):
        assert run_local(score, x, y, security).value == float(exact(score.name, x, y))
        for threshold in (0.0, 2.0**43, -(2.0**43), 2.0**46, 1e300, -1e300):
            truth = exact(score.name, x, y)
            expected = truth >= Fraction(threshold) if score.similarity else truth <= Fraction(threshold)
            assert run_local(is_candidate(score, threshold), x, y, security).value is expected


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("score", [S6, S10], ids=lambda score: score.name)
def test_all_pairs_are_the_single_pairs(score, security):
    generator = np.random.default_rng(5)
    x, y = generator.standard_normal((3, 10)), generator.standard_normal((4, 10))
    grid = run_local(score, x[:, None], y[None], security).value
    single = [[run_local(score, a, b, security).value for b in y] for a in x]
    assert np.array_equal(grid, single)
    bits = run_local(is_candidate(score, 1.0), x[:, None], y[None], security).value
    assert bits.dtype == np.bool_
    expected = np.array(single) >= 1.0 if score.similarity else np.array(single) <= 1.0
    assert np.array_equal(bits, expected)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ([1.0, np.nan, 0.0], "finite"),
        ([np.inf, 0.0, 0.0], "finite"),
        ([2.0**23, 0.0, 0.0], "4194304"),
        ([1e300, 0.0, 0.0], "4194304"),
        ([4e6, 4e6, 0.0], "4194304"),
        (["a", "b", "c"], "number"),
        ([1j, 0, 0], "real"),
        ([], "empty"),
    ],
)
def test_bad_input_is_a_value_error_that_names_the_limit(bad, says):
    for x, y in ((bad, [1.0, 2.0, 3.0]), ([1.0, 2.0, 3.0], bad)):
        with pytest.raises(ValueError, match=says):
            run_local(S10, x, y)


def test_lengths_that_differ_are_refused():
    with pytest.raises(ValueError, match="equal length"):
        run_local(S10, [1.0, 2.0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("threshold", [np.nan, np.inf, -np.inf])
def test_a_threshold_must_be_finite(threshold):
    with pytest.raises(ValueError, match="finite"):
        is_candidate(S10, threshold)
