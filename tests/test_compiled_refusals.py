"""What compiled code refuses, it refuses as the ordinary reading does: at the same place, in its words."""

from dataclasses import replace
from itertools import product
from unittest.mock import Mock, patch

import numpy as np
import pytest
from compiled_helpers import FORGED, SECURITIES, Job, Lane, deal, hold, unit_vectors

from protocols import is_candidate
from protocols.scores import S4, S6, S7, S10
from spdz import MacCheckFailed, ProtocolViolation, TapeDamaged, absolute, dot, mask, multiply, nonnegative
from spdz.arithmetic.field import P
from spdz.foundations.errors import Unsent, Wrapped
from spdz.readings.streams import JobStream
from spdz.rounds.mac_check import MacCheck
from spdz.values import input_mask

LENGTHS = (1, 9, 70)

any_length = pytest.mark.parametrize("n", LENGTHS)
any_security = pytest.mark.parametrize("security", SECURITIES)


def form_of(job):
    """Bits of a word, its bytes, and the interval of honest ones."""
    source = job.plan.inputs[0]
    bits = input_mask.job_bits(source.shape, source.norm)
    return input_mask.element_bytes(bits), source.norm, (1 << bits) - source.norm


def words_of(frame, size):
    return [int.from_bytes(frame[i : i + size], "little") for i in range(0, len(frame), size)]


def changed(replies, number, frame):
    return [*replies[:number], frame, *replies[number + 1 :]]


def with_word(frame, place, number, size):
    return frame[: place * size] + number.to_bytes(size, "little") + frame[(place + 1) * size :]


# -- inputs -----------------------------------------------------------------------------------------------


@any_length
def test_own_words_outside_the_interval_are_not_sent(n):
    job = deal(S10.within(1.0), unit_vectors(n), "semi-honest")
    size, low, high = form_of(job)
    stream = Job.stream
    for index, place, (word, honest) in product(
        (0, 1), {0, n - 1}, ((low - 1, False), (low, True), (high - 1, True), (high, False))
    ):
        x = int(job.raw(index)[place])

        def masked(job, party, place=place, mask=word - x):
            dealt = stream(job, party)
            dealt._pad[place, 0] = mask  # what is drawn first is the own mask
            return dealt

        with patch.object(Job, "stream", masked):
            outcome = hold(job, index, replies=[])
        assert isinstance(outcome.error, Unsent) != honest
        if honest:
            assert words_of(outcome.frames[0], size)[place] == word
        else:
            assert outcome.frames == []


@any_length
@any_security
def test_a_peers_words_outside_the_interval_are_refused(n, security):
    job = deal(S6.within(1.0), unit_vectors(n), security)
    size, low, high = form_of(job)
    for index in (0, 1):
        replies = job.frames[1 - index]
        for place in {0, n - 1}:
            for word in (0, low - 1, high, (1 << 8 * size) - 1):
                forged = changed(replies, 0, with_word(replies[0], place, word, size))
                outcome = hold(job, index, forged)
                assert isinstance(outcome.error, ProtocolViolation)
                assert "outside the interval" in str(outcome.error) and len(outcome.frames) == 1
            for word in (low, high - 1):
                forged = changed(replies, 0, with_word(replies[0], place, word, size))
                outcome = hold(job, index, forged)
                assert isinstance(outcome.error, MacCheckFailed) == (security == "malicious")


@pytest.mark.parametrize("n", [5, 70])
def test_long_words_that_are_no_elements_are_refused(n):
    job = deal(S10.within(2.0**22), unit_vectors(n, length=2.0**22), "malicious")
    for index in (0, 1):
        replies = job.frames[1 - index]
        for number in (P, P + 1, (1 << 128) - 1):
            outcome = hold(job, index, changed(replies, 0, with_word(replies[0], n - 1, number, 16)))
            assert isinstance(outcome.error, ProtocolViolation) and len(outcome.frames) == 1


# -- openings ---------------------------------------------------------------------------------------------


async def _difference(engine, x, y):
    return x - y


async def _bits(engine, x, y):
    return (await nonnegative(x - y))[::-1]


async def _bit(engine, x, y):
    return (await nonnegative(dot(x, y))).reshape(1)[0]


@pytest.mark.parametrize("program", [S4.within(1.0), S10.within(1.0), _difference, _bits])
@any_security
def test_elements_that_are_not_canonical_are_refused(program, security):
    for n in (4, 70):
        job = deal(program, unit_vectors(n), security)
        for index in (0, 1):
            replies = job.frames[1 - index]
            openings = [i for i, frame in enumerate(replies) if i and not job.read(index).requests[i][2]]
            assert openings
            for number in openings:
                for place in {0, len(replies[number]) // 16 - 1}:
                    frame = with_word(replies[number], place, P, 16)
                    outcome = hold(job, index, changed(replies, number, frame))
                    assert isinstance(outcome.error, ProtocolViolation)
                    assert "not a field element" in str(outcome.error)
                    assert len(outcome.frames) == number + 1


async def _ignoring(engine, x, y):
    """Neither y nor what is opened behind a mask is used."""
    await mask(multiply(x, x))
    return x[0]


@any_length
def test_what_is_received_is_looked_at_though_nothing_uses_it(n):
    with patch.object(_ignoring, "max_norm", 1.0, create=True):
        job = deal(_ignoring, unit_vectors(n), "semi-honest")
        size = form_of(job)[0]
        for index in (0, 1):
            replies = job.frames[1 - index]
            for number, word, length in ((0, 0, size), (1, P, 16)):
                forged = changed(replies, number, with_word(replies[number], n - 1, word, length))
                outcome = hold(job, index, forged)
                assert isinstance(outcome.error, ProtocolViolation)


def opened_as(job, index, number, opened):
    """The peer's frame that makes every number of an opening this one."""
    return b"".join(one.to_bytes(16, "little") for one in opened_words(job, index, number, opened))


def opened_words(job, index, number, opened):
    return [(opened - share) % P for share in words_of(job.frames[index][number], 16)]


async def _sizes(engine, x, y):
    """A number an entry is opened behind a mask."""
    return await absolute(multiply(x, y))


@pytest.mark.parametrize("program", [S4.within(1.0), is_candidate(S7.within(1.0), 0.5), _sizes])
def test_an_opening_that_may_have_wrapped_is_given_up_after_a_check(program):
    for n in (4, 70):
        for security in SECURITIES:
            job = deal(program, unit_vectors(n), security)
            for index in (0, 1):
                replies = [*job.frames[1 - index][:1], opened_as(job, index, 1, 3)]
                if security == "malicious":
                    lie = hold(job, index, [*replies, bytes(16)])
                    assert isinstance(lie.error, MacCheckFailed) and len(lie.frames) == 3
                    replies.append(FORGED)
                outcome = hold(job, index, replies)
                assert isinstance(outcome.error, Wrapped) and len(outcome.frames) == len(replies)
                last = len(job.frames[index][1]) // 16 - 1  # one of many is enough
                one = with_word(job.frames[1 - index][1], last, opened_words(job, index, 1, 3)[last], 16)
                outcome = hold(job, index, [replies[0], one, *replies[2:]])
                assert isinstance(outcome.error, Wrapped)


@pytest.mark.parametrize("program", [_bits, _bit])
@any_security
def test_an_opened_bit_that_is_none_is_refused(program, security):
    checks = [FORGED] * (security == "malicious")
    for n in (1, 6, 70):
        job = deal(program, unit_vectors(n), security)
        for index in (0, 1):
            last = len(job.frames[0]) - 1 - len(checks)
            for number in (2, P - 1, 1 << 64):
                forged = opened_as(job, index, last, number)
                outcome = hold(job, index, [*job.frames[1 - index][:last], forged, *checks])
                assert isinstance(outcome.error, ProtocolViolation)
                assert "neither 0 nor 1" in str(outcome.error)
            for number in (0, 1):
                forged = opened_as(job, index, last, number)
                outcome = hold(job, index, [*job.frames[1 - index][:last], forged, *checks])
                assert outcome.error is None and np.all(outcome.value == bool(number))


@any_security
def test_bits_beyond_the_last_one_are_refused(security):
    job = deal(is_candidate(S10.within(1.0), 0.5), unit_vectors(5), security)
    number = next(i for i, frame in enumerate(job.frames[0]) if len(frame) == 1)
    for index in (0, 1):
        replies = job.frames[1 - index]
        for bit in range(1, 8):
            outcome = hold(job, index, changed(replies, number, bytes([replies[number][0] ^ 1 << bit])))
            assert isinstance(outcome.error, ProtocolViolation)
            assert "beyond the last one" in str(outcome.error)


@any_security
def test_a_forged_result_passes_where_its_check_does(security):
    """So that the tests above see a refusal, and no check that fails anyway."""
    job = deal(S10.within(1.0), unit_vectors(5), security)
    checks = [FORGED] * (security == "malicious")
    for index in (0, 1):
        outcome = hold(job, index, [job.frames[1 - index][0], opened_as(job, index, 1, 3 << 32), *checks])
        assert outcome.value == 3.0 and outcome.error is None


# -- the tape, and the check ------------------------------------------------------------------------------


def test_a_job_of_another_size_is_damaged():
    for security in SECURITIES:
        job = deal(S4.within(1.0), unit_vectors(5), security)
        for index in (0, 1):
            key, pad, stored = job.keys[index], job.plan.pad_bytes[index], job.corrections[index]
            for size, kept in ((pad - 16, stored), (pad + 16, stored), (pad, bytes(stored) + bytes(1))):
                with pytest.raises(TapeDamaged):
                    job.codes[index].ahead(JobStream(key, size, kept), 5)
            for cut in (1, 8, 16, len(stored)):
                if len(stored) >= cut:
                    with pytest.raises(TapeDamaged):
                        job.codes[index].ahead(JobStream(key, pad, stored[: len(stored) - cut]), 5)


def test_nothing_is_sent_without_a_check_in_the_malicious_mode():
    job = deal(S10.within(1.0), unit_vectors(5), "malicious")
    code, alpha = job.codes[0], job.mac.shares[0]
    with pytest.raises(MacCheckFailed, match="without a check"):
        code.run(code.ahead(job.stream(0), alpha), alpha, None, job.raw(0), None)


def test_code_that_leaves_an_opening_unchecked_outputs_nothing():
    def careless(early, alpha, mac_check, data, rounds):
        mac_check.record_same(1, bytes(16))
        return 1.0

    whole = deal(S10.within(1.0), unit_vectors(5), "malicious").codes[0]
    code = replace(whole, code=replace(whole.code, direct=careless))
    with pytest.raises(MacCheckFailed, match="unchecked openings"):
        code.run_alone((), 5, [], Mock(mac_check=MacCheck(5, 0, bytes(32))))


def test_a_dead_check_stays_dead():
    job = deal(S10.within(1.0), unit_vectors(5), "malicious")
    lane = Lane(job, 0, job.codes[0])
    replies = job.frames[1]
    assert isinstance(lane.replay(changed(replies, len(replies) - 1, bytes(16))).error, MacCheckFailed)
    with pytest.raises(MacCheckFailed):
        lane.check.verify(lane.check._hash(1))
