"""An insider may choose its input, also one out of range: another eps is another input, and no failed check.

It must then stand by it: one that goes on with the input it had before is caught like any other liar.
"""

from itertools import product

import numpy as np
import pytest
from insider_programs import ALL, NORM, X, Y, dealt
from lies import ELEMENT, element

from spdz import run_clear
from spdz.arithmetic.field import P

OTHER = np.array([9000, -5000, 12345])
"""Added to an input, in raw units; its norm stays within bounds."""
FAR = OTHER << 40

any_program = pytest.mark.parametrize("name", ALL)


def with_another_input(name, evil, shift):
    """An insider whose input is another one by ``shift``: what it sends, and what it goes on with."""

    def lie(number, own, theirs):
        return own if number else [(a + int(d)) % P for a, d in zip(own, shift, strict=True)]

    async def shifted(engine, x, y):
        values = [x, y]
        values[evil] = values[evil].plus_raw(shift)
        values[evil].bound = (x, y)[evil].bound
        return await ALL[name](engine, *values)

    shifted.max_norm = NORM
    return dealt(name).duel(evil, lie, program=shifted)


@any_program
def test_another_eps_is_another_input(name):
    for evil in (0, 1):
        duel, inputs = with_another_input(name, evil, OTHER), [X, Y]
        inputs[evil] = inputs[evil] + OTHER / 2**16
        assert duel.lied and duel.accepted, duel
        assert duel.value[0] == pytest.approx(run_clear(ALL[name], *inputs).value, rel=2**-14, abs=2**-14)


@any_program
def test_an_input_far_out_of_range_is_no_failed_check(name):
    for evil in (0, 1):
        duel = with_another_input(name, evil, FAR)
        assert duel.lied and duel.accepted, duel
        assert duel.sent == dealt(name).honest.sent


@any_program
def test_an_insider_that_does_not_stand_by_its_input_is_caught(name):
    ways = ("plus 1", "plus a random number", "another highest bit")
    for evil, (i, how) in product((0, 1), enumerate(ways)):
        assert dealt(name).try_lie(evil, 0, element(0, i, ELEMENT[how], 12345 << 70), what=f"{how}, {i}")


@pytest.mark.parametrize("evil", [0, 1])
def test_the_result_is_then_that_of_the_input_chosen(evil):
    mine, theirs = dealt("dot").data[0][:: 1 - 2 * evil]
    exact = sum((int(a) + int(d)) * int(b) for a, d, b in zip(mine, FAR, theirs, strict=True))
    assert with_another_input("dot", evil, FAR).value == [exact / 2**32]
