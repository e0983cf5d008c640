"""What a peer may learn in a minute."""

from pathlib import Path

import pytest
from agent_helpers import deal, plan
from hypothesis import given
from hypothesis import strategies as st

from protocols.agent.allowance import Allowance
from protocols.agent.budgets import WINDOW, Rate
from protocols.agent.desk import Peer
from protocols.agent.records import Records
from protocols.agent.strikes import Strikes


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def strikes(tmp_path: Path) -> Strikes:
    return Strikes(Records(deal(tmp_path, plan()) / "alice", "0" * 32), "bob")


def test_what_was_spent_comes_back_after_a_minute() -> None:
    clock = Clock()
    rate = Rate(10, clock)
    rate.spend(4)
    clock.now = 30.0
    rate.spend(6)
    assert (rate.left, rate.pause) == (0, 30.0)
    clock.now = WINDOW
    assert (rate.left, rate.pause) == (4, 30.0)
    clock.now = 95.0
    assert (rate.left, rate.untouched, rate.pause) == (10, True, 0.0)


def test_more_than_there_is_can_be_spent_and_is_owed_for_a_minute() -> None:
    clock = Clock()
    rate = Rate(10, clock)
    rate.spend(25)
    assert rate.left == 0
    clock.now = WINDOW
    assert rate.left == 10


@given(
    st.integers(0, 400),
    st.integers(0, 300),
    st.integers(0, 300),
    st.integers(1, 10_000),
    st.integers(1, 9_999),
)
def test_shares_never_make_more_pairs_than_are_left(
    waiting: int, own: int, theirs: int, most: int, spent: int
) -> None:
    pairs = Rate(most, Clock())
    pairs.spend(spent)
    brings, takes = Allowance(Peer("bob", _None(), pairs, Rate(5, Clock())), 3, print).shares(
        waiting, own, theirs
    )
    assert 0 <= brings <= waiting and takes >= 0
    assert brings * theirs + takes * own + brings * takes <= pairs.left


def test_a_budget_below_one_descriptor_s_pairs_does_not_stop_all() -> None:
    peer = Peer("bob", _None(), Rate(1, Clock()), Rate(5, Clock()))
    assert Allowance(peer, 3, print).shares(7, 100, 100) == (1, 1)


def test_nothing_is_compared_while_the_limit_may_be_reached(strikes: Strikes) -> None:
    told: list[str] = []
    peer = Peer("bob", strikes, Rate(1000, Clock()), Rate(1, Clock()))
    allowance = Allowance(peer, 2, told.append)
    assert allowance.shares(3, 0, 0) == (3, 333)
    strikes.add("one")
    assert not allowance.struck and allowance.pairs
    strikes.add("two")
    assert allowance.struck and allowance.shares(3, 0, 0) == (0, 0)
    assert strikes.forgive() == 2 and allowance.pairs
    peer.matches.spend(1)
    assert allowance.shares(3, 0, 0) == (0, 0) and allowance.spent
    assert told == ["the budget of matches a minute with bob is spent: on in 60 s or later"]


class _None(Strikes):
    reasons = ()  # type: ignore[assignment]
    outstanding = 0  # type: ignore[assignment]

    def __init__(self) -> None: ...


@given(st.integers(1, 300), st.integers(0, 6000), st.integers(0, 6000))
def test_a_step_takes_a_second_s_share_of_the_budget_and_never_nothing(
    waiting: int, own: int, theirs: int
) -> None:
    peer = Peer("bob", _None(), Rate(1_000_000, Clock()), Rate(60, Clock()))
    peer.pairs.spend(1)
    brings, takes = Allowance(peer, 3, print).shares(waiting, own, theirs)
    pairs = brings * theirs + takes * own + brings * takes
    assert brings and pairs <= max(1_000_000 // 60, own + theirs + 1)
    assert takes or brings * (theirs + 1) + own > 1_000_000 // 60
