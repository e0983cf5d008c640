"""An insider opens something else than what was compared: caught before anything is returned."""

from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from gallery_insider import Lies, instead
from gallery_session_helpers import Product, cables, feed, no_errors
from test_revealing import SLOTS, TERMS, again, all_pairs, assert_right, data

from spdz.foundations.errors import ChannelClosed, MacCheckFailed, ProtocolViolation, SpdzError
from spdz.readings.gallery import Terms
from spdz.rounds.mac_check import MacCheck
from spdz.session import GallerySession, revealing

pytestmark = pytest.mark.usefixtures("no_sync")

OPENED = [0, 2], [0, 2, 3]
"""Slots of party 0 and of party 1 that match."""
DIM, SIZE, NORM = 4, 3, TERMS.norm
TELL, SHOW, CHECK = 2, 3, 4
"""The exchanges of an opening in a fresh session; the greeting is 0, the account 1."""


@pytest.fixture
def compared(galleries):
    """A gallery in which everything was compared."""

    def make(terms=TERMS):
        mission, vectors = galleries(terms, SLOTS), data()
        no_errors(mission.meet(feed([vectors[0]]), feed([vectors[1]])))
        return mission

    return make


@dataclass
class Found:
    """What the honest side did: what it returned or raised, and its frames from the opening on."""

    outcome: Any
    frames: list[Any]
    mission: Any
    honest: int

    @property
    def error(self):
        return type(self.outcome).__name__

    @property
    def destroyed(self):
        return self.mission.destroyed(self.honest)


def duel(mission, evil, lies, *, cut=None, timeout=5.0, kind=None):
    ends, kinds = cables(timeout), [GallerySession, GallerySession]
    kinds[evil] = kind or lies
    ends[evil].cut = cut
    outcome = mission.meet(again(data()), channels=ends, kinds=kinds)[1 - evil]
    return Found(outcome, [frame[0] for frame in ends[1 - evil].frames[TELL:]], mission, 1 - evil)


def lying(change, exchange=SHOW):
    """Say ``change(own, theirs)`` in one exchange, and go on as if it had told the truth."""
    return Lies(instead(exchange, change), follow=False)


def numbers(frame):
    return [int.from_bytes(frame[i : i + SIZE], "little") - NORM for i in range(0, len(frame), SIZE)]


def frame_of(values):
    return b"".join((value + NORM).to_bytes(SIZE, "little") for value in values)


def at(index, change):
    def lie(own, theirs):
        said = numbers(own)
        said[index] = change(said[index])
        return frame_of(said)

    return lie


@pytest.mark.parametrize("evil", [0, 1])
def test_without_a_lie_it_gets_through(compared, evil):
    found = duel(compared(), evil, Lies())
    own, peer, _ = found.outcome
    assert (own, peer) == (OPENED[1 - evil], OPENED[evil])
    assert found.frames == ["CONTROL", "DATA", "CHECK"]


@pytest.mark.parametrize("evil", [0, 1])
def test_any_coordinate_that_is_off_by_any_number_is_caught(compared, evil):
    for index in range(DIM * len(OPENED[evil])):
        for change in (
            lambda n: n + (1 if n < NORM else -1),
            lambda n: -n + (n == 0),
            lambda n: -NORM if n > 0 else NORM,
        ):
            found = duel(compared(), evil, lying(at(index, change)))
            assert isinstance(found.outcome, MacCheckFailed), (index, found.outcome)
            assert "opened is not the one that was compared" in str(found.outcome)
            assert found.frames == ["CONTROL", "DATA", "CHECK"] and found.destroyed


OTHERS = {
    "zeros": lambda own, theirs: frame_of([0] * len(numbers(own))),
    "the other way round": lambda own, theirs: frame_of([-n for n in numbers(own)]),
    "its slots in another order": lambda own, theirs: own[DIM * SIZE :] + own[: DIM * SIZE],
    "one of its slots instead of another": lambda own, theirs: own[DIM * SIZE :] + own[-DIM * SIZE :],
    "what the honest side has just opened": lambda own, theirs: (theirs[DIM * SIZE :] * 3)[: len(own)],
    "all a little longer": lambda own, theirs: frame_of([n + (n > 0) - (n < 0) for n in numbers(own)]),
    "two coordinates that cancel": lambda own, theirs: frame_of(
        [numbers(own)[0] - 1, numbers(own)[1] + 1, *numbers(own)[2:]]
    ),
    "another vector of its gallery": lambda own, theirs: frame_of(
        [*np.rint(data()[len(own) > 2 * DIM * SIZE][1] * 65536).astype(int).tolist(), *numbers(own)[DIM:]]
    ),
}  # fmt: skip


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("what", OTHERS)
def test_another_vector_is_caught(compared, evil, what):
    found = duel(compared(), evil, lying(OTHERS[what]))
    assert (found.error, found.frames[-1], found.destroyed) == ("MacCheckFailed", "CHECK", True)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("error", [1, -1, 1 << 10])
def test_an_insider_that_goes_on_with_its_lie_is_caught_as_well(compared, evil, error):
    """Mask and vector moved together: all that it does not know is its part of alpha times the error."""

    class Follows(GallerySession):
        def reveal(self, own, expected):
            shelf = self._shelves[self.party]
            standing = shelf.standing

            def moved(slots):
                known = standing(slots)
                known.s[:, 0] -= error
                return known

            shelf.standing = moved
            return super().reveal(own, expected)

    found = duel(compared(), evil, None, kind=Follows)
    assert (found.error, found.destroyed) == ("MacCheckFailed", True)


@pytest.mark.parametrize("evil", [0, 1])
def test_numbers_out_of_range_are_refused_before_a_check(compared, evil):
    for index in (0, DIM * len(OPENED[evil]) - 1):
        for word in (2 * NORM + 1, 1 << 18, (1 << 24) - 1):
            found = duel(compared(), evil, lying(at(index, lambda n, word=word: word - NORM)))
            assert (found.error, found.frames) == ("ProtocolViolation", ["CONTROL", "DATA"])
            assert not found.destroyed
        for word in (0, 2 * NORM):  # the last ones in range, and not the ones that were compared
            found = duel(compared(), evil, lying(at(index, lambda n, word=word: word - NORM)))
            assert found.error == "MacCheckFailed"


@pytest.mark.parametrize("bit", [0, 9, 8 * DIM * SIZE, 8 * DIM * SIZE + 3])
def test_a_bit_that_is_flipped_on_the_line_fails_the_check_of_both(compared, bit):
    mission, ends = compared(), cables()

    def flip(number, kind, own, theirs):
        return (int.from_bytes(own, "little") ^ (number == SHOW) << bit).to_bytes(len(own), "little")

    ends[1].say = flip
    outcomes = mission.meet(again(data()), channels=ends)
    assert isinstance(outcomes[0], MacCheckFailed) and isinstance(outcomes[1], SpdzError)
    assert mission.destroyed(0)


FORGERIES = {
    "random": lambda own, theirs: bytes(range(16)),
    "zeros": lambda own, theirs: bytes(16),
    "the honest hash": lambda own, theirs: theirs,
    "its own, a bit changed": lambda own, theirs: own[:-1] + bytes([own[-1] ^ 128]),
}


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", FORGERIES)
def test_a_forged_check_is_refused(compared, evil, how):
    found = duel(compared(), evil, lying(FORGERIES[how], CHECK))
    assert (found.error, found.destroyed) == ("MacCheckFailed", True)


@pytest.mark.parametrize("evil", [0, 1])
def test_the_check_of_an_earlier_session_is_worth_nothing(compared, evil):
    mission, before = compared(), []
    keep = lying(lambda own, theirs: before.append(own) or own, CHECK)
    assert not isinstance(duel(mission, evil, keep).outcome, SpdzError)
    found = duel(mission, evil, lying(lambda own, theirs: before[0], CHECK))
    assert found.error == "MacCheckFailed"


@pytest.mark.parametrize("evil", [0, 1])
def test_frames_of_other_lengths_are_refused(compared, evil):
    for exchange in (SHOW, CHECK):
        for change in (
            lambda own, theirs: own[:-1],
            lambda own, theirs: own + b"\0",
            lambda own, theirs: b"",
        ):
            found = duel(compared(), evil, lying(change, exchange), timeout=0.5)
            assert found.error == "ProtocolViolation" and not found.destroyed


CLAIMS = {
    "that it opens less": lambda opened, evil: _side(opened, evil, opened[evil][:1]),
    "that it opens nothing": lambda opened, evil: _side(opened, evil, []),
    "that it opens a slot in no pair that matched": lambda opened, evil: _side(opened, evil, [0, 1]),
    "that it expects a slot in no pair that matched": lambda opened, evil: _side(opened, 1 - evil, [0, 1, 2]),
    "that it expects more": lambda opened, evil: _side(opened, 1 - evil, [0, 1, 2, 3]),
    "the sides exchanged": lambda opened, evil: opened[::-1],
    "no slots": lambda opened, evil: None,
    "text": lambda opened, evil: "all",
    "a great many": lambda opened, evil: [list(range(5000)), []],
}  # fmt: skip


def _side(opened, owner, slots):
    return [slots if i == owner else one for i, one in enumerate(opened)]


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("claim", CLAIMS)
def test_a_peer_that_says_something_else_gets_nothing(compared, evil, claim):
    def control(number, message):
        return message | {"open": CLAIMS[claim](message["open"], evil)} if number == TELL else message

    found = duel(compared(), evil, Lies(control=control, follow=False))
    assert (found.error, found.frames) == ("OutOfStep", ["CONTROL"])
    assert len(str(found.outcome)) < 400 and not found.destroyed


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("words", ["", "0" * 64, None, 5])
def test_a_peer_that_names_other_words_gets_nothing(compared, evil, words):
    def control(number, message):
        return message | {"words": words} if number == TELL else message

    found = duel(compared(), evil, Lies(control=control, follow=False))
    assert (found.error, found.frames, found.destroyed) == ("TapeMismatch", ["CONTROL"], False)


@pytest.mark.parametrize("evil", [0, 1])
def test_what_the_peer_calls_a_match_is_none(compared, evil):
    """It asks for slot 1, and so does this side's own caller."""

    class Gullible(GallerySession):
        def reveal(self, own, expected):
            self._revealing._matched[0].add(1)
            self._revealing._matched[1].add(1)
            return super().reveal([*own, 1], [*expected, 1])

    def work(session):
        own, peer = all_pairs(session)
        if session.party == evil:
            return session.reveal(own, peer)
        with pytest.raises(ValueError, match="no pair"):
            session.reveal([*own, 1], peer)
        return session.reveal(own, peer)

    ends, kinds = cables(), [GallerySession, GallerySession]
    kinds[evil] = Gullible
    outcomes = compared().meet(work, channels=ends, kinds=kinds)
    assert type(outcomes[1 - evil]).__name__ == "OutOfStep"
    assert [frame[0] for frame in ends[1 - evil].frames[TELL:]] == ["CONTROL"]


@pytest.mark.parametrize("evil", [0, 1])
def test_a_vector_that_is_too_long_is_not_opened_where_norms_are_not_proved(galleries, evil):
    """It matches more than it should, and gets this side's descriptor; it has none that would pass."""
    mission = galleries(Terms(Product(), 4, proof=False), SLOTS)
    vectors = data()
    huge = Lies(vectors=[np.rint(1.8 * 65536 * vectors[1 - evil][0]).astype(np.int64)], follow=False)

    def work(session):
        if session.party != evil:
            session.add(vectors[session.party])
        session.step()
        own, peer = all_pairs(session)
        assert own and peer
        return session.reveal(own, peer)

    kinds = [GallerySession, GallerySession]
    kinds[evil] = huge
    outcome = mission.meet(work, channels=cables(), kinds=kinds)[1 - evil]
    assert isinstance(outcome, ProtocolViolation), outcome


# --- a peer that leaves


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", ["unsent", "torn", "sent"])
@pytest.mark.parametrize("exchange", [SHOW, CHECK])
def test_a_peer_that_takes_and_hangs_up_gets_no_more_the_next_time(compared, evil, how, exchange):
    """It has what this side opened: there is no fairness. This side's tape lives."""
    mission = compared()
    found = duel(mission, evil, None, kind=GallerySession, cut=(exchange, how))
    if (exchange, how) == (CHECK, "sent"):
        assert not isinstance(found.outcome, SpdzError)
    else:
        assert isinstance(found.outcome, ChannelClosed)
    assert not found.destroyed
    assert_right(no_errors(mission.meet(again(data()))), data())


@pytest.mark.parametrize("evil", [0, 1])
def test_a_liar_that_leaves_before_the_check_can_lie_again_and_is_caught_at_the_first_check(compared, evil):
    mission, lie = compared(), lying(at(0, lambda n: n - 1 if n > 0 else n + 1))
    for _ in range(3):
        found = duel(mission, evil, lie, cut=(CHECK, "unsent"))
        assert isinstance(found.outcome, ChannelClosed) and not found.destroyed
    assert duel(mission, evil, lie).error == "MacCheckFailed"


# --- holes


def not_of(evil):
    """What one party opens is recorded by neither."""

    def partly(mac_check, standing, received):
        if standing.owner != evil:
            record(mac_check, standing, received)

    return patch.object(revealing, "_record", partly)


def clipping(raw, shape, bits):
    return np.minimum(read_packed(raw, shape, bits), 2 * NORM)


def believe(self, received, expected=None):
    self._checks += 1
    self._opened.clear()
    self._same = None


record, read_packed = revealing._record, revealing.read_packed
OFF = lying(at(0, lambda n: n - 1 if n > 0 else n + 1))
HOLES = {
    "what the peer opens is not recorded": (not_of, TERMS, OFF),
    "checks always pass": (lambda evil: patch.object(MacCheck, "verify", believe), TERMS, OFF),
    "the range is not checked": (
        lambda evil: patch.object(revealing, "read_packed", clipping),
        Terms(Product(), 4, "semi-honest"),
        lying(at(0, lambda n: NORM + 1)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("hole", HOLES)
def test_a_hole_lets_the_lie_through_and_the_real_session_does_not(compared, evil, hole):
    cut, terms, lie = HOLES[hole]
    with cut(evil):
        found = duel(compared(terms), evil, lie)
    assert not isinstance(found.outcome, SpdzError), found.outcome
    assert isinstance(duel(compared(terms), evil, lie).outcome, SpdzError)


@pytest.mark.parametrize("evil", [0, 1])
def test_in_the_semi_honest_mode_another_vector_is_believed(compared, evil):
    found = duel(compared(Terms(Product(), 4, "semi-honest")), evil, OFF)
    with pytest.raises(AssertionError):
        assert_right([found.outcome, ([], [], [])][:: 1 if evil else -1], data())
