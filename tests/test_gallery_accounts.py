"""What one side of a gallery says when both meet again, and what follows: rules and their bounds."""

import json
from types import SimpleNamespace

import pytest

from spdz import ProtocolViolation, TapeMismatch
from spdz.channels.frames import MAX_CONTROL
from spdz.gallery.strip import Strip
from spdz.session.meeting import MOST, Standpoint, meet
from spdz.session.strips import STRIP_PAIRS

BIG = (60_000, 60_000)


def plan(pair=1, slots=1):
    """Unchecked openings in a row, of a pair and of a slot."""
    record = SimpleNamespace(repeatable=slots == 1)
    return SimpleNamespace(slots=(record, record), pair=SimpleNamespace(repeatable=pair == 1))


def side(filled, ready=None, void=((), ()), done=(0, 0), flight=None):
    ready = filled if ready is None else ready
    return Standpoint(filled, ready, (list(void[0]), list(void[1])), done, flight)


def strip(a, b, c, d):
    return Strip(range(a, b), range(c, d))


def both_ways(one, other, program):
    """What either side finds, whichever party it is."""
    for party in (0, 1):
        yield meet(one, other, party, program), meet(other, one, 1 - party, program)


# -- strips -----------------------------------------------------------------------------------------------


def test_one_side_may_be_a_strip_behind_while_the_other_has_begun_the_next():
    missed, begun = strip(2, 4, 0, 3), strip(0, 4, 3, 5)
    ahead = side((4, 5), done=(4, 3), flight=begun)
    behind = side((4, 5), done=(2, 3), flight=missed)
    for agreed in both_ways(ahead, behind, plan()):
        assert [(one.again, one.burn) for one in agreed] == [([missed, begun], [])] * 2
    for agreed in both_ways(ahead, behind, plan(pair=2)):
        assert [(one.again, one.burn) for one in agreed] == [([], [missed, begun])] * 2
    given_up = side((4, 5), done=(2, 3))  # the side behind will not run it again
    for agreed in both_ways(ahead, given_up, plan()):
        assert [(one.again, one.burn) for one in agreed] == [([begun], [missed])] * 2


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (side((4, 5), done=(4, 5)), side((4, 5), done=(2, 3), flight=strip(2, 4, 0, 3))),  # two strips apart
        (side((4, 5), done=(4, 3)), side((4, 5), done=(2, 3), flight=strip(0, 2, 3, 5))),  # another strip
        (side((4, 5), done=(4, 3)), side((4, 5), done=(2, 5))),
        (
            side((4, 5), done=(2, 3), flight=strip(2, 4, 0, 3)),
            side((4, 5), done=(2, 3), flight=strip(2, 3, 0, 3)),
        ),
    ],
)
def test_sides_further_apart_are_refused(one, other):
    for party in (0, 1):
        with pytest.raises(TapeMismatch):
            meet(one, other, party, plan())


@pytest.mark.parametrize("repeatable", [True, False])
@pytest.mark.parametrize("peer", [{"flight": strip(0, 8, 0, 8)}, {"done": (8, 8)}], ids=["flight", "done"])
def test_a_strip_of_slots_that_one_side_does_not_know_is_refused(peer, repeatable):
    """A liar would have slots that are filled later compared, or burnt, against the rule."""
    for own in (side((0, 0)), side((8, 0)), side((7, 8)), side((8, 7))):
        for party in (0, 1):
            with pytest.raises(TapeMismatch, match=r"begun|compared"):
                meet(own, side((8, 8), **peer), party, plan(1 if repeatable else 2))
    assert meet(side((8, 8)), side((8, 8), **peer), 0, plan())


@pytest.mark.parametrize("repeatable", [True, False])
def test_a_strip_larger_than_any_step_makes_is_refused(repeatable):
    """It would need memory for all of it at once, or burn more than a strip."""
    program, rows = plan(1 if repeatable else 2), STRIP_PAIRS // 256
    for shape, fits in (
        ((rows, 256), True),
        ((rows + 1, 256), False),
        ((1, 60_000), True),
        ((60_000, 1), True),
    ):
        flight = side(BIG, flight=strip(0, shape[0], 0, shape[1]))
        if fits:
            found = meet(side(BIG), flight, 0, program)
            assert found.again + found.burn == [flight.flight]
        else:
            with pytest.raises(TapeMismatch, match="more than any step"):
                meet(side(BIG), flight, 0, program)


# -- slots ------------------------------------------------------------------------------------------------


def test_void_slots_are_told_as_runs_however_many_there_are():
    """A gallery that lost its ledger has tens of thousands of them, and goes on."""
    told = side(BIG, void=(range(50_000), [*range(0, 9_000), *range(20_000, 60_000)]))
    message = json.loads(json.dumps(told.as_json()))
    assert message["void"] == [[[0, 50_000]], [[0, 9_000], [20_000, 60_000]]]
    assert len(json.dumps(message)) < MAX_CONTROL // 100
    assert Standpoint.read(message, BIG) == told
    assert meet(told, told, 0, plan()).void == told.void


@pytest.mark.parametrize(
    "void",
    [
        [[3, 4], []],  # numbers, as runs are not
        [[[3, 5], [4, 6]], []],
        [[[4, 6], [0, 2]], []],
        [[[0, 2], [2, 4]], []],
        [[[4, 4]], []],
        [[[5, 4]], []],
        [[[0, 9]], []],
        [[[0, 1 << 60]], []],
        [[[-1, 1]], []],
        [[[0, 1.0]], []],
        [[[0, True]], []],
        [[[0]], []],
        [[[0, 1, 2]], []],
        [[]],
        [[], [], []],
        [None, []],
        {"0": [], "1": []},
        {0: [], 1: []},
    ],
    ids=str,
)
def test_what_is_no_set_of_runs_is_refused(void):
    message = side((8, 8)).as_json() | {"void": void}
    with pytest.raises(ProtocolViolation, match="malformed"):
        Standpoint.read(message, BIG)


@pytest.mark.parametrize("owner", [0, 1])
@pytest.mark.parametrize("slots", [1, 2])
def test_what_a_peer_can_make_void_in_a_meeting_is_bounded(owner, slots):
    def pair(number):
        return (number, 0) if owner == 0 else (0, number)

    own = side(pair(50_000))
    for say in (
        lambda number: side(pair(50_000), pair(50_000 - number)),  # not prepared, it says
        lambda number: side(pair(50_000), void=(range(number), ()) if owner == 0 else ((), range(number))),
        lambda number: side(pair(50_000 - number)),  # forgotten
        lambda number: side(pair(50_000 + number)),  # never sent here
    ):
        for party in (0, 1):
            agreed = meet(own, say(MOST), party, plan(slots=slots))
            assert len(agreed.void[owner]) + agreed.lost <= MOST
            with pytest.raises(TapeMismatch, match="old copy"):
                meet(own, say(MOST + 1), party, plan(slots=slots))
    mine = side(pair(50_000), void=(range(9_000), ()) if owner == 0 else ((), range(9_000)))
    assert len(meet(mine, mine, 0, plan()).void[owner]) == 9_000  # what both know is none of the peer's
