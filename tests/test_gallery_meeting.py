"""Two sides of a gallery meet again: what follows from honest accounts, and what a lie in one can do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gallery_insider import Lies, duel, vectors
from gallery_session_helpers import Cosine, Product, feed, no_errors, table

from spdz.foundations.errors import ProtocolViolation, SpdzError, TapeMismatch
from spdz.gallery.strip import Strip
from spdz.readings.gallery import Terms
from spdz.session.meeting import MOST, Standpoint, meet

ONCE = SimpleNamespace(slots=(SimpleNamespace(repeatable=True),) * 2, pair=SimpleNamespace(repeatable=True))
SEVERAL = SimpleNamespace(
    slots=(SimpleNamespace(repeatable=False),) * 2, pair=SimpleNamespace(repeatable=False)
)
FIRST, SECOND = Strip(range(0, 5), range(0, 6)), Strip(range(5, 9), range(0, 6))
PLAIN = Standpoint((9, 8), (9, 8), ([], []), (0, 0), None)
CAPACITY = (1 << 16, 1 << 16)


def both(one, other, plan=ONCE):
    """What follows for party 0, whose account is ``one``, and for party 1."""
    return meet(one, other, 0, plan), meet(other, one, 1, plan)


CASES = {
    "nothing broken off": (PLAIN, PLAIN, []),
    "one has begun": (replace(PLAIN, flight=FIRST), PLAIN, [FIRST]),
    "both have begun": (replace(PLAIN, flight=FIRST), replace(PLAIN, flight=FIRST), [FIRST]),
    "one has finished": (replace(PLAIN, done=(5, 6)), replace(PLAIN, flight=FIRST), [FIRST]),
    "one has begun the next": (
        replace(PLAIN, done=(5, 6), flight=SECOND), replace(PLAIN, flight=FIRST), [FIRST, SECOND],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("swapped", [False, True])
def test_strips_are_run_again_or_burnt_on_both_sides(name, swapped):
    one, other, strips = CASES[name]
    if swapped:
        one, other = other, one
    for agreed in both(one, other):
        assert (agreed.again, agreed.burn) == (strips, [])
    for agreed in both(one, other, SEVERAL):
        assert (agreed.again, agreed.burn) == ([], strips)


def test_a_strip_that_one_side_has_given_up_is_not_run_again():
    """It was behind its mark, and burnt the strip; so it is ahead, with nothing in flight."""
    ahead, behind = replace(PLAIN, done=(5, 6)), PLAIN
    for agreed in both(ahead, behind):
        assert (agreed.again, agreed.burn) == ([], [FIRST])
    for agreed in both(replace(ahead, flight=SECOND), behind):
        assert (agreed.again, agreed.burn) == ([SECOND], [FIRST])


@pytest.mark.parametrize(
    "one,other",
    [
        (replace(PLAIN, flight=FIRST), replace(PLAIN, flight=Strip(range(0, 5), range(0, 5)))),
        (replace(PLAIN, done=(5, 6)), replace(PLAIN, done=(6, 5))),
        (replace(PLAIN, done=(5, 6)), replace(PLAIN, done=(7, 8))),
        (replace(PLAIN, done=(5, 6)), replace(PLAIN, flight=Strip(range(0, 4), range(0, 6)))),
        (replace(PLAIN, flight=FIRST), replace(PLAIN, filled=(4, 8), ready=(4, 8))),
        (replace(PLAIN, done=(5, 6)), replace(PLAIN, filled=(4, 8), ready=(4, 8))),
        (PLAIN, replace(PLAIN, filled=(9 + MOST + 1, 8))),
        (PLAIN, replace(PLAIN, filled=(9, 8 + MOST + 1))),
    ],
)
def test_accounts_of_different_histories_are_refused(one, other):
    for own, peer, party in ((one, other, 0), (other, one, 1)):
        with pytest.raises(TapeMismatch, match="eal new tapes"):
            meet(own, peer, party, ONCE)


def test_slots_that_either_has_lost_are_void_on_both_sides():
    one = Standpoint((9, 8), (7, 8), ([1], [2]), (0, 0), None)
    other = Standpoint((11, 6), (11, 6), ([3], []), (0, 0), None)
    first, second = both(one, other)
    # Party 0 has forgotten its slots 9 and 10; party 1 its slots 6 and 7.
    assert (first.lost, first.send) == (2, 11)
    assert (second.lost, second.send) == (2, 8)
    assert first.void == ([1, 3], [2, 6, 7])
    assert second.void == ([1, 3, 9, 10], [2])
    assert first.ready == second.ready == (7, 6)
    first, second = both(one, other, SEVERAL)  # prepared on one side alone: another note may be there
    assert first.void[0] == [1, 3, 7, 8] and second.void[0] == [1, 3, 7, 8, 9, 10]


def test_slots_that_no_side_has_begun_with_are_not_lost():
    """Preparing goes by 128 slots; what comes after those that may be half prepared waits as it is."""
    one = Standpoint((1000, 0), (300, 0), ([301, 1], []), (0, 0), None)
    for other in (one, replace(one, ready=(428, 0))):
        for agreed in both(one, other, SEVERAL):
            end = 300 + 128 + 1 if other is one else 428 + 128
            assert agreed.void[0] == [1, *range(300, end)]


def test_many_void_slots_can_be_told():
    slots = list(range(20000)) + list(range(20001, 40000, 2))
    standpoint = Standpoint((50000, 50000), (0, 0), (slots[:20000], slots[:24000]), (0, 0), None)
    assert Standpoint.read(standpoint.as_json(), CAPACITY) == standpoint
    with pytest.raises(ProtocolViolation):
        Standpoint.read(replace(standpoint, void=(slots, [])).as_json(), CAPACITY)


@pytest.mark.parametrize("case", CASES)
def test_accounts_travel(case):
    for standpoint in CASES[case][:2]:
        assert Standpoint.read(standpoint.as_json(), CAPACITY) == standpoint


BAD = [
    {"filled": [1 << 17, 0]},
    {"filled": [-1, 0]},
    {"filled": [1]},
    {"filled": [1, 2, 3]},
    {"filled": None},
    {"filled": [True, 1]},
    {"ready": [0, 1.0]},
    {"done": [10, 8]},
    {"done": [9, 9]},
    {"done": [3, 0]},
    {"done": [0, 3]},
    {"flight": [0, 0, 0, 1]},
    {"flight": [0, 10, 0, 8]},
    {"flight": [1, 2, 0, 8]},
    {"flight": [0, 1]},
    {"flight": 3},
    {"flight": [0, 1, 0, 1 << 40]},
    {"void": [[[3, 2]], []]},
    {"void": [[[2, 2]], []]},
    {"void": [[[9, 10]], []]},
    {"void": [[], [[-1, 1]]]},
    {"void": []},
    {"void": [[[1, 2], [2, 3]], []]},
    {"void": {}},
]


@pytest.mark.parametrize("change", BAD, ids=str)
def test_malformed_accounts_are_refused(change):
    with pytest.raises(ProtocolViolation, match="malformed"):
        Standpoint.read(PLAIN.as_json() | change, CAPACITY)


LIES = [
    {"filled": [0, 0], "ready": [0, 0], "done": [0, 0]},
    {"filled": [2, 2]},
    {"filled": [3, 3]},
    {"filled": [1, 2]},
    {"ready": [0, 0]},
    {"ready": [2, 1]},
    {"done": [0, 0]},
    {"done": [1, 2]},
    {"done": [0, 0], "flight": [0, 2, 0, 2]},
    {"done": [1, 2], "flight": [1, 2, 0, 2]},
    {"flight": [2, 3, 0, 2]},
    {"filled": [3, 3], "flight": [2, 3, 0, 2]},
    {"filled": [3, 3], "done": [3, 2]},
    {"filled": [3, 3], "done": [3, 3]},
    {"void": [[[0, 1]], []]},
    {"void": [[], [[0, 2]]]},
    {"void": [[[0, 2]], [[0, 2]]]},
    {"text": "0"},
    {"done": [2, 1], "flight": [0, 2, 1, 2]},
]


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("program", [Product(), Cosine()], ids=["once", "several"])
@pytest.mark.parametrize("lie", LIES, ids=str)
def test_a_lie_at_the_meeting_costs_slots_and_no_result(galleries, no_sync, evil, program, lie):
    """What was found stays, what is shown is true, and every end is a named one."""
    data, terms = vectors((3, 3)), Terms(program, 4)
    mission = galleries(terms, (8, 8))
    no_errors(mission.meet(*[feed([v[:2]]) for v in data]))
    lies = Lies(control=lambda number, message: message | lie if number == 1 else message)
    found = duel(mission, [v[2:] for v in data], evil, lies, timeout=1.0)
    assert isinstance(found.outcome, list | SpdzError), found.outcome
    assert found.error != "TapeDamaged"
    truth = data[1 - evil] @ data[evil].T >= program.threshold
    for block in found.seen:
        for j, row in enumerate(block.own):
            for k, column in enumerate(block.peer):
                if row < 2 and column < 2:
                    assert block.results[j, k] == truth[row, column]

    def look(session):
        return table(session, session.results())

    for party, held in enumerate(mission.meet(look)):
        if not isinstance(held, Exception):
            assert np.array_equal(held[:2, :2] == 1, truth[:2, :2] if party != evil else truth[:2, :2].T)
