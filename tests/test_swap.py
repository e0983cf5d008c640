"""Byte strings that two robots swap: bounded before they are received, and those that were announced."""

import hashlib
import json

import numpy as np
import pytest
from gallery_insider import Lies, tell_the_truth
from gallery_session_helpers import Product, cables, feed, no_errors, unit_vectors
from session_helpers import deal, run_pair, state_dirs

from protocols.scores import SCORES
from spdz.foundations.errors import (
    ChannelError,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
)
from spdz.readings.gallery import Terms
from spdz.session import GallerySession, conversation

pytestmark = pytest.mark.usefixtures("no_sync")

TERMS, SLOTS = Terms(Product(), 4), (3, 4)
PLENTY = 1 << 20
RAW = b"scan", b"", bytes(range(256)) * 3
SWAP = 2
"""The exchange in which a fresh session swaps; the greeting is 0, the account 1."""


def swapping(frames, most=PLENTY):
    return lambda session: session.swap(frames, most)


def kinds(end):
    return [frame[0] for frame in end.frames[SWAP:]]


# --- what is swapped


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_either_side_gets_what_the_other_gave(galleries, security):
    mission = galleries(Terms(Product(), 4, security), SLOTS)
    assert mission.meet(swapping(RAW), swapping([b"map"])) == [[b"map"], list(RAW)]


@pytest.mark.parametrize("sizes", [([], []), ([0, 0], []), ([], [5]), ([1], [0, 0, 1])], ids=str)
def test_nothing_and_empty_strings_are_swapped_too(galleries, sizes):
    mine, theirs = ([bytes(size) for size in side] for side in sizes)
    assert galleries(TERMS, SLOTS).meet(swapping(mine), swapping(theirs)) == [theirs, mine]


@pytest.mark.parametrize("sizes", [([99], [100]), ([101, 1], [1000]), ([50, 50, 0, 50], []), ([250], [3, 7])])
def test_long_strings_go_in_pieces_in_both_directions_at_once(galleries, monkeypatch, sizes):
    monkeypatch.setattr(conversation, "PIECE_BYTES", 100)
    rng, ends = np.random.default_rng(1), cables()
    mine, theirs = ([rng.bytes(size) for size in side] for side in sizes)
    found = galleries(TERMS, SLOTS).meet(swapping(mine), swapping(theirs), channels=ends)
    assert found == [theirs, mine]
    for sent, received in zip(ends[0].frames[SWAP + 1 :], ends[1].frames[SWAP + 1 :], strict=True):
        assert max(len(sent[1]), len(received[1])) in range(1, 101)
    pieces = -(-max(map(sum, sizes)) // 100)
    assert kinds(ends[0]) == ["CONTROL"] + ["DATA"] * pieces


def test_what_is_swapped_need_not_be_bytes_objects(galleries):
    array = np.arange(3, dtype="<i4")
    found = galleries(TERMS, SLOTS).meet(swapping([array, bytearray(b"ab")]), swapping([memoryview(b"c")]))
    assert found == [[b"c"], [array.tobytes(), b"ab"]]


def test_swaps_follow_each_other_and_steps(galleries):
    data = [unit_vectors(np.random.default_rng(2), count, 4) for count in SLOTS]

    def work(session):
        first = session.swap([b"before"], 6)
        (step,) = feed([data[session.party]])(session)
        return first, step.matches != [], session.swap([b"after"] * session.party, 5)

    assert galleries(TERMS, SLOTS).meet(work) == [([b"before"], True, [b"after"]), ([b"before"], True, [])]


def test_sessions_of_jobs_swap_as_well(tmp_path):
    paths = deal(tmp_path / "dealt", SCORES["S10"], ((4,), (4,)), 1)

    def work(session):
        before = session.swap([b"a"], 1)
        session.run(SCORES["S10"], np.ones(4) / 2)
        return before + session.swap([b"b"], 1)

    assert run_pair(paths, state_dirs(tmp_path), work) == [[b"a", b"b"]] * 2


# --- bounds


def test_most_is_what_may_come_in_all(galleries):
    mission = galleries(TERMS, SLOTS)
    assert mission.meet(swapping([], 7), swapping([b"1234", b"567"], 0)) == [[b"1234", b"567"], []]


def test_more_than_most_is_refused_before_it_is_received(galleries):
    ends = cables()
    outcomes = galleries(TERMS, SLOTS).meet(swapping([], 6), swapping([b"1234", b"567"]), channels=ends)
    assert isinstance(outcomes[0], ProtocolViolation) and "more than the 6 bytes" in str(outcomes[0])
    assert isinstance(outcomes[1], ChannelError)
    assert kinds(ends[0]) == ["CONTROL"]


@pytest.mark.parametrize(
    "arguments",
    [
        ([b""] * (conversation.MOST_STRINGS + 1), 1),
        (["text"], 1),
        ([5], 1),
        ([None], 1),
        (5, 1),
        ([np.ones((4, 4))[:, 0]], 1),
        ([b""], -1),
        ([b""], 1.0),
        ([b""], True),
    ],
)  # fmt: skip
def test_nonsense_is_refused_before_anything_is_sent(galleries, arguments):
    def work(session):
        with pytest.raises(ValueError):
            session.swap(*arguments)
        return session.swap([b"fine"], 4)

    assert galleries(TERMS, SLOTS).meet(work, swapping([b"fine"])) == [[b"fine"]] * 2


def test_as_many_strings_as_allowed_fit_the_control_message(galleries):
    most = conversation.MOST_STRINGS
    mine = [b"a"] * most
    found = galleries(TERMS, SLOTS).meet(swapping(mine), swapping([]))
    assert found == [[], mine]
    longest = json.dumps({"sha256": "0" * 64, "sizes": [10**10] * most})
    assert len(longest) < 64 << 10


# --- a peer that lies


LIES = {
    "more strings than there may be": {"sizes": [0] * (conversation.MOST_STRINGS + 1)},
    "no list": {"sizes": {"0": 4}},
    "text": {"sizes": ["4"]},
    "a fraction": {"sizes": [4.0]},
    "truth values": {"sizes": [True]},
    "less than nothing": {"sizes": [5, -1]},
    "nothing": {"sizes": None},
    "a lot": {"sizes": [1 << 62]},
    "too much for any integer": {"sizes": [10**30]},
    "another hash": {"sha256": hashlib.sha256(b"5can").hexdigest()},
    "no hash": {"sha256": None},
    "a list as its hash": {"sha256": [4]},
}


def against(mission, evil, lies, timeout=5.0):
    ends, kinds = cables(timeout), [GallerySession, GallerySession]
    kinds[evil] = lies
    return mission.meet(swapping([b"scan"]), channels=ends, kinds=kinds)[1 - evil], ends[1 - evil]


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("what", LIES)
def test_a_peer_that_lies_about_what_it_sends_is_refused(galleries, evil, what):
    lies = Lies(control=lambda number, message: message | LIES[what] if number == SWAP else message)
    outcome, end = against(galleries(TERMS, SLOTS), evil, lies)
    assert isinstance(outcome, ProtocolViolation), outcome
    if "sha256" in LIES[what]:
        assert "other bytes" in str(outcome) and kinds(end) == ["CONTROL", "DATA"]
    else:
        assert ("more than" if "much" in what or "lot" in what else "malformed") in str(outcome)
        assert kinds(end) == ["CONTROL"]


@pytest.mark.parametrize("evil", [0, 1])
def test_a_changed_byte_is_noticed(galleries, evil):
    for at in range(4):
        flip = 1 << 8 * at

        def frame(number, own, theirs, flip=flip):
            return (int.from_bytes(own, "little") ^ flip).to_bytes(4, "little")

        outcome, _ = against(galleries(TERMS, SLOTS), evil, Lies(frame))
        assert isinstance(outcome, ProtocolViolation) and "other bytes" in str(outcome)


@pytest.mark.parametrize("evil", [0, 1])
def test_fewer_or_more_bytes_than_announced_are_refused(galleries, evil):
    for change in (lambda own: own[:-1], lambda own: own + b"!"):
        lies = Lies(lambda number, own, theirs, change=change: change(own))
        outcome, _ = against(galleries(TERMS, SLOTS), evil, lies, timeout=0.5)
        assert isinstance(outcome, ProtocolViolation), outcome


def test_whoever_changes_strings_and_hash_on_the_line_fails_the_next_check(galleries):
    """The announcement is in the session id."""
    mission, ends = galleries(TERMS, SLOTS), cables()
    other = json.dumps(
        {"sha256": hashlib.sha256(b"5can").hexdigest(), "sizes": [4]}, separators=(",", ":")
    ).encode()
    ends[1].say = lambda number, kind, own, theirs: {SWAP: other, SWAP + 1: b"5can"}.get(number, own)
    data = unit_vectors(np.random.default_rng(2), 3, 4)

    def work(session):
        got = session.swap([b"scan"], 4)
        with pytest.raises((MacCheckFailed, PeerAborted)):
            feed([data])(session)
        return got

    assert mission.meet(work, channels=ends) == [[b"5can"], [b"scan"]]
    assert mission.destroyed(0)


@pytest.mark.parametrize("call", [lambda s: s.exchange_note({}), lambda s: s.step(), lambda s: s.part(1)])
def test_a_peer_that_does_something_else_is_out_of_step(galleries, call):
    outcomes = galleries(TERMS, SLOTS).meet(swapping(RAW), call)
    assert any(isinstance(outcome, OutOfStep | PeerAborted) for outcome in outcomes)
    assert not any(isinstance(outcome, list | dict) for outcome in outcomes)


def test_the_truth_is_no_lie(galleries):
    outcome, _ = against(galleries(TERMS, SLOTS), 0, Lies(tell_the_truth))
    assert no_errors([outcome]) == [[b"scan"]]
