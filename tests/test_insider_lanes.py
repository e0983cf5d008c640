"""Several jobs of one session run in lanes under one MAC check: lies in a lane and between lanes."""

import random
from functools import cache
from itertools import cycle, product

import pytest
from insider import Dealt
from insider_programs import PROGRAMS, STOCK, X, Y
from lies import ELEMENT, PAIR, cancelling, element, frame, pair

from spdz import parallel, run_clear
from spdz.arithmetic.field import P

PAIRS = ((X, Y), (Y, X), (X, X - Y / 8))
LANES = len(PAIRS)
NAMES = ["S10", "S2 candidate", "S4 candidate", "nonnegative", "beaver_dot", "side by side", "stock"]
UNEQUAL = ("S10", "S2", "S4 candidate")
"""The first two open their results at once, wait for the third, and have ended when it opens its own."""
either_party = pytest.mark.parametrize(("name", "evil"), list(product(NAMES, (0, 1))))


def program_of(name):
    return PROGRAMS["textbook S10" if name == "stock" else name]


@cache
def dealt(name):
    return Dealt(program_of(name), *PAIRS, stock=STOCK if name == "stock" else None)


def lanes_of(numbers):
    """An opening cut into its lanes, which are alike."""
    size = len(numbers) // LANES
    return [numbers[lane * size : (lane + 1) * size] for lane in range(LANES)]


def shares_of_lanes_swapped(own, theirs, e):
    first, second, third = lanes_of(own)
    return [*second, *first, *third]


def openings_of_lanes_swapped(own, theirs, e):
    first, second, third = lanes_of([a + b for a, b in zip(own, theirs, strict=True)])
    return [a - b for a, b in zip([*first, *third, *second], theirs, strict=True)]


def one_lane_in_all(own, theirs, e):
    first, _, _ = lanes_of(own)
    return first * LANES


def last_lane_alone(own, theirs, e):
    first, second, third = lanes_of(own)
    return [*first, *second, *(one + e for one in third)]


BETWEEN = (shares_of_lanes_swapped, openings_of_lanes_swapped, one_lane_in_all, last_lane_alone)


@either_party
def test_without_a_lie_every_lane_is_right(name, evil):
    for follow in (False, True):
        duel = dealt(name).duel(evil, follow=follow)
        assert duel.accepted and not duel.lied
        for value, inputs in zip(duel.value, PAIRS, strict=True):
            expected = run_clear(program_of(name), *inputs).value
            assert value == pytest.approx(expected, rel=2**-14, abs=2**-14)


@either_party
def test_a_lie_in_one_lane_or_between_lanes_is_caught_and_no_lane_has_a_result(name, evil):
    job, generator, pairs = dealt(name), random.Random(f"{name} {evil}"), cycle(PAIR)
    for number, size in job.honest.openings.items():
        e, lane = generator.randrange(1, P), size // LANES
        lies = {say.__name__: frame(number, say, e) for say in BETWEEN}
        for other in range(1, LANES):
            i, how = generator.randrange(lane), next(pairs)
            j = other * lane + i
            lies[f"in lane {other}"] = element(number, j, ELEMENT["plus 1"])
            lies[f"{how} in lanes 0, {other}"] = pair(number, i, j, PAIR[how], e)
            lies[f"cancelling in lanes 0, {other}"] = pair(number, i, j, PAIR["cancelling"], e)
            if number + 1 in job.honest.openings:
                j = other * (job.honest.openings[number + 1] // LANES)
                lies[f"taken back in lane {other} of the next"] = cancelling(number, i, number + 1, j, e)
        for what, lie in lies.items():
            job.try_lie(evil, number, lie, follow=generator.random() < 0.5, what=what)


class UnequalLanes(Dealt):
    """Jobs of several programs under one MAC check."""

    def __init__(self, names):
        first, *others = (PROGRAMS[name] for name in names)
        super().__init__(first, (X, Y))
        self._others = [Dealt(program, (X, Y), shares=self.mac_key.shares) for program in others]

    def protocol(self, index, mac_check, program=None):
        others = (job.protocol(index, mac_check) for job in self._others)
        return parallel(super().protocol(index, mac_check, program), *others)


@cache
def unequal():
    return UnequalLanes(UNEQUAL)


@pytest.mark.parametrize("evil", [0, 1])
def test_a_lie_in_a_lane_of_another_program_is_caught(evil):
    job = unequal()
    right = [run_clear(PROGRAMS[name], X, Y).value for name in UNEQUAL]
    assert [value for (value,) in job.duel(evil).value] == pytest.approx(right, abs=2**-14)
    for number, size in job.honest.openings.items():
        for i in range(size):
            lie = element(number, i, ELEMENT["plus 1"])
            assert job.try_lie(evil, number, lie, follow=(number + i) % 2 == 0, what=f"element {i}")


def test_a_lane_that_is_left_alone_is_checked():
    """Its own check comes although the others have ended."""
    sent = unequal().honest.sent
    assert sent[1] == 3 and sent[-3:] == [None, 1, None] and sent.count(None) == 2
