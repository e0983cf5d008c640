"""Beaver triples for programs that the dealer was not told of."""

import numpy as np
import pytest

from protocols import is_candidate
from protocols.scores import S10
from protocols.textbook import dot_with_scalar_triples, dot_with_vector_triple
from spdz import MacCheckFailed, Stock, TapeExhausted, TapeMismatch, beaver_multiply, run_clear, run_local

X, Y = np.array([0.5, -1.25, 3.0]), np.array([2.0, 0.75, -0.5])
STOCK = Stock(inputs=(10, 10), scalar_triples=12, vector_triples={3: 2, 5: 1})


async def mixed(engine, x, y):
    """A program that nobody dealt for: (x . y) + sum((x + y) * x)."""
    square = await beaver_multiply(x + y, x)
    return await dot_with_vector_triple(engine, x, y) + square.sum()


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("program", [dot_with_vector_triple, dot_with_scalar_triples, mixed])
def test_any_beaver_program_runs_on_a_stock(program, security):
    outcome = run_local(program, X, Y, security, stock=STOCK)
    assert outcome.value == run_clear(program, X, Y).value
    assert outcome.stats[0].correlations == run_local(program, X, Y, security).stats[0].correlations


@pytest.mark.parametrize(
    ("stock", "says"),
    [
        (Stock((2, 3), vector_triples={3: 1}), "input masks are used up: 2 dealt"),
        (Stock((3, 3), vector_triples={4: 1}), "no vector triples of length 3"),
        (Stock((3, 3), vector_triples={3: 0}), "vector triples of length 3 are used up"),
    ],
)
def test_a_stock_that_is_too_small_says_what_is_missing(stock, says):
    with pytest.raises(TapeExhausted, match=says):
        run_local(dot_with_vector_triple, X, Y, stock=stock)


@pytest.mark.parametrize("program", [S10, is_candidate(S10, 0.5)])
def test_a_program_that_needs_more_than_triples_is_refused(program):
    with pytest.raises(TapeMismatch, match="stock"):
        run_local(program, X, Y, stock=STOCK)


@pytest.mark.parametrize("round_", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("sender", [0, 1])
def test_a_changed_frame_is_caught_on_a_stock_too(round_, sender):
    def tamper(number, who, frame):
        return bytes([frame[0] ^ 1]) + frame[1:] if (number, who) == (round_, sender) else frame

    with pytest.raises(MacCheckFailed):
        run_local(dot_with_vector_triple, X, Y, stock=STOCK, tamper=tamper)
