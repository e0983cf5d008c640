"""Every score beside what MP-SPDZ, which shares no code with this engine, computed for the same vectors."""

from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.exact import ONE, exact_score, raw, units
from bench.recorded_accuracy import compute
from bench.vectors import load_vectors
from protocols.scores import SCORES

VECTORS = load_vectors(Path(__file__).parent / "vectors" / "mp_spdz.json")
SECURITY = {16: "malicious", 256: "semi-honest"}
APART = 3.0
"""A result is at most so many units of 2^-16 from MP-SPDZ's, or else nearer to the true score than it."""

NAMES = [f"S{number}" for number in range(1, 11)]


def records(score, variant="division"):
    return [record for record in VECTORS.records if (record.score, record.variant) == (score, variant)]


@cache
def computed(score, pair):
    """Our result for a recorded pair; the two protocols of MP-SPDZ share their inputs."""
    record = next(record for record in records(score) if record.pair == pair)
    return compute(record, SECURITY[pair.n])


@pytest.mark.parametrize("score", SCORES)
def test_every_result_is_near_mp_spdz_or_nearer_to_the_truth(score):
    assert len(records(score)) == 20
    for record in records(score):
        value = computed(score, record.pair)
        for output, error in zip(record.raw, record.errors, strict=True):
            apart = units(value, Fraction(output, ONE))
            assert apart <= APART or units(value, record.exact) <= error, (record.pair.case, value, output)


@pytest.mark.parametrize("score", SCORES)
def test_the_largest_error_of_a_score_is_not_above_mp_spdz(score):
    ours = max(units(computed(score, record.pair), record.exact) for record in records(score))
    assert ours <= VECTORS.worst(score)


def test_the_file_holds_what_its_readme_says():
    assert (VECTORS.engine, VECTORS.version) == ("MP-SPDZ", "v0.4.2 (bf7f8f4b)")
    assert len(VECTORS.records) == 240 and {len(record.raw) for record in VECTORS.records} == {5}
    pairs = {record.pair for record in VECTORS.records}
    assert sorted(pair.n for pair in pairs) == [16] * 8 + [256] * 2
    assert {pair.case for pair in pairs} == {"unit", "unit_close", "normal", "positive", "uniform10"}
    assert all(len(pair.x) == len(pair.y) == pair.n for pair in pairs)
    assert {record.score for record in VECTORS.records} == set(NAMES)


def test_mp_spdz_is_near_the_exact_scores():
    """Two judges that could both be wrong agree: the exact arithmetic here, and the recorded outputs."""
    worst = {score: VECTORS.worst(score) for score in NAMES}
    assert worst["S2"] == 0.0
    assert {score for score, error in worst.items() if error > 4.3} == {"S1"}
    assert worst["S1"] < 17.1
    assert all(error < 116 for record in VECTORS.records for error in record.errors)  # S1 by reciprocals


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"format": 2}', '{"format": 1, "inputs": []}'])
def test_a_file_of_another_format_is_a_value_error(tmp_path, text):
    path = tmp_path / "vectors.json"
    path.write_text(text)
    with pytest.raises(ValueError, match="not a file of recorded vectors"):
        load_vectors(path)


def by_decimals(name, x, y):
    """The scores once more, straight from their definitions, with decimals of 80 digits."""
    x, y = ([Decimal(value) / ONE for value in vector] for vector in (x, y))

    def dot(a, b):
        return sum((p * q for p, q in zip(a, b, strict=True)), Decimal(0))

    def divided(vector, norm):
        return [value / norm if norm else value for value in vector]

    if name == "S1":
        x, y = (divided(vector, sum(map(abs, vector))) for vector in (x, y))
    if name in ("S3", "S5", "S7"):
        x, y = (divided(vector, dot(vector, vector).sqrt()) for vector in (x, y))
    difference = [p - q for p, q in zip(x, y, strict=True)]
    if name in ("S1", "S2"):
        return sum(map(abs, difference))
    if name in ("S7", "S10"):
        return dot(x, y)
    if name in ("S8", "S9"):
        norms = dot(x, x).sqrt() * dot(y, y).sqrt()
        return dot(x, y) / norms if norms else Decimal(0)
    square = dot(difference, difference)
    return square.sqrt() if name in ("S3", "S4") else square


coordinates = st.one_of(st.integers(-(2**38), 2**38), st.integers(-3, 3))


@st.composite
def raw_pairs(draw):
    n = draw(st.integers(1, 5))
    x = draw(st.lists(coordinates, min_size=n, max_size=n))
    scaled = st.integers(-3, 3).map(lambda factor: [factor * value for value in x])
    return x, draw(st.one_of(st.lists(coordinates, min_size=n, max_size=n), scaled))


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=50, deadline=None)
@given(pair=raw_pairs())
def test_the_exact_scores_are_their_definitions(name, pair):
    with localcontext() as context:
        context.prec = 80
        expected = by_decimals(name, *pair)
        found = exact_score(name, *pair)
        difference = abs(Decimal(found.numerator) / Decimal(found.denominator) - expected)
        # The square root of a rounding error at the 80th digit: 2 - 2 cos cancels here, and not there.
        assert difference < Decimal(10) ** -30 * (1 + abs(expected))


@pytest.mark.parametrize(
    ("name", "expected"),
    [("S1", 1), ("S2", 7), ("S3", 1), ("S4", 5), ("S5", 1), ("S6", 25), ("S7", 0), ("S8", 0), ("S9", 0)],
)
def test_the_zero_vector_is_its_own_normalisation(name, expected):
    vector, zero = raw([3.0, -4.0]), raw([0.0, 0.0])
    assert exact_score(name, vector, zero) == exact_score(name, zero, vector) == expected
    assert exact_score(name, zero, zero) == 0


def test_near_vectors_cancel_nothing():
    x = raw([1000.0, 1000.0])
    y = [x[0] + 1, x[1]]
    assert 0 < exact_score("S5", x, y) < Fraction(1, 10**15)
    assert exact_score("S5", x, x) == exact_score("S3", x, x) == 0
    assert exact_score("S5", x, [2 * value for value in x]) == 0
    assert exact_score("S3", x, [-value for value in x]) == 2


def test_quantising_rounds_ties_to_even():
    assert raw([0.5 / ONE, 1.5 / ONE, -0.5 / ONE, 2.5 / ONE, 1.0]) == [0, 2, 0, 2, ONE]


@pytest.mark.parametrize(("x", "y"), [([1], [1, 2]), ([], [])])
def test_vectors_of_two_lengths_or_none_are_refused(x, y):
    with pytest.raises(ValueError, match="one length"):
        exact_score("S10", x, y)
    with pytest.raises(ValueError, match="no score"):
        exact_score("S11", [1], [1])
