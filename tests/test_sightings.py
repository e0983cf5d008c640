"""Which address of a peer is tried next, whatever is said on the network."""

import pytest

from protocols.agent.sightings import MOST, MOST_OF_ONE, Sightings


def tries(sightings, peer="bob", count=2 * MOST):
    """The addresses in the order in which they are tried if none works."""
    tried = []
    for _ in range(count):
        tried.append(sightings.first(peer))
        if tried[-1] is None or tried[-1] in tried[:-1]:
            return tried[:-1]
        sightings.failed(peer, tried[-1])
    raise AssertionError("never the same again")


@pytest.fixture
def sightings():
    return Sightings(["bob", "carol"])


def test_a_peer_that_nobody_mentioned_is_nowhere(sightings):
    sightings.seen("bob", "bob's", ["a:1"])
    assert sightings.first("carol") is None
    with pytest.raises(KeyError):
        sightings.first("dave")


def test_what_was_said_is_tried_in_order_and_then_again(sightings):
    sightings.seen("bob", "bob's", ["a:1", "b:1", "c:1"])
    assert tries(sightings) == ["a:1", "b:1", "c:1"]
    assert sightings.first("bob") == "a:1"


def test_an_address_that_works_stays_first_whatever_else_is_said(sightings):
    sightings.seen("bob", "bob's", ["a:1"])
    for k in range(3 * MOST):
        sightings.seen("bob", f"stranger {k}", [f"evil:{k}"])
    assert sightings.first("bob") == "a:1"


def test_an_address_that_failed_is_behind_one_that_was_said_later(sightings):
    sightings.seen("bob", "stranger", ["evil:1"])
    sightings.failed("bob", "evil:1")
    sightings.seen("bob", "bob's", ["a:1"])
    assert tries(sightings) == ["a:1", "evil:1"]


def test_a_stranger_who_says_much_leaves_room(sightings):
    sightings.seen("bob", "stranger", [f"evil:{k}" for k in range(100)])
    sightings.seen("bob", "bob's", ["a:1"])
    assert "a:1" in tries(sightings)[: MOST_OF_ONE + 1]


def test_no_more_than_a_few_addresses_are_kept(sightings):
    for k in range(100):
        sightings.seen("bob", f"stranger {k}", [f"evil:{k}.{n}" for n in range(100)])
        sightings.failed("bob", sightings.first("bob"))
    assert len(tries(sightings)) == MOST


def test_addresses_that_failed_make_room_for_new_ones(sightings):
    for k in range(MOST):
        sightings.seen("bob", f"stranger {k}", [f"evil:{k}"])
        sightings.failed("bob", f"evil:{k}")
    sightings.seen("bob", "bob's", ["a:1"])
    assert sightings.first("bob") == "a:1"


def test_an_address_that_changed_is_tried_first_and_the_old_one_last(sightings):
    sightings.seen("bob", "bob's", ["old:1", "other:1"])
    sightings.seen("bob", "bob's", ["new:1", "other:1"])
    assert tries(sightings) == ["new:1", "other:1", "old:1"]


def test_what_is_said_again_is_worth_another_try(sightings):
    sightings.seen("bob", "bob's", ["a:1"])
    sightings.failed("bob", "a:1")
    sightings.seen("bob", "another", ["b:1"])
    sightings.failed("bob", "b:1")
    sightings.seen("bob", "another", ["b:1"])
    assert sightings.first("bob") == "b:1"


def test_what_is_taken_back_is_kept_behind_the_rest(sightings):
    sightings.seen("bob", "bob's", ["a:1"])
    sightings.seen("bob", "another", ["b:1"])
    sightings.gone("bob's")
    assert tries(sightings) == ["b:1", "a:1"]


def test_a_failure_of_an_address_that_nobody_knows_changes_nothing(sightings):
    sightings.seen("bob", "bob's", ["a:1"])
    sightings.failed("bob", "z:1")
    assert tries(sightings) == ["a:1"]


def test_peers_do_not_share_their_addresses(sightings):
    sightings.seen("bob", "one", ["a:1"])
    sightings.seen("carol", "one", ["a:1"])
    sightings.failed("bob", "a:1")
    sightings.seen("bob", "two", ["b:1"])
    assert (sightings.first("bob"), sightings.first("carol")) == ("b:1", "a:1")
