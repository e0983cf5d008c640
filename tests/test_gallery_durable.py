"""What a gallery's session sends is durable before, in its mark on the disk; and how few steps that takes."""

import numpy as np
import pytest
from gallery_session_helpers import Cosine, Product, cables, feed, no_errors, unit_vectors

from spdz.gallery.mark_file import MarkFile
from spdz.gallery.runs import slots_in
from spdz.readings.gallery import Terms
from spdz.session import GallerySession
from spdz.session.comparing import Comparing

pytestmark = pytest.mark.usefixtures("no_sync")

X, Y = unit_vectors(np.random.default_rng(5), 9, 4), unit_vectors(np.random.default_rng(6), 7, 4)


class Checked(GallerySession):
    """Before anything is sent, looks at the mark: what was opened to prepare slots is noted."""

    def __init__(self, tape, ledger, channel, terms):
        exchange = channel.exchange

        def checked(*arguments):
            mark = mark_of(ledger)
            for side, ready in zip(mark.sides, getattr(self, "_ready", [0, 0]), strict=True):
                assert set(range(ready)) <= {*slots_in(side.noted), *slots_in(side.void)}
                assert mark.text is not None or not ready
            return exchange(*arguments)

        channel.exchange = checked
        super().__init__(tape, ledger, channel, terms)


def mark_of(ledger):
    path = ledger._journal._marks.path
    tape, party = path.stem.rsplit("-", 1)
    return MarkFile(path.parent, tape, int(party)).read()


def steps(session):
    return mark_of(session._ledger).sequence


def no_slot_left(mission):
    for party in (0, 1):
        with mission.tape(party) as tape, mission.ledger(party, tape) as ledger:
            assert [slots.ready for slots in ledger.slots] == [slots.filled for slots in ledger.slots]


@pytest.mark.parametrize("terms", [Terms(Product(), 4), Terms(Cosine(), 4)])
def test_notes_are_durable_before_more_is_sent_however_many_slots_come(galleries, monkeypatch, terms):
    for module in ("gallery", "meeting"):
        monkeypatch.setattr(f"spdz.session.{module}.PREPARED", 2)
    monkeypatch.setattr("spdz.session.filling.MOST", 3)
    mission = galleries(terms, (16, 16))
    no_errors(mission.meet(feed([X, X[:0]]), feed([Y[:4], Y[4:]]), kinds=(Checked, Checked)))
    no_slot_left(mission)


@pytest.mark.parametrize("side", [0, 1])
def test_notes_are_durable_before_a_strip_is_run_again_for_a_peer_that_missed_it(
    galleries, monkeypatch, side
):
    dealt = galleries(Terms(Product(), 4), (16, 16))
    found, run_strip = [], Comparing._run_strip

    def watched(comparing, strip, connection, step, on_block, notes):
        kept = strip.rows.stop <= comparing.ledger.done[0] and strip.columns.stop <= comparing.ledger.done[1]
        found.append(kept and any(notes))
        run_strip(comparing, strip, connection, step, on_block, notes)

    monkeypatch.setattr(Comparing, "_run_strip", watched)
    for number in range(3, 20):
        mission = dealt.copy(dealt.folder / f"{side} {number}")
        ends = cables()
        ends[side].cut = number, "sent"
        outcomes = mission.meet(feed([X[:3]]), feed([Y[:3]]), channels=ends)
        no_errors(mission.meet(feed([X[3:5]]), feed([Y[3:5]]), kinds=(Checked, Checked)))
        no_slot_left(mission)
        if not any(isinstance(outcome, BaseException) for outcome in outcomes):
            break
    assert any(found)


def test_a_keyframe_takes_three_durable_steps(galleries):
    mission = galleries(Terms(Product(), 4), (16, 16))

    def work(session):
        counts = []
        for mine, theirs in ((2, 2), (1, 0), (0, 1), (1, 1), (0, 0)):
            before = steps(session)
            brought = (X if session.party == 0 else Y)[: mine if session.party == 0 else theirs]
            feed([brought])(session)
            counts.append(steps(session) - before)
        return counts

    for counts in no_errors(mission.meet(work)):
        assert counts == [4, 3, 3, 6, 0]  # fill, fill, notes and begin, commit; and so on


def test_text_is_pinned_once_any_slot_is_filled(galleries):
    mission = galleries(Terms(Product(), 4), (16, 16))

    def work(session):
        texts = []
        for count in (0, 1):
            feed([X[:count] if session.party == 0 else X[:0]])(session)
            texts.append(session._ledger.text is not None)
        return texts

    assert no_errors(mission.meet(work)) == [[False, True]] * 2
