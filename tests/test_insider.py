"""Every program, lied to by either party in every element and bit of every opening: caught at the next check.

Ways to lie take turns from element to element, from opening to opening and from party to party, and so does
whether the insider's state follows the lie. SPDZ_INSIDER_TRIALS is how many further lies of all kinds are
drawn for every program and party (default 4; a few hundred take minutes).
"""

import os
import random
from itertools import cycle, islice, pairwise, product

import numpy as np
import pytest
from insider_frames import Bit
from insider_programs import ALL, GATES_AND_FUNCTIONS, X, Y, dealt
from lies import ELEMENT, FRAME, PAIR, cancelling, element, frame, pair, sampled

from spdz import ProtocolViolation, functions, gates, run_clear
from spdz.arithmetic.field import P
from spdz.values.input_mask import LONG, element_bytes

TRIALS = int(os.environ.get("SPDZ_INSIDER_TRIALS", "4"))
SHORT = 8
"""Elements opened by a program of which every element is changed several times."""

any_program = pytest.mark.parametrize("name", ALL)


def follows():
    """Whether the insider follows its lie; of period 3, to fall on every kind of lie in either way."""
    return cycle((True, False, True))


def test_the_table_covers_every_gate_and_every_function():
    assert set(GATES_AND_FUNCTIONS) == {*gates.__all__, *functions.__all__}


@any_program
def test_without_a_lie_the_result_is_right(name):
    right = pytest.approx(run_clear(ALL[name], X, Y).value, rel=2**-14, abs=2**-14)
    for evil, follow in product((0, 1), (False, True)):
        duel = dealt(name).duel(evil, follow=follow)
        assert duel.accepted and not duel.lied
        assert duel.value[0] == right


@any_program
def test_the_result_is_opened_after_a_check_and_output_after_another(name):
    """What :meth:`Duel.frames_until_checked` relies on."""
    frames = dealt(name).honest.sent
    before, result = frames[1:-2], frames[-2:]
    assert before == [] or before[-1] is None
    assert None not in before[:-1] or name == "decided"  # which opens nothing before another check
    assert result == [np.size(run_clear(ALL[name], X, Y).value), None]


@any_program
def test_a_lie_in_any_element_of_any_opening_is_caught(name):
    job, generator, modes, ways = dealt(name), random.Random(name), follows(), cycle(ELEMENT)
    openings = job.honest.openings
    times = 5 if sum(openings.values()) <= SHORT else 1
    for evil, number in product((0, 1), openings):
        for i in range(openings[number]):
            lied = 0
            while lied < times:  # "opened as 0" is no lie where 0 is opened
                how = next(ways)
                lie = element(number, i, ELEMENT[how], generator.randrange(1, P))
                lied += job.try_lie(evil, number, lie, follow=next(modes), what=f"{how} in element {i}")


@any_program
def test_a_lie_in_several_elements_of_an_opening_is_caught(name):
    job, generator, modes = dealt(name), random.Random(name), follows()
    openings, frames, pairs = job.honest.openings, cycle(FRAME), cycle(PAIR)
    for evil, number in product((0, 1), openings):
        how = next(frames)
        lie = frame(number, FRAME[how], generator.randrange(1, P))
        job.try_lie(evil, number, lie, follow=next(modes), what=how)
        for how in islice(pairs, 2 if openings[number] > 1 else 0):
            i, j = generator.sample(range(openings[number]), 2)
            lie = pair(number, i, j, PAIR[how], generator.randrange(1, P))
            job.try_lie(evil, number, lie, follow=next(modes), what=f"{how} in elements {i}, {j}")


@any_program
def test_a_lie_that_a_later_opening_takes_back_is_caught(name):
    """By the next opening, and by the result's."""
    job, generator, modes = dealt(name), random.Random(name), follows()
    openings = job.honest.openings
    to_the_last = {(number, len(openings)) for number in range(1, len(openings))}
    for evil, (first, second) in product((0, 1), sorted({*pairwise(openings), *to_the_last})):
        i, j = generator.randrange(openings[first]), generator.randrange(openings[second])
        lie = cancelling(first, i, second, j, generator.randrange(1, P))
        what = f"element {i}, taken back in element {j} of exchange {second}"
        assert job.try_lie(evil, first, lie, follow=next(modes), what=what)


@any_program
def test_any_other_lie_is_caught(name):
    job, generator = dealt(name), random.Random(f"{name} sampled")
    for evil, _ in product((0, 1), range(TRIALS)):
        number, lie, what = sampled(generator, job.honest.openings)
        job.try_lie(evil, number, lie, follow=generator.random() < 0.5, what=what)


LENGTHS = {
    "one element short": lambda own: own[:-1],
    "one element long": lambda own: [*own, 0],
    "nothing": lambda own: [],
}
ILLEGAL = LENGTHS | {
    "p itself": lambda own: [P, *own[1:]],
    "an unreduced share": lambda own: [own[0] | 1 << 127, *own[1:]],
    "the last element at its largest": lambda own: [*own[:-1], (1 << 128) - 1],
}


BITS = {
    "a bit beyond the last": lambda own: [*own, Bit(1)],
    "the last bit of the last byte": lambda own: [*own, *[Bit(0)] * (7 - len(own)), Bit(1)],
    "all bits beyond the last": lambda own: [*own, *[Bit(1)] * (8 - len(own))],
    "one byte long": lambda own: [*own, *[Bit(0)] * 8],
    "nothing": lambda own: [],
}
"""Of fewer than eight bits."""


def illegal(job, number):
    """Ways to send what is no frame of exchange ``number``."""
    if number in job.honest.bits:
        return BITS
    bits, norm = job.word_bits, job.norm
    if number or bits == LONG:
        return ILLEGAL
    return LENGTHS | {
        "a word below the interval": lambda own: [norm - 1, *own[1:]],
        "a word above the interval": lambda own: [*own[:-1], (1 << bits) - norm],
        "no word at all": lambda own: [0, *own[1:]],
        "a word at its largest": lambda own: [own[0], (1 << 8 * element_bytes(bits)) - 1, *own[2:]],
    }


@pytest.mark.parametrize(
    "name", ["S6", "beaver_dot", "nonnegative", "S10 candidate", "side by side", "beaver_dot on a stock"]
)
def test_a_frame_that_is_not_well_formed_is_refused_at_once(name):
    job = dealt(name)
    for evil, number in product((0, 1), (0, *job.honest.openings)):
        for how, say in illegal(job, number).items():
            duel = job.duel(evil, lambda at, own, theirs: say(own) if at == number else own)  # noqa: B023
            assert type(duel.error) is ProtocolViolation and not duel.results, (evil, number, how)
            assert len(duel.sent) == job.honest.position(number) + 1


@pytest.mark.parametrize("name", ["S6", "S10 candidate"])
def test_words_at_the_ends_of_the_interval_are_taken(name):
    """They are words of inputs far out of range; the program is the honest one's, so a check fails later."""
    job = dealt(name)
    for evil, word in product((0, 1), (job.norm, (1 << job.word_bits) - job.norm - 1)):
        assert job.try_lie(evil, 0, lambda at, own, theirs: own if at else [*own[:-1], word], what="ends")  # noqa: B023
