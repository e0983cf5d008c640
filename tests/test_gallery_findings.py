"""Galleries against peers that look for a second answer, or for more than their share.

What a mask was used for is durable before anything depends on it; and what a peer makes this side do is
bounded.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from gallery_session_helpers import Cosine, Product, cables, feed, no_errors, table, unit_vectors

from dealer.gallery import BandKeys
from protocols.gallery import Gallery
from spdz import OutOfStep, ProtocolViolation, TapeMismatch, dot, mask, nonnegative
from spdz.arithmetic.short import MOST_BITS
from spdz.channels.frames import MAX_FRAME
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import measure_gallery
from spdz.session import filling
from spdz.session.admission import pinned_text
from spdz.session.comparing import CELL_BYTES, Comparing
from spdz.session.filling import Filling
from spdz.session.gallery import GallerySession
from spdz.session.meeting import MOST
from spdz.session.strips import STRIP_PAIRS
from spdz.values.input_mask import element_bytes, provable_bits

pytestmark = pytest.mark.usefixtures("no_sync")

X = unit_vectors(np.random.default_rng(8), 3, 4)


# -- one mask, one answer ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Counts:
    """Opens, of a slot, how many coordinates reach a public threshold, behind a mask."""

    threshold: float
    max_norm: float = 1.0

    async def prepare(self, engine, vectors):
        bits = await nonnegative(vectors.plus_raw(-round(self.threshold * 65536)))
        return tuple(await mask(bits.sum()))

    async def compare(self, engine, x, y):
        return await nonnegative(dot(x[0], y[0]))


class HangsUp(GallerySession):
    """It leaves when it has seen what preparing opens, before anything of it is noted."""

    def _refuse_unproved(self, owner, slots, proofs):
        raise RuntimeError("hung up")


@pytest.mark.parametrize("quits", [(0,), (1,), (0, 1)])
def test_a_slot_is_prepared_for_one_text_alone(galleries, quits):
    """With another, its masks would show the difference of two counts."""
    first, second = Terms(Counts(0.0), 4, proof=False), Terms(Counts(0.3), 4, proof=False)
    assert measure_gallery(first).recipe == measure_gallery(second).recipe
    mission = galleries(first, (16, 16))
    kinds = [HangsUp if party in quits else GallerySession for party in (0, 1)]
    for party, outcome in enumerate(mission.meet(feed([X]), lambda session: session.step(), kinds=kinds)):
        assert isinstance(outcome, RuntimeError) or party not in quits
    for party in (0, 1):
        with mission.tape(party) as tape, mission.ledger(party, tape) as ledger:
            assert ledger.text == pinned_text(measure_gallery(first), first)
            assert ledger.flight is None
    for outcome in replace(mission, terms=second).meet(lambda session: session.step()):
        assert isinstance(outcome, TapeMismatch) and "another threshold or program" in str(outcome)
    no_errors(mission.meet(lambda session: session.step()))


def test_a_slot_that_was_told_void_stays_void_when_the_peer_hangs_up(galleries, monkeypatch):
    """Else the peer knew of words that are sent later that the mask did not suit, or that it did."""
    mission, real, told = galleries(Terms(Product(), 4), (16, 16)), filling.inside, []

    def unlucky(words, bits, norm):
        good = real(words, bits, norm)
        good[0] = False
        return good

    class Listens(GallerySession):
        def step(self):
            offer = {"from": 0, "slots": 0, "void": [], "more": False}
            told.append(self._agreement.control(offer, *offer)["void"])
            raise RuntimeError("hung up")

    with monkeypatch.context() as patched:
        patched.setattr(filling, "inside", unlucky)
        patched.setattr("spdz.session.filling._BYTES", 1)  # a slot at a time
        mission.meet(feed([X]), lambda session: session.step(), kinds=(GallerySession, Listens))
    assert told == [[0]]
    steps = no_errors(mission.meet(feed([X]), feed([X])))
    assert steps[0][0].own == [1, 2, 3] and steps[1][0].peer == [1, 2, 3]


def test_descriptors_in_half_prepared_slots_are_brought_again(galleries):
    """Preparing takes several openings, so its slots are void; their descriptors must not be lost by it."""
    terms = Terms(Cosine(), 4)
    mission, ends = galleries(terms, (16, 16)), cables()
    ends[1].cut = (7, "unsent")  # in the middle of preparing
    outcomes = mission.meet(feed([X]), feed([X]), channels=ends)
    assert all(isinstance(outcome, Exception) for outcome in outcomes)
    for party in (0, 1):
        with mission.tape(party) as tape, mission.ledger(party, tape) as ledger:
            assert [(slots.filled, slots.ready) for slots in ledger.slots] == [(3, 0)] * 2

    def back(session):
        assert session.filled == [] and session.room == 10
        (step,) = feed([X[:0]])(session)
        assert np.array_equal(session.plain(session.filled), np.rint(X * 65536))
        return step.own, step.peer, table(session, step.blocks)

    for own, peer, found in no_errors(mission.meet(back)):
        assert own == peer == [3, 4, 5]
        assert (found[3:6, 3:6] != -1).all() and (np.diag(found[3:6, 3:6]) == 1).all()


def test_descriptors_are_read_back_from_slots_that_were_filled_and_not_prepared(galleries):
    class Dies(GallerySession):
        def _prepare(self, stats):
            raise RuntimeError("power cut")

    mission = galleries(Terms(Product(), 4), (16, 16))
    mission.meet(feed([X]), feed([X]), kinds=(Dies, GallerySession))
    for found in no_errors(mission.meet(lambda session: session.plain(session.filled))):
        assert np.array_equal(found, np.rint(X * 65536))


# -- what a peer may say ----------------------------------------------------------------------------------


def offered(terms, answer, filled=0, capacity=1 << 16):
    """What a side makes of an offer."""
    header = SimpleNamespace(party=0, capacity=(capacity, capacity))
    side = Filling(SimpleNamespace(header=header), terms, None, (None, None), None, b"", [])
    return side._read_offer({"from": filled, "void": [], "more": False} | answer, filled)


def test_an_offer_is_no_more_than_one_frame_and_so_many_slots():
    small, large = Terms(Product(), 16), Terms(Product(), 1 << 14)
    size = large.dim * element_bytes(large.word_bits)
    most = MAX_FRAME // size
    assert most < MOST
    for terms, count in ((small, MOST), (large, most)):
        assert offered(terms, {"slots": count, "more": True}) == (count, set())
        with pytest.raises(ProtocolViolation):
            offered(terms, {"slots": count + 1})
    assert offered(large, {"slots": most + 9, "void": list(range(9))})[0] == most + 9
    with pytest.raises(ProtocolViolation):  # told twice, it still saves the words of one slot only
        offered(large, {"slots": most + 9, "void": [0] * 9})
    with pytest.raises(ProtocolViolation):
        offered(small, {"slots": 3}, filled=30, capacity=32)


def test_who_has_more_to_bring_brings_some_now():
    assert offered(Terms(Product(), 4), {"slots": 0}) == (0, set())
    with pytest.raises(ProtocolViolation):
        offered(Terms(Product(), 4), {"slots": 0, "more": True})


class Peer:
    """A session at whose other end somebody says what he likes."""

    def __init__(self, note, late=0):
        self.note, self.late = note, late

    def exchange_note(self, note):
        return self.note

    def step(self, on_block, *, into):
        into.peer.append(self.late)
        on_block(self.late)


def at_step(number):
    """A gallery on a fresh connection, without its tape."""
    gallery = Gallery.__new__(Gallery)
    gallery._fresh, gallery._number, gallery._waiting, gallery._step = True, number, [], None
    gallery._on_block = lambda block: None
    return gallery


@pytest.mark.parametrize("number", [None, 1])
@pytest.mark.parametrize(
    "note",
    [{}, {"stop": 1}, {"step": 1, "and": 2}, {"step": -1}, {"step": 1 << 53}, {"step": int("9" * 4000)}],
    ids=lambda note: str(note)[:20],
)
def test_a_note_that_is_no_number_of_steps_is_refused(note, number):
    gallery = at_step(number)
    with pytest.raises(ProtocolViolation):
        gallery._catch_up(Peer(note))
    assert gallery._number == number


def test_what_a_peer_brings_while_it_is_served_belongs_to_the_next_step():
    gallery, shown = at_step(2), []
    gallery._on_block = shown.append
    gallery._catch_up(Peer({"step": 1}, 7))
    assert gallery.partial.peer == shown == [7] and gallery._number == 2


def test_a_robot_takes_no_number_that_it_could_not_say_itself():
    gallery = at_step(None)
    gallery._catch_up(Peer({"step": (1 << 53) - 1}))
    assert gallery._number == (1 << 53) - 1
    with pytest.raises(OutOfStep):
        at_step(1)._catch_up(Peer({"step": 3}))


# -- bounds that both sides share -------------------------------------------------------------------------


def test_both_sides_cut_strips_alike_where_they_store_different_amounts():
    made = []
    for stored in ((10, 4096), (4096, 10), (4096, 4096)):
        plan = SimpleNamespace(pair=SimpleNamespace(correction_bytes=stored))
        made.append(Comparing(None, None, plan, None, (None, None))._most_pairs)
    assert made == [CELL_BYTES // 4096] * 3 and made[0] < STRIP_PAIRS


def longest(dim, security="malicious"):
    """Terms with the longest words that a gallery takes, to half a bit."""
    for half_bits in range(44, 0, -1):
        try:
            return Terms(Product(0.0, 2.0 ** (half_bits / 2)), dim, security, None)
        except ValueError as error:
            assert "57 bits" in str(error)
    raise AssertionError


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("dim", [8, 16, 512, 1536])
def test_words_are_no_longer_than_their_products_and_proofs_take(dim, security):
    """Limb products take 58 bits, the sign among them: with longer words no pair could be compared."""
    most = min(provable_bits(dim), MOST_BITS - 1)
    assert longest(dim, security).word_bits in (most, most - 1)


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_the_longest_words_are_compared(galleries, security):
    terms = longest(8, security)
    assert terms.word_bits >= MOST_BITS - 2
    vectors = np.full((3, 8), terms.program.max_norm / np.sqrt(8.0) * 0.999)
    vectors[1] *= -1
    vectors[2, :3] *= -1
    for steps in no_errors(galleries(terms, (4, 4)).meet(feed([vectors]))):
        assert np.array_equal(steps[0].blocks[0].results, vectors @ vectors.T >= 0)


# -- secrets ----------------------------------------------------------------------------------------------


def test_what_is_dealt_or_waits_is_in_no_repr():
    keys = BandKeys.fresh((1, 2))
    assert repr(keys.of[0][0][0]) not in repr(keys)
    waiting = [np.array([123456, 654321])]
    text = repr(Filling(None, None, None, (None, None), None, b"", waiting))
    assert "123456" not in text and "654321" not in text
