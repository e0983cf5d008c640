"""What a peer gains whose agent does what it likes with a tape and a certificate of its own."""

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_helpers import bobs, deal, feed, found, places, plan, robots, until

from protocols.agent import Agent, Keyframe, Meeting, RecordsError, Verdict, link, showing, turns
from protocols.agent.allowance import Allowance
from protocols.agent.strikes import Strikes
from spdz.foundations.errors import ChannelError, ProtocolViolation
from spdz.foundations.types import FloatArray
from spdz.session import GallerySession
from spdz.session.agreement import Agreement
from spdz.session.comparing import Comparing


def taken(agent: Agent) -> int:
    """Keyframes that an agent was shown."""
    return int(agent._records.all("SELECT count(*) FROM opened")[0][0])


def feed_alone(folder: Path, vectors: FloatArray) -> None:
    """Give a robot keyframes while it reaches nobody, so that it brings all of them at once."""
    with Agent(folder, listen="127.0.0.1:0", peers={}) as agent:
        feed(agent, 0, vectors)


class Doubt:
    """A verification that takes as long as a test lets it."""

    def __init__(self) -> None:
        self.ended = threading.Event()

    def __call__(self, meeting: Meeting) -> Verdict:
        self.ended.wait(30)
        return Verdict(False, "another place")


@pytest.fixture
def doubt() -> Doubt:
    return Doubt()


def test_a_peer_is_shown_no_more_while_what_it_has_shown_is_being_verified(
    tmp_path: Path, doubt: Doubt
) -> None:
    mission, a = deal(tmp_path, plan()), places(12, 16, seed=1)
    feed_alone(mission / "bob", a)
    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=doubt, state_dir=tmp_path / "a")
    feed(alice, 0, a)
    with alice, bobs(mission, alice) as bob:
        until(lambda: len(found(alice)) == 12 and taken(bob))
        time.sleep(2.0)
        assert taken(bob) <= 3
        doubt.ended.set()


def test_one_slot_that_matches_all_is_paid_for_once_a_match(tmp_path: Path, doubt: Doubt) -> None:
    mission, a = deal(tmp_path, plan()), places(1, 16, seed=1)
    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=doubt, state_dir=tmp_path / "a")
    feed(alice, 0, np.repeat(a, 12, axis=0))
    with alice, bobs(mission, alice) as bob:
        feed(bob, 0, a)
        until(lambda: len(found(alice)) == 12 and taken(bob))
        time.sleep(2.0)
        assert taken(bob) <= 3
        doubt.ended.set()


def test_hanging_up_before_the_comparison_saves_no_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = deal(tmp_path, plan(pairs=20))
    new, shares, hang_up = Comparing.new, Allowance.shares, [5]

    def leave(self: Comparing, *rest: Any) -> None:
        if self.tape.header.name == "bob" and hang_up[0]:
            hang_up[0] -= 1
            raise ChannelError("on purpose")
        new(self, *rest)

    def all_of_them(self: Allowance, waiting: int, *rest: int) -> tuple[int, int]:
        granted = shares(self, waiting, *rest)
        return (waiting, 256) if self._peer.name == "alice" else granted

    monkeypatch.setattr(Comparing, "new", leave)
    monkeypatch.setattr(Allowance, "shares", all_of_them)
    alice, bob = robots(mission)
    with alice, bob:
        feed(alice, 0, places(4, 16, seed=1))
        until(lambda: alice.status()["galleries"][0]["keyframes"] == 4)
        feed(bob, 0, places(40, 16, seed=2))
        until(lambda: hang_up[0] < 5)
        time.sleep(2.0)  # it hangs up as often as it is let
        hang_up[0] = 0
        until(lambda: alice.status()["galleries"][0]["pairs"])
        time.sleep(1.0)
        assert alice.status()["galleries"][0]["pairs"] <= 20


def test_a_line_that_breaks_does_not_leave_both_robots_waiting_for_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = deal(tmp_path, plan(pairs=20))
    send, breaks = Agreement.control, [True]

    def lose(self: Agreement, message: dict[str, Any], *keys: str) -> dict[str, Any]:
        if "more" in keys and breaks[0] and message["slots"]:
            breaks[0] = False
            raise ChannelError("the line is lost")
        return send(self, message, *keys)

    monkeypatch.setattr(Agreement, "control", lose)
    for robot, seed in (("alice", 1), ("bob", 2)):
        feed_alone(mission / robot, places(12, 16, seed=seed))
    alice, bob = robots(mission)
    with alice, bob:
        until(lambda: alice.status()["galleries"][0]["pairs"])


def test_an_honest_peer_gets_no_strike_where_showing_takes_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission, show = deal(tmp_path, plan()), turns.show

    def slowly(*arguments: Any) -> Any:
        time.sleep(0.4)  # a payload on a slow link
        return show(*arguments)

    monkeypatch.setattr(turns, "show", slowly)
    for robot in ("alice", "bob"):
        feed_alone(mission / robot, places(12, 16, seed=1))
    alice, bob = robots(mission, grace=0.5)
    with alice, bob:
        until(lambda: len(found(alice, "verified")) == len(found(bob, "verified")) == 12)
        assert not found(alice, "withheld") and not found(bob, "withheld")


def test_an_honest_peer_gets_no_strike_for_the_time_without_a_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission, show, broken = deal(tmp_path, plan()), turns.show, threading.Event()

    def lose(*arguments: Any) -> Any:
        broken.set()
        raise ChannelError("the line is lost")

    monkeypatch.setattr(turns, "show", lose)
    for robot in ("alice", "bob"):
        feed_alone(mission / robot, places(4, 16, seed=1))
    alice, bob = robots(mission, grace=1.0)
    with alice:
        with bob:
            until(broken.is_set)
        monkeypatch.setattr(turns, "show", show)
        time.sleep(1.5)
        with bobs(mission, alice):
            until(lambda: len(found(alice, "verified")) == 4)
            assert not found(alice, "withheld")


HEADS = [
    b'{"id": 1, "stamp": 1' + b"0" * 400 + b"}",
    b'{"id": 1, "stamp": NaN}',
    b'{"id": 1' + b"0" * 20 + b', "stamp": 1}',
    b'{"id": true, "stamp": null}',
    b'{"id": 1, "stamp": null, "more": 1}',
    b"[" * 4000,
    b"[1]",
    b"\xff",
    b"",
]


@pytest.mark.parametrize("head", HEADS)
def test_a_keyframe_with_a_strange_head_is_a_violation(head: bytes) -> None:
    with pytest.raises(ProtocolViolation):
        showing._unpack(len(head).to_bytes(4, "little") + head)


def test_a_full_disk_while_something_is_held_against_a_peer_ends_no_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission, full = deal(tmp_path, plan()), threading.Event()

    def refuse(self: Strikes, why: str, match: int | None = None) -> None:
        full.set()
        raise RecordsError("the disk is full")

    def cheat(self: turns.Turns, session: Any) -> bool:
        raise ProtocolViolation("on purpose")

    monkeypatch.setattr(link, "_SLOW", 0.2)
    monkeypatch.setattr(Strikes, "add", refuse)
    alice, bob = robots(mission)
    with alice, bob, monkeypatch.context() as patch:
        patch.setattr(turns.Turns, "take", cheat)
        until(full.is_set)
        time.sleep(0.5)
        assert all(one._thread.is_alive() for one in alice._links + bob._links)


def test_a_peer_that_hangs_up_at_once_is_met_less_and_less_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission, met = deal(tmp_path, plan()), list[float]()
    take = turns.Turns.take

    def leave(self: turns.Turns, session: Any) -> bool:
        if self._desk.robot == "bob":
            met.append(time.monotonic())
            raise ChannelError("on purpose")
        return take(self, session)

    monkeypatch.setattr(turns.Turns, "take", leave)
    alice, bob = robots(mission)
    with alice, bob:
        until(lambda: len(met) == 5)
    assert met[4] - met[3] > 2 * (met[1] - met[0])


def test_a_peer_cannot_pay_with_a_copy_of_what_it_was_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes the other half, hangs up, and comes again with that half and a few points moved."""
    mission, a = deal(tmp_path, plan()), places(1, 16, seed=1)
    swap, pack, loot = GallerySession.swap, showing._pack, list[bytes]()

    def take(self: GallerySession, frames: Any, most: int) -> list[bytes]:
        theirs = swap(self, frames, most)
        if self._tape.header.name == "bob" and not loot:
            loot.append(showing._unpack(theirs[0]).payload)
            raise ChannelError("on purpose")
        return theirs

    def copy(keyframe: Keyframe) -> bytes:
        if keyframe.payload.startswith(b"bob") and loot:
            keyframe = Keyframe(keyframe.id, None, loot[0] + b" moved")
        return pack(keyframe)

    def lose(self: GallerySession, frames: Any, most: int) -> list[bytes]:
        if self._tape.header.name == "alice" and not loot:
            swap(self, frames, most)
            raise ChannelError("the peer hung up before its last piece")
        return take(self, frames, most)

    def verify(meeting: Meeting) -> Verdict:
        return Verdict(meeting.other.payload.startswith(meeting.own.payload), "another place")

    monkeypatch.setattr(GallerySession, "swap", lose)
    monkeypatch.setattr(showing, "_pack", copy)
    monkeypatch.setattr(link, "_SLOW", 0.2)
    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=verify, state_dir=tmp_path / "a")
    with alice, bobs(mission, alice) as bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: found(alice, "verified") or alice.status()["galleries"][0]["strikes"])
        assert not found(alice, "verified")
        assert "another keyframe" in alice._links[0]._peer.strikes.reasons[0]


def test_a_slot_that_matches_all_does_not_keep_the_verification_from_other_peers(
    tmp_path: Path, doubt: Doubt
) -> None:
    mission, a = deal(tmp_path, plan()), places(1, 16, seed=1)
    alice = Agent(mission / "alice", listen="127.0.0.1:0", verify=doubt, state_dir=tmp_path / "a")
    feed(alice, 0, np.repeat(a, 12, axis=0))
    with alice, bobs(mission, alice) as bob:
        feed(bob, 0, a)
        until(lambda: len(found(alice)) == 12 and taken(bob))
        time.sleep(0.5)
        assert alice._verifier._waiting.qsize() <= 2  # and one is looked at
        doubt.ended.set()
        until(lambda: alice.status()["galleries"][0]["state"] == "stopped")
        time.sleep(0.5)
        assert 3 <= len(found(alice, "rejected")) <= 5  # those that waited already


def test_a_peer_that_begins_turn_after_turn_does_not_keep_a_robot_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission, pause, take, count = deal(tmp_path, plan()), turns.Turns.pause, turns.Turns.take, [0]

    def hasty(self: turns.Turns, longest: float) -> float:
        return 0.0 if self._desk.robot == "bob" else pause(self, longest)

    def counted(self: turns.Turns, session: Any) -> bool:
        count[0] += self._desk.robot == "alice"
        return take(self, session)

    monkeypatch.setattr(turns.Turns, "pause", hasty)
    monkeypatch.setattr(turns.Turns, "take", counted)
    alice, bob = robots(mission)
    with alice, bob:
        until(lambda: count[0])
        time.sleep(2.0)
        assert count[0] < 60
