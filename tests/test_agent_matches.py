"""Matches as records: what is news, what is owed, what is held against a peer."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from protocols.agent.keyframe import Keyframe, Verdict
from protocols.agent.matches import Matches, Outcome
from protocols.agent.news import News
from protocols.agent.records import Records
from protocols.agent.strikes import Strikes
from spdz.foundations.errors import ProtocolViolation

VECTOR = np.array([0.6, 0.8])


@pytest.fixture
def records(tmp_path: Path) -> Iterator[Records]:
    opened = Records(tmp_path, "0" * 32)
    yield opened
    opened.close()


@pytest.fixture
def matches(records: Records) -> Matches:
    return Matches(records, "bob", "lidar")


def test_a_pair_is_found_once(matches: Matches) -> None:
    assert [news.number for news in matches.found([(0, 1), (2, 3)])] == [1, 2]
    assert matches.found([(0, 1)]) == []
    assert matches.pairs() == {(0, 1), (2, 3)}


def test_a_peer_is_shown_no_more_than_it_may_owe(matches: Matches) -> None:
    pairs = [(i, i) for i in range(6)]
    matches.found(pairs)
    assert matches.trust(pairs, 3) == pairs[:3]
    assert matches.trust(pairs[::-1], 3) == pairs[2::-1]  # it took these, and hung up
    matches.show([(1, Keyframe(7, VECTOR))])
    assert matches.trust(pairs, 3) == pairs[:3]  # what it has shown may be rubbish
    matches.settle(2, Verdict(True))
    assert matches.trust(pairs, 3) == pairs[:4]


def test_strikes_and_what_is_owed_in_any_gallery_count_together(records: Records, matches: Matches) -> None:
    pairs, camera = [(i, i) for i in range(6)], Matches(records, "bob", "camera")
    matches.found(pairs)
    camera.found(pairs)
    matches.settle(1, Verdict(False, "another place"))
    assert camera.trust(pairs, 3) == pairs[:2]
    assert matches.trust(pairs[1:], 3) == []
    camera.take_back(pairs[:1])
    assert matches.trust(pairs[1:], 3) == [(1, 1)]
    Strikes(records, "bob").forgive()
    assert matches.trust(pairs[1:], 3) == [(1, 1), (2, 2)]


def test_trust_is_durable(tmp_path: Path) -> None:
    pairs = [(i, i) for i in range(4)]
    records = Records(tmp_path, "0" * 32)
    Matches(records, "bob", "lidar").found(pairs)
    Matches(records, "bob", "lidar").trust(pairs[:2], 2)
    records.close()
    records = Records(tmp_path, "0" * 32)
    assert Matches(records, "bob", "lidar").trust(pairs[2:], 2) == []
    records.close()


def test_a_rejected_match_is_a_strike_and_a_late_one_is_none_any_more(
    records: Records, matches: Matches
) -> None:
    matches.found([(0, 0), (1, 1)])
    news = matches.withhold((0, 0), "bob shows nothing")
    assert news is not None and news.state == "withheld"
    assert matches.withhold((0, 0), "again") is None
    assert matches.settle(2, Verdict(False, "another place")).state == "rejected"
    assert Strikes(records, "bob").reasons == ["bob shows nothing", "not verified: another place"]
    assert Strikes(records, "carol").reasons == []
    assert matches.settle(1, Verdict(True)).state == "verified"
    assert Strikes(records, "bob").reasons == ["not verified: another place"]
    assert [(one.match, one.state) for one in News(records).after(0)] == [
        (1, "candidate"), (2, "candidate"), (1, "withheld"), (2, "rejected"), (1, "verified"),
    ]  # fmt: skip


def test_verdicts_are_told_until_they_were_heard(matches: Matches) -> None:
    matches.found([(0, 5)])
    matches.settle(1, Verdict(True))
    (outcome,) = matches.untold(8)
    assert outcome == Outcome((0, 5), "verified")
    matches.told([outcome])
    assert matches.untold(8) == []


def test_the_peer_s_verdict_on_a_pair_that_is_no_match_is_nothing(records: Records, matches: Matches) -> None:
    matches.found([(0, 5)])
    matches.hear([Outcome((0, 5), "rejected"), Outcome((9, 9), "verified")])
    assert [one.peer_state for one in News(records).after(0)] == ["rejected"]


def test_galleries_and_peers_have_matches_of_their_own(records: Records, matches: Matches) -> None:
    matches.found([(0, 0)])
    for other in (Matches(records, "carol", "lidar"), Matches(records, "bob", "camera")):
        assert other.pairs() == set() and other.trust([(0, 0)], 3) == [(0, 0)]


def test_a_peer_s_number_is_of_one_keyframe(records: Records, matches: Matches) -> None:
    camera = Matches(records, "bob", "camera")
    matches.show([(1, Keyframe(7, VECTOR, b"scan", 1.0)), (2, Keyframe(7, -VECTOR, b"scan", 1.0))])
    camera.show([(5, Keyframe(7, VECTOR, b"scan", 1.0))])
    Matches(records, "carol", "lidar").show([(1, Keyframe(7, VECTOR, b"another", 1.0))])
    for other in (Keyframe(7, VECTOR, b"another", 1.0), Keyframe(7, VECTOR, b"scan", 2.0)):
        with pytest.raises(ProtocolViolation, match="two keyframes of the number 7"):
            camera.show([(6, other)])
    assert camera.shown([5, 6]) == {5}
