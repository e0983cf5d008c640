"""Bits are opened under a MAC of their own, Delta: what the insider can do who knows it, or most of it.

As in ``test_insider_mutants.py``, every hole is cut into the real engine. The honest party is told a wrong
bit; where the MAC has to fit, the insider *denies* the lie and adds to its sigma what it takes for the honest
party's Delta_i.
"""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from insider import Dealt, own_hash
from insider_programs import PROGRAMS, X, Y
from lies import ELEMENT, PAIR, element, pair
from test_insider_mutants import comparing, echo, nonsense, without_checks, without_party_number

from spdz import run_clear
from spdz.readings.party import Party
from spdz.rounds.mac_check import MacCheck
from spdz.values.trees import of_party

PROGRAM = PROGRAMS["nonnegative"]
"""It opens three elements and then, after a check, three bits."""

PAIRS = ((X, Y), (Y, X / 2))
BITS = 2
"""The exchange in which bits are opened."""

ALL_BUT_LOWEST = range(1, 128)
either_party = pytest.mark.parametrize("evil", [0, 1])


def dealt(pairs=PAIRS):
    return Dealt(PROGRAM, *pairs)


def flip(i):
    return element(BITS, i, ELEMENT["plus 1"])


def is_beaten(duel):
    if not (duel.lied and duel.accepted):
        return False
    right = [run_clear(PROGRAM, *inputs).value for inputs in PAIRS[: len(duel.value)]]
    return not np.array_equal(duel.value, right)


def deltas_of(job, party):
    """One party's Delta_i of every lane, which no other party can know."""
    found, whole = [], Party.open_bits

    def watched(self, shares, delta, n):
        if self.index == party:
            found.append(delta[0].copy())
        return whole(self, shares, delta, n)

    with patch.object(Party, "open_bits", watched):
        assert job.duel().accepted
    return found


def as_blocks(number):
    return np.array([number & (1 << 64) - 1, number >> 64], dtype=np.uint64)


def claiming(delta, i=0, lane=0):
    """A hash that fits the flipped bit i of a lane if ``delta`` is the honest party's Delta_i."""

    def forge(ledger, theirs):
        if not ledger.history:
            return ledger.message()
        opened = list(ledger._opened)
        opened[lane] = opened[lane].copy()
        opened[lane][i] ^= delta
        return ledger.as_if(opened=opened)

    return forge


@either_party
def test_who_knows_delta_opens_any_bit(evil):
    """So the insider that fails below fails for want of Delta, and of nothing else."""
    job = dealt()
    for lane, delta in enumerate(deltas_of(job, 1 - evil)):
        for i in range(3):
            duel = job.duel(evil, flip(3 * lane + i), forge=claiming(delta, i, lane), follow=False)
            assert is_beaten(duel)


@either_party
def test_every_bit_of_delta_counts(evil):
    """The insider knows all of it but one bit (and the lowest, which everybody knows)."""
    job = dealt(PAIRS[:1])
    (delta,) = deltas_of(job, 1 - evil)
    for unknown in ALL_BUT_LOWEST:
        forge = claiming(delta ^ as_blocks(1 << unknown))
        assert job.duel(evil, flip(0), forge=forge, follow=False).caught, unknown


@either_party
def test_delta_is_no_other_delta_that_the_insider_may_know(evil):
    """Its own, that of another lane or job, both parties' together where it denies, all zeros or all ones."""
    job = dealt()
    (own, _), (first, second) = deltas_of(job, evil), deltas_of(job, 1 - evil)
    (other, _) = deltas_of(dealt(), 1 - evil)
    for delta in (
        own,
        own ^ as_blocks(1),
        second,
        other,
        first ^ own,
        as_blocks(0),
        as_blocks((1 << 128) - 1),
    ):
        for follow in (False, True):
            if not (follow and np.array_equal(delta, first ^ own)):
                assert job.duel(evil, flip(0), forge=claiming(delta), follow=follow).caught, delta


def recording(what):
    """A check that keeps ``what(sigma)`` of the sigmas of bits."""
    whole = MacCheck.record_bits
    return patch.object(MacCheck, "record_bits", lambda self, sigma: whole(self, what(sigma)))


def no_bits_recorded():
    return patch.object(MacCheck, "record_bits", lambda self, sigma: None)


def the_bits_of_one_lane_recorded():
    """Nothing else is opened in the same check."""
    whole = MacCheck.record_bits
    return patch.object(
        MacCheck, "record_bits", lambda self, sigma: None if self.pending else whole(self, sigma)
    )


def sigmas_of_the_check_before():
    """What is the same at both is computed once, and never again."""
    whole = MacCheck._same_at_both

    def once(self):
        if not hasattr(self, "_once"):
            self._once = whole(self)
        return self._once

    return patch.object(MacCheck, "_same_at_both", once)


HOLES = {
    "records no bits": (no_bits_recorded, flip(0)),
    "records the first bit alone": (lambda: recording(lambda sigma: sigma[:1]), flip(1)),
    "records all bits but the last": (lambda: recording(lambda sigma: sigma[:-1]), flip(5)),
    "records every other bit": (lambda: recording(lambda sigma: sigma[::2]), flip(4)),
    "records the bits of one lane": (the_bits_of_one_lane_recorded, flip(3)),
    "records opened bits and no MAC": (lambda: recording(lambda sigma: sigma * np.uint64(0)), flip(2)),
    "adds up the sigmas of bits": (
        lambda: recording(lambda sigma: np.bitwise_xor.reduce(sigma, axis=0)[None]),
        pair(BITS, 0, 2, PAIR["cancelling"], 1),
    ),
    "keeps the sigmas of the check before": (sigmas_of_the_check_before, flip(0)),
    "does not hash who sends": (without_party_number, flip(0), echo),
    "accepts its own hash": (
        lambda: comparing(lambda expected, own, got: got in (expected, own)),
        flip(0),
        echo,
    ),
    "accepts any hash": (lambda: comparing(lambda expected, own, got: True), flip(0), nonsense),
    "checks nothing": (without_checks, flip(0)),
}
"""How to cut the hole, the lie, and the forgery if there is one."""


@either_party
@pytest.mark.parametrize("name", HOLES)
def test_the_insider_beats_an_engine_that(name, evil):
    (cut, lie, *forge), job = HOLES[name], dealt()
    forge = (forge or [own_hash])[0]
    assert job.duel(evil, lie, forge=forge, follow=False).caught
    with cut():
        assert job.duel(evil).accepted
        assert is_beaten(job.duel(evil, lie, forge=forge, follow=False))


def shortened(sigma_bits):
    """A check that looks at the lowest bits of a sigma alone."""
    mask = as_blocks((1 << sigma_bits) - 1)
    return recording(lambda sigma: sigma & mask)


@either_party
def test_the_insider_beats_an_engine_that_compares_a_byte_of_each_sigma(evil):
    """It tries all of them; the lowest bit is known."""
    job = dealt(PAIRS[:1])
    guesses = [as_blocks(guess << 1 | 1 - evil) for guess in range(128)]
    with shortened(8):
        duels = [job.duel(evil, flip(1), forge=claiming(guess, 1), follow=False) for guess in guesses]
    assert sum(map(is_beaten, duels)) == 1


@either_party
@pytest.mark.parametrize("kept", [64, 127])
def test_the_insider_needs_no_more_of_delta_than_is_compared(evil, kept):
    job, low = dealt(PAIRS[:1]), as_blocks((1 << kept) - 1)
    (delta,) = deltas_of(job, 1 - evil)
    assert job.duel(evil, flip(0), forge=claiming(delta ^ ~low), follow=False).caught
    with shortened(kept):
        assert job.duel(evil, flip(0), forge=claiming(as_blocks(0)), follow=False).caught
        assert is_beaten(job.duel(evil, flip(0), forge=claiming(delta & low), follow=False))


@contextmanager
def delta_from(blocks):
    """Both parties' Delta_i, but for the lowest bit, is ``blocks`` of the pad."""

    def poor(pad, party):
        return of_party(blocks(pad), party)

    with patch("spdz.readings.party.of_party", poor), patch("dealer.recipe.of_party", poor):
        yield


@either_party
def test_the_insider_beats_an_engine_in_which_both_parties_have_one_delta(evil):
    with delta_from(lambda pad: np.broadcast_to(as_blocks(0xABCDE << 60), pad.shape)):
        job = dealt()
        (own, _) = deltas_of(job, evil)
        assert is_beaten(job.duel(evil, flip(0), forge=claiming(own ^ as_blocks(1)), follow=False))


@either_party
def test_the_insider_beats_an_engine_in_which_delta_has_64_bits(evil):
    """Told these, it knows it all; and a sigma of 128 bits is then no help."""
    high = as_blocks((1 << 64) - 1)
    with delta_from(lambda pad: pad & high):
        job = dealt()
        (delta, _) = deltas_of(job, 1 - evil)
        assert not delta[1]
        assert is_beaten(job.duel(evil, flip(0), forge=claiming(delta & high), follow=False))


@either_party
def test_the_insider_makes_an_engine_that_checks_too_late_send_bits(evil):
    """Nothing is output, but the bits of a number that it chose were sent before its mask was checked."""
    job, lie = dealt(), element(1, 0, ELEMENT["plus a random number"], 1 << 70)
    assert job.try_lie(evil, 1, lie)
    with patch.object(Party, "has_unchecked_openings", property(lambda party: False)):
        assert job.duel(evil, lie).caught
        with pytest.raises(AssertionError):
            job.try_lie(evil, 1, lie)


def without_delta_of(index):
    whole = Party.open_bits

    async def wrong(self, shares, delta, n):
        return await whole(self, shares, delta * np.uint64(self.index != index), n)

    return patch.object(Party, "open_bits", wrong)


@pytest.mark.parametrize("index", [0, 1])
def test_without_a_lie_the_check_fails_in_an_engine_that_leaves_out_delta(index):
    with without_delta_of(index):
        assert dealt().duel().caught
