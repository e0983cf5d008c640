"""Attacks on the MAC check itself: what an insider may send instead of its hash, knowing the honest one."""

import hashlib
from hashlib import sha256
from itertools import product

import numpy as np
import pytest
from insider import own_hash
from insider_programs import dealt
from lies import ELEMENT, element

from spdz.rounds.mac_check import DIGEST_BYTES


def zero_sigmas(ledger):
    return [
        tuple(map(np.zeros_like, entry)) if isinstance(entry, tuple) else np.zeros_like(entry)
        for entry in ledger._opened
    ]


FORGERIES = {
    "the honest hash": lambda ledger, theirs: theirs,
    "the honest hash, backwards": lambda ledger, theirs: theirs[::-1],
    "the honest party's hash over its own sigmas": lambda ledger, theirs: ledger._hash(1 - ledger._party),
    "the same over sigmas of the other sign": lambda ledger, theirs: ledger.as_if(party=1 - ledger._party),
    "zeros": lambda ledger, theirs: bytes(DIGEST_BYTES),
    "ones": lambda ledger, theirs: b"\xff" * DIGEST_BYTES,
    "over nothing opened": lambda ledger, theirs: ledger.as_if(opened=[]),
    "over one opening more": lambda ledger, theirs: ledger.as_if(opened=ledger._opened * 2),
    "over sigmas that are 0": lambda ledger, theirs: ledger.as_if(opened=zero_sigmas(ledger)),
    "under another alpha": lambda ledger, theirs: ledger.as_if(alpha=ledger._alpha + 1),
    "under another transcript": lambda ledger, theirs: ledger.as_if(transcript=hashlib.sha256()),
    "under another session": lambda ledger, theirs: ledger.as_if(
        prefix=sha256(b"spdz mac-check" + bytes(32))
    ),
    "of the next check": lambda ledger, theirs: ledger.as_if(checks=ledger._checks + 1),
}
"""None is what the honest party expects, lie or no lie (but under another alpha, where all opened is 0)."""

REPLAYS = {
    "the own hash of the check before": lambda ledger, theirs: ledger.history[-1][0],
    "the honest hash of the check before": lambda ledger, theirs: ledger.history[-1][1],
}

NAMES = ["dot", "S6 candidate", "beaver_dot", "side by side", "divide"]
any_program = pytest.mark.parametrize("name", NAMES)


def in_check(number, forgery):
    """Forge in one check and be honest in the others."""
    return lambda ledger, theirs: (forgery if len(ledger.history) == number else own_hash)(ledger, theirs)


@any_program
def test_a_forged_hash_is_refused_although_nothing_else_is_wrong(name):
    job = dealt(name)
    checks = [at for at, size in enumerate(job.honest.sent) if size is None]
    for evil, (number, at), how in product((0, 1), enumerate(checks), FORGERIES):
        duel = job.duel(evil, forge=in_check(number, FORGERIES[how]))
        if duel.lied:
            assert duel.caught and len(duel.sent) == at + 1, (evil, number, how, duel)
        else:
            assert duel.accepted and how == "under another alpha", (evil, number, how, duel)


@any_program
def test_a_hash_of_an_earlier_check_is_refused(name):
    job = dealt(name)
    for evil, how in product((0, 1), REPLAYS if None in job.honest.sent[:-1] else ()):
        duel = job.duel(evil, forge=in_check(1, REPLAYS[how]))
        assert duel.lied and duel.caught, (evil, how, duel)
        assert len(duel.sent) == len(job.honest.sent)


@any_program
def test_no_forged_hash_covers_a_lie(name):
    """In every exchange; in checks before it the insider is honest, or they would end the run."""
    job = dealt(name)
    for evil, number, how in product((0, 1), job.honest.openings, FORGERIES):
        check = job.honest.sent[: job.honest.position(number)].count(None)
        lie, forge = element(number, 0, ELEMENT["plus 1"]), in_check(check, FORGERIES[how])
        assert job.try_lie(evil, number, lie, forge=forge, follow=(number + evil) % 2 == 0, what=how)
