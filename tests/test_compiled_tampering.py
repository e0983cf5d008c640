"""A bit that is turned over anywhere: never a value in the malicious mode, and the ordinary reading's end."""

import random

import pytest
from compiled_helpers import deal, hold, turned, unit_vectors

from protocols import is_candidate
from protocols.scores import S2, S4, S6, S8, S10
from spdz import MacCheckFailed, ProtocolViolation

PROGRAMS = {
    "S2": S2.within(1.0),
    "S4": S4.within(1.0),
    "S6": S6.within(1.0),
    "S8": S8.within(1.0),
    "S10": S10.within(1.0),
    "S10 decided": is_candidate(S10.within(1.0), 0.1),
    "S4 decided": is_candidate(S4.within(1.0), 0.9),
}


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("n", [6, 66])
def test_a_bit_of_any_frame_is_not_turned_over_unnoticed(name, n):
    draw = random.Random(f"{name} {n}")
    job = deal(PROGRAMS[name], unit_vectors(n), "malicious")
    for index in (0, 1):
        replies = job.frames[1 - index]
        for number, frame in enumerate(replies):
            last = 8 * len(frame) - 1
            for bit in {0, last, draw.randint(0, last), draw.randint(0, last)}:
                outcome = hold(job, index, [*replies[:number], turned(frame, bit), *replies[number + 1 :]])
                assert isinstance(outcome.error, MacCheckFailed | ProtocolViolation)
                assert outcome.value is None


@pytest.mark.parametrize("name", PROGRAMS)
def test_without_macs_both_readings_end_alike(name):
    draw = random.Random(name)
    job = deal(PROGRAMS[name], unit_vectors(6), "semi-honest")
    for index in (0, 1):
        replies = job.frames[1 - index]
        for number, frame in enumerate(replies):
            for bit in {0, draw.randrange(8 * len(frame)), draw.randrange(8 * len(frame))}:
                hold(job, index, [*replies[:number], turned(frame, bit), *replies[number + 1 :]])


@pytest.mark.parametrize("name", ["S4", "S10 decided"])
@pytest.mark.parametrize("evil", [0, 1])
def test_compiled_parties_catch_a_tampered_frame_of_either(name, evil):
    """Live: both sides run code, and what either sends is turned over on its way."""
    job = deal(PROGRAMS[name], unit_vectors(6), "malicious")
    for number in range(len(job.frames[0])):

        def tamper(at, sender, frame, number=number):
            return turned(frame, 3) if (at, sender) == (number, evil) else frame

        with pytest.raises((MacCheckFailed, ProtocolViolation)):
            job.together(job.codes, tamper)
