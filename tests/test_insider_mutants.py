"""Engines whose MAC check has a hole: the insider beats them, so what it loses to the real one counts.

Every case is one hole, cut into the real engine, and the lie that fits through it. The real engine catches
the same lie. With the hole the honest party outputs a wrong number. Holes that concern bits are in
``test_insider_bit_mutants.py``.
"""

from contextlib import contextmanager
from copy import copy
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from insider import Dealt, own_hash
from insider_programs import PROGRAMS, X, Y
from lies import ELEMENT, PAIR, cancelling, element, pair

from spdz import MacCheckFailed, Value, run_clear
from spdz.arithmetic import field
from spdz.gates.product import masked_product
from spdz.readings.party import Party
from spdz.rounds.mac_check import MacCheck

PAIRS = ((X, Y), (Y, X / 2))
"""Two lanes of a program that opens two arrays of three elements a lane, twice, and one."""


def hashing(what):
    """A check that hashes the sigmas of ``what(opened)`` instead of those of all that was opened."""
    whole = MacCheck._hash

    def partly(self, party, begun=None):
        changed = copy(self)
        changed._same = None
        changed._opened = what([tuple(part.reshape(-1, 2) for part in one) for one in self._opened])
        return whole(changed, party, begun)

    return patch.object(MacCheck, "_hash", partly)


def each(what):
    """As :func:`hashing`, with ``what`` done to every array."""
    return hashing(lambda opened: [tuple(map(what, one)) for one in opened])


def added_up(elements):
    return field.sum(elements, 0)[None]


def numbered_and_added_up(elements):
    return added_up(field.mul(elements, field.from_ints(range(1, len(elements) + 1))))


def end_to_end(opened):
    return tuple(np.concatenate(parts) for parts in zip(*opened, strict=True))


@contextmanager
def one_record_a_round():
    absorb, record = MacCheck.absorb, MacCheck.record

    def absorbing(self, sent, received):
        absorb(self, sent, received)
        self._waiting = True

    def recording(self, opened, mac):
        if self._waiting:
            record(self, opened, mac)
        self._waiting = False

    with patch.object(MacCheck, "absorb", absorbing), patch.object(MacCheck, "record", recording):
        yield


def comparing(accept):
    """A check that accepts where ``accept(expected, own, received)`` says so."""

    def verify(self, received, expected=None):
        if not accept(self._hash(1 - self._party), self.message(), bytes(received)):
            raise MacCheckFailed("caught")
        self._checks += 1
        self._opened.clear()
        self._same = None

    return patch.object(MacCheck, "verify", verify)


def without_party_number():
    whole = MacCheck._hash
    return patch.object(MacCheck, "_hash", lambda self, party, begun=None: whole(self, 0, begun))


@contextmanager
def without_checks():
    async def nothing():
        return None

    with (
        patch("spdz.gates.output.check", nothing),
        patch.object(MacCheck, "pending", property(lambda _: False)),
    ):
        yield


def echo(ledger, theirs):
    return theirs


def nonsense(ledger, theirs):
    return bytes(len(theirs))


def random_number_in(number, i):
    return element(number, i, ELEMENT["plus a random number"], 1 << 70)


HOLES = {
    "hashes no sigma": (lambda: hashing(lambda opened: []), random_number_in(1, 0)),
    "hashes the first opening alone": (lambda: hashing(lambda opened: opened[:1]), random_number_in(1, 3)),
    "hashes the last opening alone": (lambda: hashing(lambda opened: opened[-1:]), random_number_in(1, 0)),
    "hashes every other opening": (lambda: hashing(lambda opened: opened[::2]), random_number_in(2, 4)),
    "hashes one element an opening": (lambda: each(lambda part: part[:1]), random_number_in(1, 2)),
    "hashes all elements but the last": (lambda: each(lambda part: part[:-1]), random_number_in(2, 2)),
    "adds up the sigmas of an opening": (lambda: each(added_up), pair(1, 0, 2, PAIR["cancelling"], 1 << 70)),
    "adds up all sigmas": (
        lambda: hashing(lambda opened: [tuple(map(added_up, end_to_end(opened)))]),
        cancelling(1, 0, 2, 4, 1 << 70),
    ),
    "weighs sigmas with numbers known before": (
        lambda: each(numbered_and_added_up),
        pair(1, 0, 1, PAIR["cancelling where weighted 1 and 2"], 1 << 70),
    ),
    "records one value an opening": (one_record_a_round, random_number_in(1, 3)),
    "records one lane": (one_record_a_round, random_number_in(3, 1)),
    "does not hash who sends": (without_party_number, random_number_in(1, 0), echo),
    "accepts its own hash": (
        lambda: comparing(lambda expected, own, got: got in (expected, own)),
        random_number_in(1, 0),
        echo,
    ),
    "accepts any hash": (
        lambda: comparing(lambda expected, own, got: True),
        random_number_in(1, 0),
        nonsense,
    ),
    "checks nothing": (without_checks, random_number_in(1, 0)),
}
"""How to cut the hole, the lie, and the forgery if there is one."""


def dealt(shares=None):
    return Dealt(PROGRAMS["beaver_dot"], *PAIRS, shares=shares)


def is_beaten(duel):
    right = [run_clear(PROGRAMS["beaver_dot"], *inputs).value for inputs in PAIRS]
    return duel.lied and duel.accepted and duel.value != pytest.approx(right, abs=2**-8)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("name", HOLES)
def test_the_insider_beats_an_engine_that(name, evil):
    (cut, lie, *forge), job = HOLES[name], dealt()
    assert job.duel(evil, lie, forge=(forge or [own_hash])[0]).caught
    with cut():
        assert job.duel(evil).accepted
        assert is_beaten(job.duel(evil, lie, forge=(forge or [own_hash])[0]))


@pytest.mark.parametrize("evil", [0, 1])
def test_the_insider_beats_an_engine_that_compares_one_byte_of_the_hash(evil):
    """It tries all bytes; the job is the same each time."""
    job = dealt()
    with comparing(lambda expected, own, got: got[:1] == expected[:1]):
        duels = [
            job.duel(evil, random_number_in(3, 0), forge=lambda ledger, theirs: forgery(ledger, first))  # noqa: B023
            for first in range(256)
        ]
    assert sum(map(is_beaten, duels)) == 1


def forgery(ledger, first):
    """Honest in the first check; then any hash with this first byte."""
    return bytes([first]) + bytes(15) if ledger.history else ledger.message()


@pytest.mark.parametrize("evil", [0, 1])
def test_the_insider_beats_an_engine_in_which_it_has_all_of_alpha(evil):
    """It denies its lie, and its sigmas are those of the honest party."""
    job = dealt(shares=(0, 1 << 100) if evil else (1 << 100, 0))
    assert is_beaten(job.duel(evil, random_number_in(3, 0), follow=False))


@pytest.mark.parametrize("evil", [0, 1])
def test_the_insider_makes_an_engine_that_checks_too_late_open_its_result(evil):
    """Nothing is output, but the result was opened before what led to it was checked: too many frames."""
    job, lie = dealt(), random_number_in(1, 0)
    assert job.try_lie(evil, 1, lie)
    with patch.object(Party, "has_unchecked_openings", property(lambda party: False)):
        assert job.duel(evil, lie).caught
        with pytest.raises(AssertionError):
            job.try_lie(evil, 1, lie)


def sigma_without_alpha_of(party):
    whole = MacCheck._hash

    def wrong(self, sender, begun=None):
        changed = copy(self)
        changed._same = None
        changed._alpha = 0 if self._party == party else self._alpha
        return whole(changed, sender, begun)

    return patch.object(MacCheck, "_hash", wrong)


def public_number_without_alpha_of(index):
    whole = Party.plus_public

    def wrong(self, x, public):
        alpha = self.alpha
        self.alpha = 0 if self.index == index else alpha
        try:
            return whole(self, x, public)
        finally:
            self.alpha = alpha

    return patch.object(Party, "plus_public", wrong)


def product_without_alpha_of(index):
    def wrong(party, *operands):
        alpha = 0 if party.index == index else party.alpha
        return masked_product(SimpleNamespace(index=party.index, alpha=alpha, ring=party.ring), *operands)

    return patch("spdz.gates.beaver.masked_product", wrong)


def product_without_the_macs_of_cross_terms():
    def wrong(party, by, x, y, correction):
        x, y = (
            Value(party, (*z.parts[:2], None), z.shape, z.frac, z.bound, masked=True, span=z.span)
            for z in (x, y)
        )
        return masked_product(party, by, x, y, correction)

    return patch("spdz.gates.beaver.masked_product", wrong)


WRONG = {
    "party 0's sigma": lambda: sigma_without_alpha_of(0),
    "party 1's sigma": lambda: sigma_without_alpha_of(1),
    "party 0's public numbers": lambda: public_number_without_alpha_of(0),
    "party 1's public numbers": lambda: public_number_without_alpha_of(1),
    "party 0's products": lambda: product_without_alpha_of(0),
    "party 1's products": lambda: product_without_alpha_of(1),
    "the cross terms of products": product_without_the_macs_of_cross_terms,
}


@pytest.mark.parametrize("name", WRONG)
def test_without_a_lie_the_check_fails_in_an_engine_that_leaves_alpha_out_of(name):
    with WRONG[name]():
        assert dealt().duel().caught
