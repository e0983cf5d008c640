"""Every score in a gallery: dealt, filled and compared gives what the clear reading gives."""

from contextlib import ExitStack

import numpy as np
import pytest
from gallery_memory import TwoTapes, run_gallery

from protocols import Score, is_candidate
from protocols.score import Of
from protocols.scores import S1, S2, S6, S8, S10, SCORES, rounded
from spdz import dot, l2_normalised, mask, run_clear, run_local
from spdz.foundations.errors import Unsent
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import measure_gallery
from spdz.readings.plans import constants

SECURITIES = ["malicious", "semi-honest"]
EXACT = ("S2", "S6", "S10")
DIM = 6
ERROR = 2.0**-14  # of the scores that round (docs/scores.md)
SHAPES = [(1, 1), (1, 7), (5, 3), (17, 2)]
WEIGHTS = np.array([3, 2, 1, 1, 0, 5])


def vectors(rows, columns, seed=0, norm=1.0):
    """Vectors of norm ``norm`` (and shorter), some of one party close to some of the other."""
    rng = np.random.default_rng([rows, columns, seed])
    x, y = rng.standard_normal((rows, DIM)), rng.standard_normal((columns, DIM))
    y[0] = x[-1] + 0.1 * y[0]
    x, y = (norm * v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, y))
    x[::3] *= 0.7
    return x, y


def clear(program, x, y):
    return run_clear(program, x[:, None], y[None]).value


def thresholds(scores, count=2):
    """In the widest gaps between scores, and beyond all of them."""
    known = np.unique(np.concatenate([scores.ravel(), [scores.min() - 0.1, scores.max() + 0.1]]))
    widest = np.argsort(np.diff(known))[::-1][:count]
    return [float((known[i] + known[i + 1]) / 2) for i in widest]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("name", SCORES)
def test_scores_of_a_gallery_are_the_clear_ones(tmp_path, name, shape, security):
    score = SCORES[name].within(1.0)
    x, y = vectors(*shape)
    truth = clear(score, x, y)
    opened = run_gallery(tmp_path, Terms(score, DIM, security), x, y)
    assert opened.shape == shape
    assert np.abs(opened - truth).max() <= (0 if name in EXACT else ERROR)


@pytest.mark.parametrize("resolution", [16, None])
@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("shape", [(5, 3), (17, 2)], ids=str)
@pytest.mark.parametrize("name", SCORES)
def test_bits_of_a_gallery_are_the_clear_ones(tmp_path, name, shape, security, resolution):
    score = SCORES[name].within(1.0)
    x, y = vectors(*shape, seed=1)
    truth = clear(score, x, y)
    for number, threshold in enumerate(thresholds(truth)):
        program = is_candidate(score, threshold)
        bits = run_gallery(tmp_path / str(number), Terms(program, DIM, security, resolution), x, y)
        assert bits.dtype == np.bool_
        assert np.array_equal(bits, truth >= threshold if score.similarity else truth <= threshold)


@pytest.mark.parametrize("name", EXACT)
def test_without_a_resolution_a_score_at_the_threshold_is_decided_exactly(tmp_path, name):
    score = SCORES[name].within(1.0)
    x, y = vectors(3, 4)
    truth = clear(score, x, y)
    at = float(truth[1, 2])
    for step, expected in (
        (0.0, True),
        (2.0**-33, score.similarity is False),
        (-(2.0**-33), score.similarity),
    ):
        program = is_candidate(score, at + step)
        bits = run_gallery(tmp_path / str(step), Terms(program, DIM, resolution=None), x, y)
        assert bits[1, 2] == expected, step


@pytest.mark.parametrize("name", ["S3", "S4", "S6", "S8", "S10"])
def test_norms_other_than_1(tmp_path, name):
    score = SCORES[name].within(40.0)
    x, y = vectors(3, 4, norm=39.0)
    truth = clear(score, x, y)
    opened = run_gallery(tmp_path, Terms(score, DIM, min_norm=20.0), x, y)
    assert np.abs(opened - truth).max() <= (0 if name in EXACT else ERROR)


@pytest.mark.parametrize("name", ["S1", "S3", "S5", "S7", "S8", "S9"])
def test_a_zero_vector_is_what_it_is_in_a_job(tmp_path, name):
    score = SCORES[name].within(1.0)
    x, y = vectors(2, 3)
    x[1], y[0] = 0, 0
    opened = run_gallery(tmp_path, Terms(score, DIM), x, y)
    assert np.abs(opened - clear(score, x, y)).max() <= ERROR


@pytest.mark.parametrize("score", [S6, S8, S10], ids=str)
@pytest.mark.parametrize("security", SECURITIES)
def test_strips_that_cut_tiles_give_what_the_whole_gives(tmp_path, score, security):
    """Slots are filled in several steps, and the rectangles compared begin and end inside tiles."""
    score, (x, y) = score.within(1.0), vectors(20, 19)
    truth = clear(score, x, y)
    for attempt in range(5):
        with ExitStack() as stack:
            tapes = TwoTapes(stack, tmp_path / str(attempt), Terms(score, DIM, security), (20, 19))
            try:
                rows, columns = tapes.fill(0, x[:4]), tapes.fill(1, y[:19])
                first = tapes.compare(rows, columns)
                rest = tapes.compare(tapes.fill(0, x[4:], start=4), columns, at=(4, 0))
            except Unsent:
                continue
            assert np.abs(np.concatenate([first, rest]) - truth).max() <= ERROR
            return
    raise AssertionError("no mask suits")


# -- a score of one's own -----------------------------------------------------------------------------------


async def weigh(engine, vectors):
    (hat,) = await l2_normalised(vectors * WEIGHTS)
    return (hat,)


async def compare_weighed(engine, x, y):
    (_, of_x), (_, of_y) = x, y
    return await rounded(dot(of_x, of_y))


async def weighted_cosine(engine, x, y):
    return await rounded(dot(*await l2_normalised(x * WEIGHTS, y * WEIGHTS)))


STEPS = Score("W", "weighted cosine", True, max_norm=1.0, prepare=weigh, compare=compare_weighed)
FORMULA = Score("W", "weighted cosine", True, weighted_cosine, max_norm=1.0)
BOTH = Score(
    "W", "weighted cosine", True, weighted_cosine, max_norm=1.0, prepare=weigh, compare=compare_weighed
)


@pytest.mark.parametrize("score", [STEPS, BOTH], ids=["in steps", "formula and steps"])
@pytest.mark.parametrize("security", SECURITIES)
def test_a_score_of_ones_own_in_a_gallery(tmp_path, score, security):
    x, y = vectors(5, 3)
    truth = clear(FORMULA, x, y)
    opened = run_gallery(tmp_path / "score", Terms(score, DIM, security), x, y)
    assert np.abs(opened - truth).max() <= ERROR
    (threshold,) = thresholds(truth, 1)
    bits = run_gallery(tmp_path / "bit", Terms(is_candidate(score, threshold), DIM, security), x, y)
    assert np.array_equal(bits, truth >= threshold)


@pytest.mark.parametrize("security", SECURITIES)
def test_steps_alone_are_a_formula_as_well(security):
    x, y = vectors(5, 5)
    truth = run_clear(FORMULA, x, y).value
    assert np.abs(run_local(STEPS, x, y, security).value - truth).max() <= ERROR
    assert np.array_equal(run_local(is_candidate(STEPS, 0.3), x, y, security).value, truth >= 0.3)


def test_a_formula_that_computes_on_one_vector_says_where_that_belongs():
    with pytest.raises(ValueError, match="`prepare` step"):
        measure_gallery(Terms(FORMULA, DIM))


@pytest.mark.parametrize("name", SCORES)
def test_nothing_that_belongs_to_one_slot_is_dealt_for_pairs(name):
    """A pair of a score that prepares is dealt far less than a job of one pair."""
    for program in (SCORES[name].within(1.0), is_candidate(SCORES[name].within(1.0), 0.5)):
        plan = measure_gallery(Terms(program, 64, proof=False))
        if name not in ("S1", "S2"):
            assert max(plan.pair.correction_bytes) < 6000


@pytest.mark.parametrize(
    ("name", "stored", "openings"),
    [
        ("S10", 320, 1),
        ("S6", 352, 1),
        ("S7", 336, 1),
        ("S5", 368, 1),
        ("S8", 512, 3),
        ("S9", 512, 3),
        ("S4", 3536, 4),
        ("S3", 4816, 4),
    ],
)
def test_a_pair_costs_what_the_page_of_scores_says(name, stored, openings):
    plan = measure_gallery(Terms(is_candidate(SCORES[name].within(1.0), 0.5), 1536))
    assert max(plan.pair.correction_bytes) == stored and plan.pair.openings == openings


async def _second(engine, vectors):
    return await mask(dot(vectors, vectors), fresh=True)


async def _none(engine, vectors):
    return None


def _plain(engine, vectors):
    return (vectors,)


@pytest.mark.parametrize("prepare", [_second, _none, _plain])
def test_what_prepare_must_return_is_said(prepare):
    score = Score("W", "", True, max_norm=1.0, prepare=prepare, compare=compare_weighed)
    with pytest.raises(TypeError, match="prepare"):
        measure_gallery(Terms(score, DIM))


async def _forgets(engine, x, y):
    dot(x[0], y[0])


@pytest.mark.parametrize("reveal", ["score", "bit"])
def test_what_compare_must_return_is_said(reveal):
    score = Score("W", "", True, max_norm=1.0, compare=_forgets)
    program = score if reveal == "score" else is_candidate(score, 0.5)
    with pytest.raises(TypeError, match="`return` is missing"):
        measure_gallery(Terms(program, DIM))


def test_a_score_without_its_steps_is_refused():
    with pytest.raises(TypeError, match="needs a formula"):
        Score("W", "", True)
    with pytest.raises(TypeError, match="compare="):
        Score("W", "", True, weighted_cosine, prepare=weigh)


def test_a_score_with_another_norm_keeps_its_steps():
    for score in (S1, S10, STEPS, BOTH):
        again = score.within(3.0).within(2.0)
        assert again.max_norm == 2.0
        assert (again.formula, again.prepare, again.compare) == (score.formula, score.prepare, score.compare)
    assert S1.compare == Of(S2.formula)


@pytest.mark.parametrize("name", SCORES)
def test_plans_of_our_scores_are_kept(name):
    """Nothing that a score is made of can change, so that a session need not read it for every run."""
    assert constants(SCORES[name]) is not None
    assert constants(is_candidate(SCORES[name], 0.5)) is not None
    assert constants(STEPS) is None
