"""A verification, and whoever listens, may do what it likes: the agent goes on."""

import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_helpers import deal, feed, found, news, places, plan, robots, until

from protocols.agent import Event, Keyframe, Meeting, Verdict
from protocols.agent.desk import Desk
from protocols.agent.events import Hub
from protocols.agent.keyframes import Keyframes
from protocols.agent.records import Records
from protocols.agent.verifier import Verifier


def test_a_peer_s_words_in_an_error_do_not_end_the_verification(tmp_path: Path) -> None:
    mission, a = deal(tmp_path, plan(strikes=9)), places(3, 16, seed=1)

    def verify(meeting: Meeting) -> Verdict:
        if meeting.own.id == 0:
            raise ValueError("no such sensor: \ud800\x1b[2J")
        return Verdict(meeting.own.id != 1, "\udfff")

    alice, bob = robots(mission, verify=verify)
    with alice, bob:
        feed(alice, 0, a)
        feed(bob, 0, a)
        until(lambda: found(alice, "rejected") == {(0, 0), (1, 1)} and found(alice, "verified") == {(2, 2)})
        assert all(match.why.isprintable() for match in news(alice))


def test_a_verdict_may_be_of_numpy_s_numbers() -> None:
    verdict = Verdict(np.True_, "", np.array([1, 2, 0.5], dtype=np.float32), np.float32(0.5))  # type: ignore[arg-type]
    assert verdict == Verdict(True, "", (1.0, 2.0, 0.5), 0.5)
    assert {type(number) for number in (*(verdict.transform or ()), verdict.weight)} == {float}


@pytest.mark.parametrize(
    "bad",
    [
        {"why": None},
        {"transform": ("north", 1.0)},
        {"transform": 3.0},
        {"transform": (np.nan,)},
        {"weight": np.inf},
        {"weight": 10**400},
        {"weight": "sure"},
        {"accepted": np.ones(2)},
    ],
)
def test_a_verdict_of_anything_else_is_refused_where_it_is_made(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="a verdict"):
        Verdict(**{"accepted": True, **bad})


def test_a_listener_that_raises_ends_nothing(tmp_path: Path) -> None:
    def listen(event: Event) -> None:
        raise RuntimeError("a user's bug")

    alice, bob = robots(deal(tmp_path, plan()), on_event=listen)
    with alice, bob:
        feed(alice, 0, places(2, 16, seed=1))
        feed(bob, 0, places(2, 16, seed=1))
        until(lambda: len(found(alice, "verified")) == 2)


def test_payloads_are_read_when_they_are_verified_and_not_before(tmp_path: Path) -> None:
    read, first, go_on = list[int](), threading.Event(), threading.Event()

    def verify(meeting: Meeting) -> Verdict:
        first.set()
        go_on.wait(30)
        return Verdict(True)

    def meet(match: int) -> Meeting:
        read.append(match)
        return Meeting("bob", "lidar", Keyframe(match), Keyframe(match, payload=bytes(8)))

    records = Records(tmp_path, "0" * 32)
    desk = Desk("alice", records, Keyframes(records), Hub(), verify, 3, 30.0, 30.0)
    verifier, settled = Verifier(desk), list[Verdict]()
    for match in range(50):
        verifier.judge(match, partial(meet, match), settled.append)
    assert first.wait(30) and read == [0]
    go_on.set()
    until(lambda: len(settled) == 50)
    verifier.close(5.0)
    records.close()
