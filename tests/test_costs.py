"""The paper's cost table, asserted against the engine's own counters."""

import numpy as np
import pytest

from protocols import is_candidate
from protocols.scores import S6, S10, SCORES
from protocols.textbook import dot_with_scalar_triples, dot_with_vector_triple
from spdz import Engine, Stats, Value, beaver_multiply, measure, run_local

N = 6
X, Y = np.linspace(-1, 1, N), np.linspace(0.5, 2, N)


async def share(engine: Engine, x: Value, y: Value) -> Value:
    return engine.shared(x)


async def add(engine: Engine, x: Value, y: Value) -> Value:
    return engine.shared(x) + engine.shared(y)


async def multiply(engine: Engine, x: Value, y: Value) -> Value:
    return await beaver_multiply(engine.shared(x), engine.shared(y))


def semi_honest(program, x, y) -> Stats:
    return run_local(program, x, y, "semi-honest").stats[0]


def beyond(base: Stats, stats: Stats) -> tuple[int, int]:
    """Rounds and elements of an operation without its inputs and its output."""
    return stats.rounds - base.rounds, stats.field_elements_sent - base.field_elements_sent


def test_sharing_costs_one_round_and_one_element():
    stats = semi_honest(share, [1.5], [2.5])
    assert (stats.rounds, stats.field_elements_sent) == (1 + 1, 1 + 1)  # and the output: one of each


def test_addition_costs_nothing():
    base = semi_honest(share, X, Y)
    stats = semi_honest(add, X, Y)
    assert beyond(base, stats) == (0, 0)
    assert set(stats.correlations) == {"input mask"}


def test_multiplication_costs_one_round_two_elements_one_scalar_triple():
    base = semi_honest(share, [1.5], [2.5])
    stats = semi_honest(multiply, [1.5], [2.5])
    assert beyond(base, stats) == (1, 2)
    assert stats.correlations["scalar triple"] == 1


def test_naive_dot_costs_n_rounds_2n_elements_n_triples():
    stats = semi_honest(dot_with_scalar_triples, X, Y)
    assert (stats.rounds, stats.field_elements_sent) == (1 + N + 1, N + 2 * N + 1)
    assert stats.correlations["scalar triple"] == N


def test_efficient_dot_costs_one_round_2n_elements_one_vector_triple():
    stats = semi_honest(dot_with_vector_triple, X, Y)
    assert (stats.rounds, stats.field_elements_sent) == (1 + 1 + 1, N + 2 * N + 1)
    assert stats.correlations["vector triple"] == 1


def test_masked_input_dot_costs_one_round_and_n_elements_a_party():
    for stats in run_local(S10, X, Y, "semi-honest").stats:
        assert (stats.rounds, stats.field_elements_sent) == (1 + 1, N + 1)
        assert stats.correlations == {"input mask": 2 * N, "dot product": 1}


@pytest.mark.parametrize("score", [S6, S10], ids=lambda score: score.name)
@pytest.mark.parametrize(("security", "opened", "bit"), [("malicious", 3, 5), ("semi-honest", 2, 3)])
def test_rounds_of_a_score_and_of_a_candidate_bit(score, security, opened, bit):
    assert run_local(score, X, Y, security).stats[0].rounds == opened
    assert run_local(is_candidate(score, 1.0), X, Y, security).stats[0].rounds == bit


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize(
    "program",
    [
        *SCORES.values(),
        *(is_candidate(score, 0.5) for score in SCORES.values()),
        dot_with_vector_triple,
        dot_with_scalar_triples,
    ],
    ids=lambda program: getattr(program, "__name__", str(program)),
)
def test_the_meter_foresees_what_a_run_costs(program, security):
    plan = measure(program, (X.shape, Y.shape), security)
    for party, stats in enumerate(run_local(program, X, Y, security).stats):
        assert stats.rounds == plan.rounds
        assert stats.field_elements_sent == plan.elements_sent[party]
        assert stats.correlations == plan.correlations


def test_a_further_pair_costs_one_dealt_scalar_and_one_opened_element():
    one = measure(S10, ((1, 1, 1000), (1, 1, 1000)), "malicious")
    grid = measure(S10, ((4, 1, 1000), (1, 5, 1000)), "malicious")
    assert grid.elements_sent == (4 * 1000 + 20, 5 * 1000 + 20)
    assert grid.correlations["dot product"] == 20
    assert grid.rounds == one.rounds


def test_at_8192_dimensions_a_party_sends_at_most_135_kilobytes():
    x = np.full(8192, 1 / 90.6)
    assert max(stats.bytes_sent for stats in run_local(S10, x, x).stats) <= 135_000
