"""Galleries with a hole: the insider gets through each, so what it loses to the real one counts.

Every case is one hole cut into the real session, and the lie that fits through it. The real session catches
the same lie.
"""

import hashlib
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from gallery_insider import Lies, at_bit, at_element, duel, instead, random_element, vectors
from gallery_session_helpers import Product
from insider_frames import elements, frame_of

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.arithmetic.weighted import bilinear
from spdz.foundations.errors import SpdzError
from spdz.gallery.ledger import NO_NOTES
from spdz.readings.gallery import Terms
from spdz.readings.party import Party
from spdz.rounds.mac_check import MacCheck
from spdz.session.comparing import Comparing
from spdz.session.gallery import GallerySession
from spdz.values import input_mask

pytestmark = pytest.mark.usefixtures("no_sync")

TERMS, SLOTS = Terms(Product(), 4), (3, 4)
OFFER, WORDS, BEGIN, PROOF, PROOF_BITS, CELL, BITS = 2, 3, 4, 5, 7, 9, 11


def through(found):
    """The honest side noticed nothing and showed a result."""
    return not found.caught and bool(found.seen)


@contextmanager
def weights(make):
    """The weights of a collapsed opening are ``make(mac_check, index, count)``."""

    def collapsed(self, index, opened, mac):
        rows, columns = opened.shape[:2]
        both = field.from_ints(make(self, index, rows + columns))
        u, v = both[:rows], both[rows:]
        total = (mac.weighed(u, v) - self._alpha * bilinear(u, opened, v)) % P
        return total if self._party == 0 else -total % P

    with patch.object(MacCheck, "_collapsed", collapsed):
        yield


def ones(check, index, count):
    return [1] * count


def known_before(check, index, count):
    """From the session alone: before a share of c is sent."""
    stream = hashlib.shake_256(check._prefix.digest() + index.to_bytes(8, "little")).digest(16 * count)
    return [int.from_bytes(stream[i : i + 16], "little") % P for i in range(0, 16 * count, 16)]


def in_the_first_row(own, error):
    numbers = elements(own)
    return frame_of(
        [(n + e) % P for n, e in zip(numbers, [*error, *[0] * (len(numbers) - len(error))], strict=True)]
    )


class Session:
    """What an insider knows of its own session: its MAC check, when it speaks."""

    def __init__(self):
        self.check = None


def cancelling_under(make):
    """Errors in two pairs of a row that cancel under weights that are known before c is sent."""

    def lie(evil):
        seen = Session()

        def frame(number, own, theirs):
            if number != CELL:
                return own
            columns = SLOTS[1]
            v = make(seen.check, 0, sum(SLOTS))[SLOTS[0] :]
            assert len(v) == columns
            e = random_element()
            return in_the_first_row(own, [e, -e * v[0] * pow(v[1], -1, P)])

        class Knowing(Lies):
            def __call__(self, *args):
                liar = super().__call__(*args)
                run = liar.run

                def watched(protocol, stats):
                    seen.check = liar._agreement.mac_check
                    return run(protocol, stats)

                liar.run = watched
                return liar

        return Knowing(frame)

    return lie


def _believe(self, received, expected=None):
    self._checks += 1
    self._opened.clear()
    self._same = None


def without(target, name, replacement):
    """Honest sessions lack something."""
    return lambda: patch.object(target, name, replacement)


@contextmanager
def collapsed_skipped():
    record = MacCheck.record

    def partly(self, opened, mac):
        if isinstance(mac, np.ndarray):
            record(self, opened, mac)

    with patch.object(MacCheck, "record", partly):
        yield


@contextmanager
def words_not_checked():
    def unpack(raw, shape, bits, norm):
        return real(raw, shape, bits, -(1 << 62))

    real = input_mask.unpack
    with patch("spdz.session.filling.unpack", unpack), patch("spdz.values.input_mask.inside", _all_inside):
        yield


def _all_inside(words, bits, norm):
    return np.ones(words.shape, dtype=np.bool_)


def heads_told_away():
    """The beginning of the checks names no heads of the peer's."""
    begin = GallerySession._begin

    def careless(self):
        control = self._agreement.control

        def agreeing(own, *keys):
            return {**control(own, *keys), "heads": own["heads"]}

        with patch.object(self._agreement, "control", agreeing):
            begin(self)

    return patch.object(GallerySession, "_begin", careless)


def huge(evil):
    return Lies(vectors=[np.array([1 << 28, 0, 0, 0])])


def low_word(evil):
    return Lies(instead(WORDS, lambda own, theirs: bytes(5) + own[5:]))


def bent_word(evil):
    return Lies(instead(WORDS, lambda own, theirs: bytes([own[0] ^ 1]) + own[1:]))


def plus_one(exchange):
    return lambda evil: Lies(at_element(exchange, 0, lambda own, theirs: own + 1))


MUTANTS = {
    "u and v all 1": (lambda: weights(ones), cancelling_under(ones)),
    "u and v known before c is sent": (lambda: weights(known_before), cancelling_under(known_before)),
    "collapsed openings skipped": (collapsed_skipped, plus_one(CELL)),
    "bits not recorded": (
        without(MacCheck, "record_bits", lambda self, sigma: None),
        lambda evil: Lies(at_bit(BITS, 0)),
    ),
    "a proof's bits not recorded": (
        without(MacCheck, "record_bits", lambda self, sigma: None),
        lambda evil: Lies(at_bit(PROOF_BITS, 8 * evil), vectors=[np.array([1 << 28, 0, 0, 0])]),
    ),
    "proofs not looked at": (without(GallerySession, "_refuse_unproved", lambda *ignored: None), huge),
    "checks always pass": (
        without(MacCheck, "verify", _believe),
        plus_one(CELL),
    ),
}  # fmt: skip


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("name", MUTANTS)
def test_a_hole_lets_the_lie_through_and_the_real_session_does_not(galleries, name, evil):
    hole, lie = MUTANTS[name]
    with hole():
        found = duel(galleries(TERMS, SLOTS), vectors(), evil, lie(evil))
    assert through(found), found.outcome
    real = duel(galleries(TERMS, SLOTS), vectors(), evil, lie(evil))
    assert isinstance(real.outcome, SpdzError) and real.seen == []


@pytest.mark.parametrize("evil", [0, 1])
def test_without_the_check_before_bits_they_are_sent_for_a_wrong_c(galleries, evil):
    lie = plus_one(CELL)(evil)
    with patch.object(Party, "has_unchecked_openings", property(lambda self: False)):
        found = duel(galleries(TERMS, SLOTS), vectors(), evil, lie)
    assert found.frames[CELL + 1][0] == "DATA" and found.seen == []
    real = duel(galleries(TERMS, SLOTS), vectors(), evil, lie)
    assert [frame[0] for frame in real.frames[CELL:]] == ["DATA", "CHECK"]


@pytest.mark.parametrize("evil", [0, 1])
def test_proofs_come_before_cells(galleries, evil):
    """Proved only when the cells are done, a cheater's bits are out before it is refused."""
    prepare, unproved = GallerySession._prepare, GallerySession._refuse_unproved

    def late(self, session, step, on_block, notes):
        held = []
        session._refuse_unproved = lambda *arguments: held.append(arguments)
        notes = prepare(session, step.filling.stats)
        compare(self, session, step, on_block, notes)
        for arguments in held:
            unproved(session, *arguments)

    compare = Comparing.new
    with ExitStack() as stack:
        stack.enter_context(patch.object(GallerySession, "_prepare", lambda self, stats: NO_NOTES))
        stack.enter_context(patch.object(Comparing, "new", late))
        found = duel(galleries(TERMS, SLOTS), vectors(), evil, huge(evil))
    assert found.error == "ProtocolViolation" and found.seen
    real = duel(galleries(TERMS, SLOTS), vectors(), evil, huge(evil))
    assert real.error == "ProtocolViolation" and not real.seen


@pytest.mark.parametrize("evil", [0, 1])
def test_words_are_looked_at_before_they_are_kept(galleries, evil):
    with words_not_checked():
        found = duel(galleries(TERMS, SLOTS), vectors(), evil, low_word(evil))
    assert len(found.frames) > BEGIN  # kept, and told as held
    real = duel(galleries(TERMS, SLOTS), vectors(), evil, low_word(evil))
    assert real.error == "ProtocolViolation" and len(real.frames) == BEGIN


@pytest.mark.parametrize("evil", [0, 1])
def test_heads_are_compared_before_a_share_is_sent(galleries, evil):
    with heads_told_away():
        found = duel(galleries(TERMS, SLOTS), vectors(), evil, bent_word(evil))
    assert len(found.frames) > PROOF
    real = duel(galleries(TERMS, SLOTS), vectors(), evil, bent_word(evil))
    assert real.error == "TapeMismatch" and len(real.frames) == BEGIN + 1


def test_the_same_error_in_two_collapsed_openings_does_not_cancel():
    """E in one and -E in the next: each has weights of its own, and a place of its own in the hash."""
    opened = field.from_ints(range(1, 7)).reshape(2, 3, 2)

    class Right:
        def __init__(self, alpha, error):
            self.alpha, self.error = alpha, error

        def weighed(self, u, v):
            wrong = field.add(opened, field.from_int(self.error))
            return self.alpha * bilinear(u, wrong, v) % P

    for errors, right in (((0, 0), True), ((1, P - 1), False), ((5, 5), False), ((0, 1), False)):
        alphas, checks = (random_element(), random_element()), []
        for party in (0, 1):
            check = MacCheck(alphas[party], party, b"session")
            for error in errors:
                # Party 1's shares belong to the number that is opened; party 0's do to one that is not.
                check.record(opened, Right(alphas[party], error if party == 0 else 0))
            checks.append(check)
        first, second = checks
        u = [
            check._collapsed(index, opened, entry[1])
            for check in checks
            for index, entry in enumerate(check._opened)
        ]
        assert (u[0] == u[2] and u[1] == u[3]) is right
        if errors[0] and sum(errors) % P == 0:
            assert (u[0] + u[1]) % P != 0  # it would, under the same u and v
        assert (first.message() == second._hash(0)) is right


def test_the_weights_depend_on_all_that_was_said_before():
    """On the session, on both sides' frames, on the check's number and on the opening's place."""
    opened = field.from_ints(range(1, 7)).reshape(2, 3, 2)

    class First:
        def weighed(self, u, v):
            return field.to_int(u[0]) << 127 | field.to_int(v[0])

    def weights(session=b"session", frames=((b"one", b"two"),), checks=0, index=0):
        check = MacCheck(0, 0, session)
        for sent, received in frames:
            check.absorb([sent], received)
        check._checks = checks
        return check._collapsed(index, opened, First())

    changes = [
        {"session": b"another"},
        {"frames": ()},
        {"frames": ((b"one", b"tw0"),)},
        {"frames": ((b"0ne", b"two"),)},
        {"frames": ((b"one", b"two"), (b"", b"3"))},
        {"checks": 1},
        {"index": 1},
    ]
    found = [weights(), *(weights(**change) for change in changes)]
    assert weights() == found[0] and len(set(found)) == len(found)
