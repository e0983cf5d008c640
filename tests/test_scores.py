"""All ten scores and their candidate bits against an oracle of plain integers, over the whole range.

The oracle computes on the quantised inputs, with integers and gmpy2 at 300 bits: definitions as they are
written, and nothing of the engine.
"""

from fractions import Fraction

import gmpy2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols import is_candidate
from protocols.scores import S6, S10, SCORES
from spdz import run_clear, run_local

SECURITIES = ["malicious", "semi-honest"]
EXACT = ("S2", "S6", "S10")
EDGE = 2.0**22
UNIT = 2.0**-16


# -- the oracle -----------------------------------------------------------------------------------------


def raw(x) -> list[int]:
    return [int(v) for v in np.rint(np.asarray(x) * 65536)]


def _normalised(v, norm):
    return [gmpy2.mpfr(a) / norm if norm else gmpy2.mpfr(0) for a in v]


def _hat(v):
    return _normalised(v, gmpy2.sqrt(gmpy2.mpfr(sum(a * a for a in v))))


def _bar(v):
    return _normalised(v, gmpy2.mpfr(sum(abs(a) for a in v)))


def _l1(x, y):
    return sum(abs(a - b) for a, b in zip(x, y, strict=True))


def _l2sq(x, y):
    return sum((a - b) ** 2 for a, b in zip(x, y, strict=True))


def _dot(x, y):
    return sum(a * b for a, b in zip(x, y, strict=True))


def _cosine(x, y):
    lengths = gmpy2.sqrt(gmpy2.mpfr(_dot(x, x)) * _dot(y, y))
    return gmpy2.mpfr(_dot(x, y)) / lengths if lengths else gmpy2.mpfr(0)


DEFINITIONS = {
    "S1": lambda x, y: _l1(_bar(x), _bar(y)),
    "S2": lambda x, y: gmpy2.mpq(_l1(x, y), 1 << 16),
    "S3": lambda x, y: gmpy2.sqrt(_l2sq(_hat(x), _hat(y))),
    "S4": lambda x, y: gmpy2.sqrt(gmpy2.mpfr(_l2sq(x, y))) / (1 << 16),
    "S5": lambda x, y: _l2sq(_hat(x), _hat(y)),
    "S6": lambda x, y: gmpy2.mpq(_l2sq(x, y), 1 << 32),
    "S7": lambda x, y: _dot(_hat(x), _hat(y)),
    "S8": _cosine,
    "S9": _cosine,
    "S10": lambda x, y: gmpy2.mpq(_dot(x, y), 1 << 32),
}


def exact(name: str, x, y) -> Fraction:
    """The score of the quantised inputs; exact for S2, S6 and S10, else to 2^-200."""
    with gmpy2.context(precision=300):
        value = DEFINITIONS[name](raw(x), raw(y))
        return Fraction(*map(int, value.as_integer_ratio()))


def tolerance(name: str, truth: Fraction, n: int, max_norm: float = EDGE) -> float:
    """What a score may be off by: the errors of its steps, added up.

    Each of n coordinates of a normalised vector is off by less than 2^-24, beside the relative error of its
    length, 2^-16.3 for S1 and 2^-17.3 for the others.
    """
    size, dither, apart = abs(float(truth)), 2.0**-24, 2 * 2**-17.3 + 2 * n**0.5 * 2**-24
    return {
        "S1": 2 * 2**-16.3 + 2 * n * dither,
        "S2": 0.0,
        "S3": apart + size * 2**-18.1,
        "S4": size * (2**-30 if max_norm >= 2 else 2**-18.1),
        "S5": 2 * size**0.5 * apart + apart**2 + dither,
        "S6": 0.0,
        "S7": apart + dither,
        "S8": 2 * 2**-17.3 + 5 * 2**-22 + dither,
        "S9": 2 * 2**-17.3 + 5 * 2**-22 + dither,
        "S10": 0.0,
    }[name]


def assert_close(name, value, x, y, max_norm=EDGE):
    """Every row within the tolerance, and for modest lengths within 2^-14, absolute or relative."""
    for one, a, b in zip(np.atleast_1d(value).tolist(), np.atleast_2d(x), np.atleast_2d(y), strict=True):
        truth = exact(name, a, b)
        error = float(abs(Fraction(one) - truth))
        rounding = abs(float(truth)) * 2**-53  # of the number that is returned
        assert error <= tolerance(name, truth, len(a), max_norm) + rounding
        if len(a) <= 256:
            assert error <= 2**-14 * max(1.0, abs(float(truth)))


# -- pairs ----------------------------------------------------------------------------------------------


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def pairs(n: int, seed: int = 0):
    """Two matrices whose rows are pairs: random, close, opposite, zero, one-hot, at the ends of the range."""
    generator = np.random.default_rng([n, seed])
    a, b, c = _unit(generator.standard_normal((3, n)))
    first, last, zero = np.eye(n)[0], np.eye(n)[-1], np.zeros(n)
    spread = np.full(n, EDGE / n**0.5) * (1 - 1e-9)
    signs = generator.choice([-1.0, 1.0], n)
    rows = [
        (a, b),
        (a, a + 1e-3 * c),
        (a, a + 2 * UNIT * c),
        (a, a),
        (a, -a),
        (1000 * a, 3 * b),
        (10 * generator.standard_normal(n), 10 * generator.standard_normal(n)),
        (EDGE * (1 - 1e-9) * a, UNIT * 3 * b),
        (zero, b),
        (a, zero),
        (zero, zero),
        (first, first),
        (first, last),
        (first, -first),
        (EDGE * first, EDGE * first),
        (EDGE * first, -EDGE * first),
        (EDGE * first, EDGE * last),
        (EDGE * last, UNIT * last),
        (spread, spread * signs),
        (spread * signs, -spread * signs),
        (UNIT * first, UNIT * first),
        (UNIT * first, -UNIT * last),
        (np.full(n, UNIT), UNIT * last),
        (first + UNIT * last, first),
    ]
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


# -- the scores -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("security", [*SECURITIES, "clear"])
@pytest.mark.parametrize("n", [1, 2, 7, 16, 256])
@pytest.mark.parametrize("name", SCORES)
def test_a_score_is_as_close_to_the_true_one_as_stated(name, n, security):
    x, y = pairs(n)
    score = SCORES[name]
    value = run_clear(score, x, y).value if security == "clear" else run_local(score, x, y, security).value
    assert_close(name, value, x, y)


@pytest.mark.parametrize("name", SCORES)
def test_the_clear_reading_rounds_far_less(name):
    """To 2^-20 where the secure ones dither; so it is their oracle up to that dither."""
    for n in (1, 2, 7, 64):
        x, y = pairs(n, seed=1)
        for one, a, b in zip(run_clear(SCORES[name], x, y).value.tolist(), x, y, strict=True):
            truth = exact(name, a, b)
            scale = max(1.0, abs(float(truth))) if name not in EXACT else abs(float(truth)) * 2**-33
            assert abs(Fraction(one) - truth) <= scale * (2**-20 + 2 * n * 2**-24)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("max_norm", [UNIT, 1.0, 1.9, 1000.0])
@pytest.mark.parametrize("name", SCORES)
def test_smaller_largest_norms(name, max_norm, security):
    """Short masks, short keys, and other square roots: the same scores."""
    x, y = (side / EDGE * max_norm * (1 - 1e-9) for side in pairs(5, seed=2))
    fitting = np.array(pairs(5, seed=3))
    fitting *= np.minimum(1.0, max_norm / np.maximum(np.linalg.norm(fitting, axis=-1), 1e-9))[..., None]
    x, y = np.concatenate([x, fitting[0]]), np.concatenate([y, fitting[1]])
    value = run_local(SCORES[name].within(max_norm), x, y, security).value
    assert_close(name, value, x, y, max_norm)


@st.composite
def vectors(draw, largest: float = 2.0**20, lengths=(1, 2, 3, 16, 33)):
    n = draw(st.sampled_from(lengths))
    element = st.floats(-largest, largest, allow_nan=False, width=64)
    return [draw(st.lists(element, min_size=n, max_size=n)) for _ in range(2)]


@st.composite
def extreme_vectors(draw):
    """Coordinates of one or a few units beside some that fill the range, and zeros."""
    n = draw(st.integers(1, 4))
    top = EDGE / n**0.5 * (1 - 1e-9)
    size = st.one_of(
        st.sampled_from([0.0, UNIT, 2 * UNIT, 3 * UNIT, 0.5, 1.0, top]),
        st.floats(-16, 21).map(lambda power: 2.0**power),
    )
    element = st.tuples(size, st.sampled_from([1, -1])).map(lambda pair: pair[0] * pair[1] / n**0.5)
    x = draw(st.lists(element, min_size=n, max_size=n))
    other = st.lists(element, min_size=n, max_size=n)
    near = st.integers(0, n - 1).map(lambda i: [a + UNIT * (i == j) for j, a in enumerate(x)])
    return x, draw(st.one_of(other, near, st.just(x), st.just([-a for a in x])))


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
@settings(max_examples=12, deadline=None)
@given(pair=extreme_vectors())
def test_any_pair_has_its_score(name, security, pair):
    assert_close(name, run_local(SCORES[name], *pair, security).value, *pair)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", EXACT)
@settings(max_examples=25, deadline=None)
@given(pair=vectors(largest=2.0**19))
def test_a_score_without_rounding_is_exact(name, security, pair):
    x, y = pair
    truth = exact(name, x, y)
    assert run_local(SCORES[name], x, y, security).value == float(truth)
    assert run_clear(SCORES[name], x, y).value == float(truth)


@pytest.mark.parametrize("name", SCORES)
def test_only_scores_without_rounding_are_the_same_in_every_run(name):
    x, y = pairs(16)
    seen = {run_local(SCORES[name], x, y).value.tobytes() for _ in range(3)}
    assert (len(seen) == 1) is (name in EXACT)


ZERO = np.zeros(3)


@pytest.mark.parametrize("security", [*SECURITIES, "clear"])
@pytest.mark.parametrize(
    ("name", "one_zero", "both_zero"),
    [("S1", 1, 0), ("S3", 1, 0), ("S5", 1, 0), ("S7", 0, 0), ("S8", 0, 0), ("S9", 0, 0)],
)
def test_what_normalises_takes_the_zero_vector_as_it_is(name, one_zero, both_zero, security):
    def score(x, y):
        if security == "clear":
            return run_clear(SCORES[name], x, y).value
        return run_local(SCORES[name], x, y, security).value

    some = [0.0, -300.0, 0.25]
    assert score(ZERO, ZERO) == both_zero
    for value in (score(some, ZERO), score(ZERO, some)):
        assert abs(value - one_zero) < 2**-15
        assert one_zero or value == 0


LARGE = [
    ("S1", 8192, "malicious"),
    ("S1", 100_000, "semi-honest"),
    ("S2", 8192, "malicious"),
    ("S2", 100_000, "semi-honest"),
    ("S4", 8192, "semi-honest"),
    ("S4", 100_000, "malicious"),
    ("S6", 100_000, "malicious"),
    ("S6", 100_000, "semi-honest"),
    ("S7", 8192, "semi-honest"),
    ("S7", 100_000, "malicious"),
    ("S9", 8192, "malicious"),
    ("S9", 100_000, "semi-honest"),
    ("S10", 100_000, "malicious"),
    ("S10", 100_000, "semi-honest"),
]


@pytest.mark.parametrize(("name", "n", "security"), LARGE)
def test_long_descriptors(name, n, security):
    generator = np.random.default_rng(n)
    x, y = _unit(generator.standard_normal((2, n)))
    for max_norm in (1.0,) if name in ("S1", "S2") else (1.0, EDGE):
        value = run_local(SCORES[name].within(max_norm), x, y, security).value
        truth = exact(name, x, y)
        error = abs(value - float(truth))
        assert error <= tolerance(name, truth, n, max_norm) + float(truth) * 2**-53
        # Dithers of so many coordinates cancel, unless the vectors are alike.
        assert error <= 2**-14 * max(1.0, float(truth))


def test_the_dithers_of_two_alike_vectors_add_up_in_s1():
    """A third of 2^-24 a coordinate on average; less than one always."""
    n = 8192
    x = _unit(np.random.default_rng(1).standard_normal(n))
    value = run_local(SCORES["S1"].within(1.0), x, x, "semi-honest").value
    assert 0 < value - 2 * 2**-16.3 < n * 2**-24 / 2


# -- the candidate bit ----------------------------------------------------------------------------------


def expected_bit(score, truth, threshold):
    return truth >= Fraction(threshold) if score.similarity else truth <= Fraction(threshold)


@pytest.mark.parametrize("security", [*SECURITIES, "clear"])
@pytest.mark.parametrize("name", SCORES)
def test_a_candidate_bit_is_right_wherever_the_score_is_not_at_the_threshold(name, security):
    """Thresholds on either side of a pair's score: right for it, and for all that are not close to it."""
    score = SCORES[name]
    x, y = (side[[0, 1, 3, 5, 9, 14, 15, 18, 21]] for side in pairs(6))
    truths = [exact(name, a, b) for a, b in zip(x, y, strict=True)]
    slack = [Fraction(tolerance(name, truth, 6)) + Fraction(1, 1 << 32) for truth in truths]
    thresholds = [0.0, 1e300, -1e300]
    for i in range(3):
        thresholds += [float(truths[i] + slack[i] * Fraction(1.01) * side) for side in (-1, 1)]
    for threshold in thresholds:
        program = is_candidate(score, threshold)
        clear = security == "clear"
        bits = (run_clear(program, x, y) if clear else run_local(program, x, y, security)).value
        assert bits.dtype == np.bool_
        clear_cut = 0
        for bit, truth, near in zip(bits.tolist(), truths, slack, strict=True):
            if abs(truth - Fraction(threshold)) > near:
                clear_cut += 1
                assert bit is expected_bit(score, truth, threshold)
        assert clear_cut > len(x) // 3


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
@settings(max_examples=6, deadline=None)
@given(pair=extreme_vectors(), threshold=st.floats(-2.0, 2.0))
def test_a_candidate_bit_of_any_pair(name, security, pair, threshold):
    score, truth = SCORES[name], exact(name, *pair)
    bit = run_local(is_candidate(score, threshold), *pair, security).value
    if abs(truth - Fraction(threshold)) > tolerance(name, truth, len(pair[0])):
        assert bit is expected_bit(score, truth, threshold)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", EXACT)
@settings(max_examples=25, deadline=None)
@given(pair=vectors(largest=50.0), offset=st.integers(-5, 5))
def test_a_candidate_bit_is_exact_at_the_threshold(name, security, pair, offset):
    x, y = pair
    score = SCORES[name]
    truth = exact(name, x, y)
    threshold = float(
        truth + Fraction(offset, 1 << (18 if name == "S2" else 34))
    )  # between the grid's points
    expected = expected_bit(score, truth, threshold)
    assert run_local(is_candidate(score, threshold), x, y, security).value is expected


@pytest.mark.parametrize("name", SCORES)
def test_the_ends_of_the_range_are_decided_alike(name):
    """A similarity of 1 and a distance of 0 with a threshold a little below and above them."""
    score = SCORES[name]
    x = _unit(np.array([[1.0, 2.0, -3.0], [5.0, 0.0, 0.1]]))
    margin = 2**-13
    yes, no = (1 - margin, 1 + margin) if score.similarity else (margin, -margin)
    assert run_local(is_candidate(score, yes), x, x).value.all()
    assert not run_local(is_candidate(score, no), x, x).value.any()


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("n", [1, 7, 8192, 100_000])
def test_odd_lengths_work(n, security):
    generator = np.random.default_rng(n)
    x, y = _unit(generator.standard_normal((2, n)))
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
            expected = expected_bit(score, exact(score.name, x, y), threshold)
            assert run_local(is_candidate(score, threshold), x, y, security).value is expected


# -- tiles ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
def test_all_pairs_are_the_single_pairs(name, security):
    score = SCORES[name]
    generator = np.random.default_rng(5)
    x, y = generator.standard_normal((3, 10)), generator.standard_normal((4, 10))
    y[1], y[2] = x[2], 0.0
    grid = run_local(score, x[:, None], y[None], security).value
    assert grid.shape == (3, 4)
    for a, row in zip(x, grid, strict=True):
        assert_close(name, row, np.tile(a, (4, 1)), y)
    if name in EXACT:
        single = [[run_local(score, a, b, security).value for b in y] for a in x]
        assert np.array_equal(grid, single)
    threshold = 0.77 if score.similarity else 1.03
    bits = run_local(is_candidate(score, threshold), x[:, None], y[None], security).value
    assert bits.dtype == np.bool_
    truths = [[exact(name, a, b) for b in y] for a in x]
    assert bits.tolist() == [[expected_bit(score, truth, threshold) for truth in row] for row in truths]


@pytest.mark.parametrize("name", SCORES)
@pytest.mark.parametrize(
    "shapes", [((1, 1, 4), (1, 3, 4)), ((2, 1, 4), (1, 1, 4)), ((4,), (2, 3, 4))], ids=str
)
def test_one_against_many(shapes, name):
    generator = np.random.default_rng(6)
    x, y = (generator.standard_normal(shape) for shape in shapes)
    value = run_local(SCORES[name], x, y).value
    full = np.broadcast_shapes(*shapes)
    assert value.shape == full[:-1]
    a, b = (np.broadcast_to(side, full).reshape(-1, 4) for side in (x, y))
    assert_close(name, value.reshape(-1), a, b)


# -- what is refused ------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("security", [*SECURITIES, "clear"])
@pytest.mark.parametrize("name", SCORES)
def test_a_vector_beyond_the_largest_norm_is_refused_by_every_score(name, security):
    good = np.array([0.6, 0.8])
    for max_norm, says in ((EDGE, "4194304"), (1.0, r"above 1\.0"), (0.25, r"above 0\.25")):
        for program in (SCORES[name].within(max_norm), is_candidate(SCORES[name].within(max_norm), 0.5)):
            bad = good * max_norm * 1.001
            for x, y in ((bad, good * max_norm), (good * max_norm, bad)):
                with pytest.raises(ValueError, match=says):
                    if security == "clear":
                        run_clear(program, x, y)
                    else:
                        run_local(program, x, y, security)


@pytest.mark.parametrize("name", SCORES)
def test_lengths_that_differ_are_refused(name):
    for x, y in (([1.0, 2.0], [1.0, 2.0, 3.0]), ([1.0], [1.0, 2.0]), ([1.0, 2.0], [1.0])):
        with pytest.raises(ValueError, match="equal length"):
            run_local(SCORES[name], x, y)


@pytest.mark.parametrize("threshold", [np.nan, np.inf, -np.inf])
def test_a_threshold_must_be_finite(threshold):
    with pytest.raises(ValueError, match="finite"):
        is_candidate(S10, threshold)
