"""Places between two robots: who lies on the way, brings another norm, or is cut off within a strip."""

import itertools
import random
from dataclasses import replace

import numpy as np
import pytest
from gallery_insider import Lies, at_bit, at_element, duel, instead, random_element
from gallery_session_helpers import cables, feed, no_errors, prepare_at_a_time, table
from place_helpers import CAMERA, LIDAR, decisions, places, terms, thresholds
from test_gallery_breaks import Watch, bring_the_rest

from protocols import Part, PlacePurpose
from spdz.foundations.errors import ChannelClosed, ProtocolViolation, SpdzError, TapeMismatch
from spdz.readings.party import Party
from spdz.session.admission import quantised

pytestmark = pytest.mark.usefixtures("no_sync")

TURNS = replace(LIDAR, turns=2)
ANY = PlacePurpose((TURNS, CAMERA))
SLOTS = (3, 4)
PROOF, PROOF_CHECK, PROOF_BITS, BITS_CHECK = range(5, 9)
CELL, CELL_CHECK, MASKED, MASKED_CHECK, COUNT, COUNT_CHECK, BIT, LAST = range(9, 17)
"""The exchanges of one step, after those of any gallery."""


def data(purpose, counts=SLOTS):
    return [places(purpose, count, seed) for seed, count in enumerate(counts)]


def run(galleries, evil, lies, purpose=ANY, **options):
    return duel(galleries(terms(purpose), SLOTS), data(purpose), evil, lies, **options)


# -- lies on the way ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("evil", [0, 1])
def test_without_a_lie_the_results_are_right(galleries, evil):
    found = run(galleries, evil, Lies())
    assert not found.caught, found.outcome
    kinds = [frame[0] for frame in found.frames]
    assert kinds == ["CONTROL"] * 3 + ["DATA", "CONTROL"] + ["DATA", "CHECK"] * 6
    sizes = {number: len(found.frames[number][1]) for number in (PROOF, CELL, MASKED, COUNT, BIT)}
    assert sizes == {PROOF: 16 * 3 * 7, CELL: 16 * 36, MASKED: 5, COUNT: 16 * 12, BIT: 2}
    (block,) = found.seen
    truth = decisions(ANY, *data(ANY), thresholds(ANY))
    assert np.array_equal(block.results, truth.T if evil == 0 else truth)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [PROOF, CELL, COUNT])
def test_a_lie_in_an_element_is_caught_before_anything_that_depends_on_it_is_sent(galleries, evil, exchange):
    size = {PROOF: 21, CELL: 36, COUNT: 12}[exchange]
    changes = [lambda o, t: o + 1, lambda o, t: o - 1, lambda o, t: o + random_element(), lambda o, t: -t]
    for index in range(0, size, 3):
        change = changes[index % len(changes)]
        found = run(galleries, evil, Lies(at_element(exchange, index, change), follow=index % 2 == 0))
        assert found.error == "MacCheckFailed", (index, found.outcome)
        assert (len(found.frames), found.seen, found.destroyed) == (exchange + 2, [], True)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [PROOF_BITS, MASKED, BIT])
def test_a_wrong_bit_is_caught_before_anything_that_depends_on_it_is_sent(galleries, evil, exchange):
    for bit in {PROOF_BITS: (0, 2, 9, 25, 27), MASKED: range(0, 36, 5), BIT: range(0, 12, 3)}[exchange]:
        found = run(galleries, evil, Lies(at_bit(exchange, bit), follow=bit % 2 == 0))
        assert found.error == "MacCheckFailed", (bit, found.outcome)
        assert (len(found.frames), found.seen, found.destroyed) == (exchange + 2, [], True)
    filling = {PROOF_BITS: 7, MASKED: 36, BIT: 12}[exchange]
    found = run(galleries, evil, Lies(at_bit(exchange, filling)))
    assert found.error == "ProtocolViolation" and found.seen == []


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", ["honest", "random", "zeros", "a bit"])
def test_a_forged_check_is_refused(galleries, evil, how):
    forged = {
        "honest": lambda own, theirs: theirs,
        "random": lambda own, theirs: bytes(range(16)),
        "zeros": lambda own, theirs: bytes(16),
        "a bit": lambda own, theirs: bytes([own[0] ^ 1]) + own[1:],
    }[how]
    for exchange in (CELL_CHECK, MASKED_CHECK, COUNT_CHECK, LAST):
        found = run(galleries, evil, Lies(instead(exchange, forged)))
        assert (found.error, len(found.frames), found.seen) == ("MacCheckFailed", exchange + 1, [])
        assert found.destroyed


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [CELL, MASKED, COUNT, BIT])
def test_who_lies_and_hangs_up_before_the_check_is_sent_the_same_bytes_again(galleries, evil, exchange):
    """Two runs of a strip, one of them with a lie, show no more than one."""

    def frame(number, own, theirs):
        if number == exchange + 1:
            raise ChannelClosed("hangs up, with the honest hash")
        return at_bit(exchange, 0)(number, own, theirs)

    found = run(galleries, evil, Lies(frame))
    assert found.caught and not found.destroyed and found.seen == []
    assert len(found.frames) == exchange + 1
    ends = cables()
    steps = no_errors(found.mission.meet(feed([data(ANY)[0][:0]]), channels=ends))
    (block,) = steps[0][0].blocks
    assert np.array_equal(block.results, decisions(ANY, *data(ANY), thresholds(ANY)))
    openings = [frame[1] for frame in found.frames if frame[0] == "DATA"][3:]
    again = [frame[1] for frame in ends[1 - evil].frames if frame[0] == "DATA"]
    at = again.index(openings[0])
    assert again[at : at + len(openings)] == openings and len(again) - at == 4


# -- the norm of every descriptor ---------------------------------------------------------------------------

LENGTHS = {
    "lidar (turn 0)": (0, 1.2),
    "lidar (turn 1)": (7, 1.2),
    "camera": (14, 1.2),
    "camera too short": (14, 0.2),
}


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("which", LENGTHS)
def test_a_descriptor_of_another_norm_is_refused_by_name(galleries, evil, which):
    """Also where the place as a whole is no longer than honest ones: the other descriptors are zero."""
    purpose = PlacePurpose((TURNS, replace(CAMERA, min_norm=0.0 if "lidar" in which else 0.5)))
    at, norm = LENGTHS[which]
    raw = np.zeros((1, purpose.dim), dtype=np.int64)
    raw[0, at] = round(norm * 65536)
    found = duel(galleries(terms(purpose), SLOTS), data(purpose), evil, Lies(vectors=list(raw)))
    assert found.error == "ProtocolViolation", found.outcome
    name, section = ("alice", "bob")[evil], which.removesuffix(" too short")
    assert f"the {section} in slot 0 of {name} has not a norm" in str(found.outcome)
    assert found.seen == [] and len(found.frames) == BITS_CHECK + 1  # the cell's were never sent
    for outcome in found.mission.meet(feed([raw[:0].astype(float)])):  # the slot is filled for ever
        assert isinstance(outcome, ProtocolViolation) and f"the {section} in slot" in str(outcome)


@pytest.mark.parametrize("evil", [0, 1])
def test_honest_descriptors_at_the_edge_pass_and_one_more_does_not(galleries, evil):
    purpose = PlacePurpose((TURNS, replace(CAMERA, max_norm=3.0)))
    program = terms(purpose)
    edge = np.zeros((1, purpose.dim), dtype=np.int64)
    for at, section in zip((0, 7, 14), program.sections, strict=True):
        edge[0, at] = section.norm
    mission = galleries(program, SLOTS)
    assert not duel(mission, data(purpose), evil, Lies(vectors=list(edge))).caught
    for at in (1, 8, 15):
        over = edge.copy()
        over[0, at] = 1
        found = duel(galleries(program, SLOTS), data(purpose), evil, Lies(vectors=list(over)))
        assert found.error == "ProtocolViolation", found.outcome


# -- breaks -------------------------------------------------------------------------------------------------

BROKEN = {
    "any": PlacePurpose((Part("lidar", "S10", 3, 2), Part("depth", "S6", 2))),
    "all": PlacePurpose((Part("lidar", "S10", 3, 2), Part("depth", "S6", 2, 2)), "all"),
    "cosines": PlacePurpose((Part("lidar", "S8", 3, 2), Part("key", "S7", 2))),
}
LIMITS = {"lidar": 0.2, "depth": 1.5, "key": 0.1}
COUNTS, LAST_COUNTS, ROOM = (5, 6), (6, 7), (40, 40)


class WatchBits(Watch):
    """Bits that leave a side for a strip are always the same as well."""

    def __init__(self, monkeypatch):
        super().__init__(monkeypatch)
        opening = Party.open_bits

        async def watched(party, shares, delta, n):
            if party.index in self.cell:
                rows, columns, number = self.cell[party.index]
                self.cell[party.index][2] += 1
                self.same(self.shares, (party.index, rows, columns, number), (shares[:, 0] & 1).tobytes())
            return await opening(party, shares, delta, n)

        monkeypatch.setattr(Party, "open_bits", watched)


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("name", BROKEN)
def test_the_connection_breaks_at_any_frame(galleries, monkeypatch, name, security):
    """Both are restarted and bring the rest: nothing is opened twice as two values, nothing is lost."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    prepare_at_a_time(monkeypatch, 2)
    purpose = BROKEN[name]
    program = purpose.terms({part.name: LIMITS[part.name] for part in purpose.parts}, security)
    burnt = name == "cosines" and security == "malicious"
    both, watch = data(purpose, LAST_COUNTS), WatchBits(monkeypatch)
    truth = decisions(purpose, *both, LIMITS)
    first = [feed([v[:2], v[2:count]]) for v, count in zip(both, COUNTS, strict=True)]
    ends = cables()
    no_errors(galleries(program, ROOM).meet(*first, channels=ends))
    total, generator, again = len(ends[0].frames), random.Random(name), 0
    for number in sorted(generator.sample(range(3, total), 8)):
        watch.forget()
        mission, ends = galleries(program, ROOM), cables()
        ends[generator.randrange(2)].cut = (number, generator.choice(["sent", "unsent", "torn"]))
        broken = mission.meet(*first, channels=ends)
        assert all(isinstance(outcome, SpdzError) for outcome in broken) or number == total - 1, broken
        before = watch.repeated
        (mine, rows), (theirs, columns) = no_errors(mission.meet(bring_the_rest(both, ([], []))))
        again += watch.repeated > before
        for side in (mine[np.ix_(rows, columns)], theirs[np.ix_(columns, rows)].T):
            known = side != -1
            assert (side == truth)[known].all() and (burnt or known.all())
    assert again or burnt


@pytest.mark.parametrize("name", BROKEN)
def test_slots_that_an_earlier_session_prepared_are_compared_with_new_ones(galleries, name):
    """What is derived of several descriptors is restored from what was opened then, lane by lane."""
    purpose = BROKEN[name]
    program = purpose.terms({part.name: LIMITS[part.name] for part in purpose.parts}, "malicious")
    both = data(purpose, LAST_COUNTS)
    mission = galleries(program, ROOM)
    no_errors(mission.meet(*[feed([v[:3]]) for v in both]))
    no_errors(mission.meet(*[feed([v[3:]]) for v in both]))
    mine, theirs = no_errors(mission.meet(lambda session: table(session, session.results())))
    truth = decisions(purpose, *both, LIMITS)
    assert np.array_equal(mine[: len(both[0]), : len(both[1])], truth)
    assert np.array_equal(theirs[: len(both[1]), : len(both[0])], truth.T)


# -- what a gallery of places answers -----------------------------------------------------------------------

CHANGED = {
    "rule": replace(ANY, rule="all"),
    "turns": PlacePurpose((LIDAR, CAMERA)),
    "norms": PlacePurpose((TURNS, replace(CAMERA, max_norm=2.0))),
    "order": PlacePurpose((CAMERA, TURNS)),
    "proof": replace(ANY, proof=False),
}


@pytest.mark.parametrize("what", CHANGED)
def test_a_tape_that_was_dealt_for_another_place_is_refused(galleries, what):
    mission = galleries(terms(ANY), SLOTS)
    mission.terms = terms(CHANGED[what])
    for outcome in mission.meet(feed([])):
        assert isinstance(outcome, TapeMismatch) and "dealt for another program" in str(outcome)


def test_the_first_thresholds_stay_for_ever_and_are_named(galleries):
    mission, both = galleries(terms(ANY), SLOTS), data(ANY)
    no_errors(mission.meet(*[feed([v[:2]]) for v in both]))
    mission.terms = ANY.terms({"lidar": 0.35, "camera": 0.2}, "malicious")
    for outcome in mission.meet(feed([])):
        assert isinstance(outcome, TapeMismatch)
        assert "answers any of lidar S10 >= 0.35 (2 turns), camera S10 >= 0.1, to 2^-16" in str(outcome)
        assert "such as any of lidar S10 >= 0.35 (2 turns), camera S10 >= 0.2, to 2^-16" in str(outcome)


def test_robots_with_different_thresholds_do_not_meet(galleries):
    mission = galleries(terms(ANY), SLOTS)
    other = ANY.terms({"lidar": 0.4, "camera": 0.1}, "malicious")
    opening, programs = mission.open, [mission.terms, other]
    mission.open = lambda party, channel, kind: opening(party, channel, kind, terms=programs[party])
    for outcome in mission.meet(feed([])):
        assert isinstance(outcome, TapeMismatch) and "lidar S10 >= 0.4 (2 turns)" in str(outcome)


def test_quantised_places_keep_every_descriptor_within_its_own_norm(galleries):
    program, x = terms(ANY), data(ANY)[0]
    raw = quantised(program, x)
    assert np.array_equal(raw, np.rint(x * 65536))
    for part, norm in itertools.product(("lidar (turn 0)", "lidar (turn 1)", "camera"), (1.1,)):
        at = {"lidar (turn 0)": 0, "lidar (turn 1)": 7, "camera": 14}[part]
        bad = x * 0.5
        bad[2, at] = norm
        with pytest.raises(ValueError, match=part.replace("(", r"\(").replace(")", r"\)")):
            quantised(program, bad)
