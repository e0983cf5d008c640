"""An insider may choose its input, also one out of range: another eps is another input, and no failed check.

(Out of range as far as words go, where words are sent: each word of the interval is some input.) It must then
stand by it: one that goes on with the input it had before is caught like any other liar.
"""

from itertools import product

import numpy as np
import pytest
from insider_programs import ALL, X, Y, dealt
from lies import element

from spdz import run_clear
from spdz.arithmetic.field import P
from spdz.readings.program import max_norm
from spdz.values.input_mask import LONG

OTHER = np.array([9000, -5000, 12345])
"""Added to an input, in raw units; its norm stays within bounds."""

any_program = pytest.mark.parametrize("name", ALL)


def other(job, own):
    """Little enough that a word leaves the interval once in 2^36 times."""
    return OTHER


def far(job, own):
    """Added to an input: as much as the masks of a stock allow, or words with another highest bit."""
    if job.word_bits == LONG:
        return OTHER << 40
    half = 1 << (job.word_bits - 1)
    return np.array([half if word < half else -half for word in own])


def with_another_input(name, evil, shift):
    """An insider whose input is another one by ``shift(job, own)``: what it sends, and what it goes on with.

    Returns:
        The duel, and what was added.
    """
    job, added = dealt(name), np.zeros(3, dtype=np.int64)

    def lie(number, own, theirs):
        if number:
            return own
        added[:] = shift(job, own)
        return [(a + int(d)) % P for a, d in zip(own, added, strict=True)]

    async def shifted(engine, x, y):
        values = [x, y]
        values[evil] = values[evil].plus_raw(added)
        values[evil].bound = (x, y)[evil].bound
        return await ALL[name](engine, *values)

    shifted.max_norm = max_norm(ALL[name])
    return job.duel(evil, lie, program=shifted), added


@any_program
def test_another_eps_is_another_input(name):
    for evil in (0, 1):
        (duel, added), inputs = with_another_input(name, evil, other), [X, Y]
        inputs[evil] = inputs[evil] + added / 2**16
        assert duel.lied and duel.accepted, duel
        assert duel.value[0] == pytest.approx(run_clear(ALL[name], *inputs).value, rel=2**-14, abs=2**-14)


@any_program
def test_an_input_far_out_of_range_is_no_failed_check(name):
    for evil in (0, 1):
        duel, _ = with_another_input(name, evil, far)
        assert duel.lied and duel.accepted, duel
        assert duel.sent == dealt(name).honest.sent


SAID = {
    "plus 1": lambda own, bits: own + 1,
    "minus 12345": lambda own, bits: own - 12345,
    "another highest bit": lambda own, bits: own ^ 1 << (bits - 1) if bits < LONG else own + (1 << 126),
}


UNSEEN = ("bits of inputs", "another highest bit")
"""A sign of b bits looks at its input modulo 2^b alone, where this lie is none."""
SEEN_LATER = ("decided", "another highest bit")
"""The same of its first comparison; what it then masks of the first input is opened and checked."""


@any_program
def test_an_insider_that_does_not_stand_by_its_input_is_caught(name):
    job = dealt(name)
    for evil, (i, (how, say)) in product((0, 1), enumerate(SAID.items())):
        lie = element(0, i, lambda own, theirs, e: say(own, job.word_bits))  # noqa: B023
        if (name, how) == UNSEEN or ((name, how) == SEEN_LATER and evil == 1):
            assert np.array_equal(job.duel(evil, lie).value, job.honest.value)
            continue
        if (name, how) == SEEN_LATER:
            assert job.duel(evil, lie).caught
            continue
        assert job.try_lie(evil, 0, lie, what=f"{how}, {i}")


@pytest.mark.parametrize("evil", [0, 1])
def test_the_result_is_then_that_of_the_input_chosen(evil):
    duel, added = with_another_input("dot", evil, far)
    mine, theirs = dealt("dot").data[0][:: 1 - 2 * evil]
    exact = sum((int(a) + int(d)) * int(b) for a, d, b in zip(mine, added, theirs, strict=True))
    assert duel.value == [exact / 2**32]
