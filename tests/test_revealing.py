"""Descriptors that matched are opened: the vectors that were compared, of no other slot, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from gallery_session_helpers import (
    Product,
    Twice,
    cables,
    feed,
    no_errors,
    unit_vectors,
)

from protocols import is_candidate
from protocols.scores import SCORES
from spdz.foundations.errors import (
    ChannelClosed,
    ChannelError,
    OutOfStep,
    PeerAborted,
    SpdzError,
    TapeInUse,
    TapeMismatch,
)
from spdz.readings.gallery import Terms
from spdz.session import GallerySession, revealing
from spdz.session.shelf import Shelf

pytestmark = pytest.mark.usefixtures("no_sync")

SLOTS = (3, 4)
TERMS = Terms(Product(), 4)
SECURITIES = ["malicious", "semi-honest"]


def data(dim=4, counts=SLOTS):
    """Vectors of which x0 matches y0 and y3, x2 matches y2, and x1 nothing."""
    basis = np.linalg.qr(np.random.default_rng(dim).normal(size=(dim, min(dim, 3))))[0].T
    if dim == 1:
        basis = basis[[0, 0, 0]] * [[1], [-1], [1]]
    x, y = basis, np.stack([basis[0], -basis[1], basis[2], 0.9 * basis[0]])
    return x[: counts[0]], y[: counts[1]]


def matched(step):
    """Own slots and the peer's in the pairs of a step that are True."""
    return [sorted(set(slots)) for slots in zip(*step.matches, strict=True)]


def all_pairs(session):
    """Own slots and the peer's that are in any pair that is True."""
    pairs = [
        (block.own.start + i, block.peer.start + j)
        for block in session.results()
        for i, j in np.argwhere(block.results).tolist()
    ]
    return [sorted(set(slots)) for slots in zip(*pairs, strict=True)]


def opening(vectors, *, again=0):
    """Bring everything, and open all that matches."""

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        return own, peer, [session.reveal(own, peer) for _ in range(1 + again)]

    return work


def assert_right(found, vectors):
    """Either side has got the other's quantised vectors, for the slots that it expected."""
    for party, (_, peer, results) in enumerate(found):
        for opened in results:
            assert list(opened) == peer and peer
            for slot, vector in opened.items():
                assert vector.dtype == np.float64 and vector.shape == vectors[0].shape[1:]
                assert np.array_equal(vector * 65536, np.rint(vectors[1 - party][slot] * 65536))


def frames(end):
    """Kind and lengths of the frames from the last opening on."""
    first = max(i for i, frame in enumerate(end.frames) if b'"open"' in frame[1])
    return [(kind, len(sent), len(got)) for kind, sent, got in end.frames[first:]]


# --- what is opened


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("dim", [1, 7, 1536])
@pytest.mark.parametrize("name", ["S10", "S8"])
def test_both_sides_get_the_vectors_that_were_compared(galleries, name, dim, security):
    terms = Terms(is_candidate(SCORES[name].within(1.0), 0.5), dim, security)
    vectors = data(dim)
    assert_right(no_errors(galleries(terms, SLOTS).meet(opening(vectors))), vectors)


@pytest.mark.parametrize("security", SECURITIES)
def test_larger_numbers_take_more_bytes(galleries, security):
    terms = Terms(replace(Product(), threshold=4.5e4, max_norm=300.0), 4, security)
    vectors, ends = [300 * side for side in data()], cables()
    found = no_errors(galleries(terms, SLOTS).meet(opening(vectors), channels=ends))
    assert_right(found, vectors)
    assert frames(ends[0])[1][1] == 4 * 4 * len(found[0][0])


@pytest.mark.parametrize("security", SECURITIES)
def test_opening_takes_one_message_one_round_and_a_check(galleries, security):
    ends, vectors = cables(), data()
    found = no_errors(galleries(Terms(Product(), 4, security), SLOTS).meet(opening(vectors), channels=ends))
    own, peer, _ = found[0]
    control, *rest = frames(ends[0])
    assert control[0] == "CONTROL"
    checks = [("CHECK", 16, 16)] if security == "malicious" else []
    assert rest == [("DATA", 4 * 3 * len(own), 4 * 3 * len(peer)), *checks]


@pytest.mark.parametrize("together", [1, 4, 8, 9])
def test_many_are_opened_some_at_a_time(galleries, monkeypatch, together):
    monkeypatch.setattr(revealing, "_TOGETHER", together)
    ends, vectors = cables(), data()
    found = no_errors(galleries(TERMS, SLOTS).meet(opening(vectors), channels=ends))
    assert_right(found, vectors)
    at_a_time = max(1, together // 4)
    own, peer, _ = found[0]
    rounds = -(-max(len(own), len(peer)) // at_a_time)
    assert [frame[0] for frame in frames(ends[0])] == ["CONTROL"] + ["DATA", "CHECK"] * rounds
    assert max(max(sent, got) for kind, sent, got in frames(ends[0]) if kind == "DATA") <= at_a_time * 12


@pytest.mark.parametrize("security", SECURITIES)
def test_one_side_alone_may_open(galleries, security):
    vectors = data()

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        first = session.reveal(own[:1], []) if session.party == 0 else session.reveal([], peer[:1])
        return first, session.reveal([], [])

    found = no_errors(galleries(Terms(Product(), 4, security), SLOTS).meet(work))
    assert [[list(one) for one in side] for side in found] == [[[], []], [[0], []]]


def test_slots_come_in_any_order_and_as_any_integers(galleries):
    vectors = data()

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        return own, peer, [session.reveal([*own[::-1], own[0]], np.array(peer[::-1], dtype=np.uint8))]

    assert_right(no_errors(galleries(TERMS, SLOTS).meet(work)), vectors)


def test_what_is_returned_is_the_callers_own(galleries):
    vectors = data()

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        for vector in session.reveal(own, peer).values():
            vector[:] = np.nan
        return own, peer, [session.reveal(own, peer)]

    assert_right(no_errors(galleries(TERMS, SLOTS).meet(work)), vectors)


# --- what is not


def refusing(vectors, *wrong, match="no pair"):
    """Refused without a frame; then the same session opens what it may."""

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        count = len(session._channel.frames)
        for change in wrong:
            with pytest.raises(ValueError, match=match):
                session.reveal(*change(own, peer))
        assert len(session._channel.frames) == count
        return own, peer, [session.reveal(own, peer)]

    return work


def test_a_slot_in_no_pair_that_matched_is_neither_opened_nor_expected(galleries):
    """Slot 1 of either party is filled, and like nothing."""
    vectors = data()
    mission = galleries(TERMS, SLOTS)
    mine = refusing(vectors, lambda own, peer: ([*own, 1], peer))
    theirs = refusing(vectors, lambda own, peer: (own, [1, *peer]), lambda own, peer: ([1], []))
    found = no_errors(mission.meet(mine, theirs))
    assert [side[0] for side in found] == [[0, 2], [0, 2, 3]]
    assert_right(found, vectors)


@pytest.mark.parametrize("slot", [3, 63, 1 << 40, -1])
def test_slots_that_are_not_filled_are_refused(galleries, slot):
    vectors = data(counts=(3, 3))
    wrong = (lambda own, peer: ([slot], peer)), (lambda own, peer: (own, [slot]))
    assert_right(no_errors(galleries(TERMS, SLOTS).meet(refusing(vectors, *wrong))), vectors)


@pytest.mark.parametrize("wrong", [["0"], [0.0], [None], [[0]], 0, None], ids=str)
def test_slots_are_numbers(galleries, wrong):
    cases = (lambda own, peer: (wrong, peer)), (lambda own, peer: (own, wrong))
    vectors = data()
    found = galleries(TERMS, SLOTS).meet(refusing(vectors, *cases, match="by their numbers"))
    assert_right(no_errors(found), vectors)


def test_the_number_of_slots_is_bounded(galleries, monkeypatch):
    monkeypatch.setattr(revealing, "MOST", 1)
    vectors = data()

    def work(session):
        (step,) = feed([vectors[session.party]])(session)
        own, peer = matched(step)
        for slots in ((own, []), ([], peer)):
            with pytest.raises(ValueError, match="at most 1 "):
                session.reveal(*slots)
        return own[:1], peer[:1], [session.reveal(own[:1], peer[:1])]

    assert_right(no_errors(galleries(TERMS, SLOTS).meet(work)), vectors)


def test_a_gallery_of_scores_opens_no_descriptors(galleries):
    vectors = data()

    def work(session):
        feed([vectors[session.party]])(session)
        with pytest.raises(ValueError, match="reveals scores"):
            session.reveal([0], [0])
        return session.exchange_note({})

    assert galleries(Terms(Product(None), 4), SLOTS).meet(work) == [{}, {}]


def test_a_match_of_which_a_slot_was_lost_is_none(galleries):
    """Slot 0 of party 1 was its owner's until its ledger was lost: what it matched is not opened for it."""
    x = unit_vectors(np.random.default_rng(3), 3, 4)
    x[1:] = [-x[0], x[0]]
    mission = galleries(TERMS, SLOTS)
    no_errors(mission.meet(feed([x[:1]]), feed([x[:1]])))
    for party in (0, 1):
        with mission.tape(party) as tape, mission.ledger(party, tape) as ledger:
            ledger.slots[1].void([0])

    def work(session):
        for slots in (([0], []), ([], [0])):
            with pytest.raises(ValueError, match="no pair"):
                session.reveal(*slots)
        return session.step().matches

    assert no_errors(mission.meet(work)) == [[], []]


def test_nothing_is_opened_twice_over_by_a_caller_that_is_called_back(galleries):
    """While a step is under way the session is at work."""
    vectors = data()

    def work(session):
        session.add(vectors[session.party])
        session.step(lambda block: session.reveal([0], [0]))

    assert any(isinstance(outcome, TapeInUse) for outcome in galleries(TERMS, SLOTS).meet(work))


def test_without_macs_nothing_is_opened_in_the_malicious_mode(galleries, monkeypatch):
    standing = Shelf.standing
    monkeypatch.setattr(Shelf, "standing", lambda self, slots: replace(standing(self, slots), mac=None))
    for outcome in galleries(TERMS, SLOTS).meet(opening(data())):
        assert isinstance(outcome, ValueError | SpdzError)


# --- the two sides


@pytest.mark.parametrize("change", [lambda own, peer: (own[:1], peer), lambda own, peer: (own, peer[:1])])
def test_sides_that_do_not_agree_open_nothing(galleries, change):
    vectors, ends = data(), cables()

    def other(session):
        (step,) = feed([vectors[session.party]])(session)
        return session.reveal(*change(*matched(step)))

    outcomes = galleries(TERMS, SLOTS).meet(opening(vectors), other, channels=ends)
    assert all(isinstance(outcome, OutOfStep) for outcome in outcomes)
    assert "Agree on them first" in str(outcomes[0])
    assert [frame[0] for frame in frames(ends[0])] == ["CONTROL"]


@pytest.mark.parametrize("call", [lambda s: s.exchange_note({}), lambda s: s.step(), lambda s: s.part(1)])
def test_a_peer_that_does_something_else_is_out_of_step(galleries, call):
    vectors = data()

    def other(session):
        feed([vectors[session.party]])(session)
        return call(session)

    outcomes = galleries(TERMS, SLOTS).meet(opening(vectors), other)
    assert any(isinstance(outcome, OutOfStep | PeerAborted) for outcome in outcomes)
    assert not any(isinstance(outcome, tuple) for outcome in outcomes)


@pytest.mark.parametrize("security", SECURITIES)
def test_other_words_in_a_slot_are_told_before_anything_is_opened(galleries, security):
    """One robot's ledger is another's: no cheat, and the tapes live."""
    vectors, ends = data(), cables()

    class Restored(GallerySession):
        def reveal(self, own, expected):
            self._shelves[1]._eps[0] += 1
            return super().reveal(own, expected)

    mission = galleries(Terms(Product(), 4, security), SLOTS)
    outcomes = mission.meet(opening(vectors), channels=ends, kinds=(GallerySession, Restored))
    assert all(isinstance(outcome, TapeMismatch) for outcome in outcomes)
    assert frames(ends[0])[-1][0] == "CONTROL" and not mission.destroyed(0)


@pytest.mark.parametrize("side", [0, 1])
def test_a_strip_that_was_given_up_on_one_side_opens_nothing_there(galleries, side):
    """Its last frame reached one side alone, and it is not run again."""
    terms, vectors, ends = Terms(Twice(), 4), data(), cables()
    no_errors(galleries(terms, SLOTS).meet(feed([vectors[0]]), feed([vectors[1]]), channels=ends))
    last = len(ends[0].frames) - 1
    mission, ends = galleries(terms, SLOTS), cables()
    ends[side].cut = (last, "sent")
    broken = mission.meet(feed([vectors[0]]), feed([vectors[1]]), channels=ends)
    assert isinstance(broken[side], SpdzError) and not isinstance(broken[1 - side], SpdzError)

    def work(session):
        session.step()
        found = all_pairs(session)
        if session.party == side:
            with pytest.raises(ValueError, match="no pair"):
                session.reveal([0], [0])
        return found, session.reveal([], [])

    outcomes = mission.meet(work)
    assert outcomes[side] == ([], {}) and outcomes[1 - side][1] == {} and outcomes[1 - side][0]


# --- sessions that break


def again(vectors):
    """Open all that the ledger knows to match."""

    def work(session):
        own, peer = all_pairs(session)
        return own, peer, [session.reveal(own, peer)]

    return work


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", ["S10", "S8"])
def test_a_restarted_robot_opens_what_an_earlier_session_has_found(galleries, name, security):
    terms = Terms(is_candidate(SCORES[name].within(1.0), 0.5), 7, security)
    vectors, mission = data(7), galleries(terms, SLOTS)
    no_errors(mission.meet(feed([vectors[0]]), feed([vectors[1]])))
    assert_right(no_errors(mission.meet(again(vectors))), vectors)
    more = no_errors(mission.meet(lambda session: len(session.step().blocks)))
    assert more == [0, 0]


def test_again_is_the_same_bytes_in_every_session(galleries):
    vectors, mission, sent = data(), galleries(TERMS, SLOTS), []
    no_errors(mission.meet(feed([vectors[0]]), feed([vectors[1]])))
    for _ in range(2):
        ends = cables()
        no_errors(mission.meet(again(vectors), channels=ends))
        sent.append([[end.frames[3][1], end.frames[2][1]] for end in ends])
        checks = [end.frames[4][1] for end in ends]
        assert checks[0] != checks[1]
    assert sent[0] == sent[1]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("how", ["unsent", "sent", "torn"])
@pytest.mark.parametrize("side", [0, 1])
def test_a_link_that_breaks_anywhere_is_made_up_for_by_another_session(
    galleries, monkeypatch, side, how, security
):
    monkeypatch.setattr(revealing, "_TOGETHER", 4)
    vectors, mission = data(), galleries(Terms(Product(), 4, security), SLOTS)
    no_errors(mission.meet(feed([vectors[0]]), feed([vectors[1]])))
    ends = cables()
    no_errors(mission.meet(again(vectors), channels=ends))
    last = len(ends[0].frames) - 1
    for number in range(2, last + 1):
        ends = cables()
        ends[side].cut = (number, how)
        outcomes = mission.meet(again(vectors), channels=ends)
        assert isinstance(outcomes[side], ChannelClosed)
        assert isinstance(outcomes[1 - side], ChannelError) or number == last
    assert_right(no_errors(mission.meet(again(vectors))), vectors)


@pytest.mark.parametrize("evil", [0, 1])
def test_a_peer_that_says_it_has_prepared_nothing_is_opened_to_all_the_same(galleries, evil):
    """What its lie makes this side prepare once more is read from the tape."""
    vectors, mission = data(), galleries(TERMS, SLOTS)
    no_errors(mission.meet(feed([vectors[0]]), feed([vectors[1]])))

    class Forgetful(GallerySession):
        def _meet(self):
            control = self._agreement.control
            self._agreement.control = lambda message, *keys: control(message | {"ready": [0, 0]}, *keys)
            super()._meet()
            self._agreement.control = control
            self._ready = [0, 0]

    kinds = [GallerySession, GallerySession]
    kinds[evil] = Forgetful

    def work(session):
        if session.party != evil:
            assert session._ready == [0, 0]
        first = again(vectors)(session)
        session.step()
        return first

    assert_right(no_errors(mission.meet(work, kinds=kinds)), vectors)


def test_what_later_steps_find_is_opened_too(galleries):
    x = unit_vectors(np.random.default_rng(3), 3, 4)
    x[1:] = [-x[0], x[0]]

    def work(session):
        found = []
        for new in (x[:1], x[1:]):
            session.add(new)
            found.append(matched(session.step()))
            session.reveal(*found[-1])
        return found

    assert no_errors(galleries(TERMS, SLOTS).meet(work)) == [[[[0], [0]], [[0, 1, 2], [0, 1, 2]]]] * 2
