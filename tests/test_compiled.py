"""Compiled code against the ordinary reading: every score, the same frames, values, costs and MAC check."""

import numpy as np
import pytest
from compiled_helpers import SECURITIES, deal, hold_honest, unit_vectors

from protocols import is_candidate
from protocols.scores import S2, S6, S10, SCORES

ALL = list(SCORES.values())
SMALL, AROUND_FEW, LONG = (1, 2, 16), (63, 64), 1536
THRESHOLD = {True: 0.3, False: 1.1}

any_score = pytest.mark.parametrize("score", ALL, ids=list(SCORES))


def candidate(score):
    return is_candidate(score.within(1.0), THRESHOLD[score.similarity])


def programs(score):
    return score.within(1.0), candidate(score)


@any_score
@pytest.mark.parametrize("n", [7, 65])
def test_a_score_and_its_decision_are_compiled_as_they_are_read(score, n):
    for security in SECURITIES:
        opened, decided = (hold_honest(deal(one, unit_vectors(n), security)) for one in programs(score))
        assert decided == (
            opened >= THRESHOLD[True] if score.similarity else opened <= THRESHOLD[False]
        ) or opened == pytest.approx(THRESHOLD[score.similarity], abs=1e-3)


@any_score
@pytest.mark.parametrize("n", [*SMALL, *AROUND_FEW, 200])
def test_length_changes_nothing(score, n):
    """Numbers become arrays above 64: of the vectors, of what the parties open, and of neither."""
    first, second = programs(score) if n % 2 else programs(score)[::-1]
    hold_honest(deal(first, unit_vectors(n, seed=n), "malicious"))
    hold_honest(deal(second, unit_vectors(n, seed=n + 1), "semi-honest"))


@pytest.mark.parametrize("score", [S2, S6, S10], ids=lambda score: score.name)
def test_a_long_descriptor(score):
    hold_honest(deal(score.within(1.0), unit_vectors(LONG), "malicious"))
    hold_honest(deal(candidate(score), unit_vectors(LONG), "semi-honest"))


@any_score
def test_either_party_may_run_either(score):
    for security, program in zip(SECURITIES, programs(score), strict=True):
        job = deal(program, unit_vectors(20, seed=3), security)
        values = {
            repr(job.together((first, second)))
            for first in (None, job.codes[0])
            for second in (None, job.codes[1])
        }
        assert len(values) == 1


@pytest.mark.parametrize("n", [3, 80])
@pytest.mark.parametrize("kind", ["zero", "one coordinate", "alike", "opposite"])
def test_vectors_at_the_ends_of_their_range(n, kind):
    x = np.zeros(n)
    if kind == "one coordinate":
        x[n // 2] = 1.0
    elif kind != "zero":
        x[:] = (1 - 1e-12) / np.sqrt(n)
    y = -x if kind == "opposite" else x
    for score in (S2, S6, S10):
        for security in SECURITIES:
            hold_honest(deal(score.within(1.0), (x, y), security))


def test_one_code_serves_every_job():
    jobs = [deal(S6.within(1.0), unit_vectors(9, seed=seed), "malicious") for seed in range(4)]
    for job in jobs[1:]:
        job.__dict__["codes"] = jobs[0].codes
    assert len({hold_honest(job) for job in jobs}) == 4


@pytest.mark.parametrize("n", [5, 70])
@pytest.mark.parametrize("score", SCORES.values(), ids=list(SCORES))
def test_a_tile_of_one_pair_is_a_single_comparison(score, n):
    """What the dealer deals by default: shapes (1, 1, N)."""
    data = tuple(one.reshape(1, 1, n) for one in unit_vectors(n))
    for security in SECURITIES:
        for program in (score.within(1.0), is_candidate(score.within(1.0), 0.5)):
            hold_honest(deal(program, data, security))
