"""A gallery goes on after any break: no mask hides two vectors, nothing is opened twice as two values, and
what either side had found stays found."""

import itertools
import os
import random
import shutil

import numpy as np
import pytest
from gallery_session_helpers import (
    Cosine,
    Near,
    Product,
    Twice,
    burn_some,
    cables,
    feed,
    no_errors,
    prepare_at_a_time,
    table,
    unit_vectors,
)

from spdz.foundations.errors import SpdzError, TapeMismatch
from spdz.gallery.journal import Journal
from spdz.gallery.ledger import Ledger
from spdz.readings.gallery import Terms
from spdz.readings.party import Party
from spdz.session import filling
from spdz.session.agreement import Agreement
from spdz.session.comparing import Comparing
from spdz.session.filling import Filling

pytestmark = pytest.mark.usefixtures("no_sync")

EVERY = bool(os.environ.get("SPDZ_BREAKS"))
"""Whether every break is tried, or a sample."""

COUNTS, SLOTS, DIM = (5, 6), (40, 40), 4
LAST = (6, 7)
"""Descriptors of either side once all have arrived."""


class Watch:
    """Writes down what leaves a side for every slot and every pair, and that it is always the same."""

    def __init__(self, monkeypatch):
        self.words, self.shares, self.cell = {}, {}, {}
        self.repeated = 0
        exchange, run_cell, opening = Filling.exchange, Comparing._run_cell, Party.open

        def watched_exchange(filling, agreement, step):
            first = filling.sent
            result = exchange(filling, agreement, step)
            slots = filling.ledger.slots[filling.party]
            for slot, words in enumerate(slots.eps(first, filling.sent), first):
                self.same(self.words, (filling.party, slot), words)
            return result

        def watched_cell(comparing, rows, columns, connection, stats):
            self.cell[connection.party] = [rows, columns, 0]
            try:
                return run_cell(comparing, rows, columns, connection, stats)
            finally:
                del self.cell[connection.party]

        async def watched_open(party, *values):
            if party.index in self.cell:
                rows, columns, number = self.cell[party.index]
                self.cell[party.index][2] += 1
                for value in values:
                    share = np.ascontiguousarray(value.parts[0])
                    for at, pair in enumerate(itertools.product(rows, columns)):
                        entry = share.reshape(-1, 2)[at].tobytes()
                        self.same(self.shares, (party.index, pair, number), entry)
            return await opening(party, *values)

        monkeypatch.setattr(Filling, "exchange", watched_exchange)
        monkeypatch.setattr(Comparing, "_run_cell", watched_cell)
        monkeypatch.setattr(Party, "open", watched_open)

    def same(self, seen, key, data):
        if key in seen:
            self.repeated += 1
        assert seen.setdefault(key, data) == data, key

    def forget(self):
        self.words, self.shares, self.cell = {}, {}, {}


def data(seed=3):
    rng = np.random.default_rng(seed)
    return [unit_vectors(rng, count, DIM) for count in LAST]


def truth(terms, vectors):
    x, y = vectors
    if isinstance(terms.program, Near):
        return ((x[:, None] - y[None]) ** 2).sum(axis=2) <= terms.program.threshold
    return x @ y.T >= terms.program.threshold


def bring_the_rest(vectors, seen):
    """What a robot does when it is back: it looks which descriptors are in, and brings the others."""

    def work(session):
        party = session.party
        seen[party].extend(session.results())
        session.step()
        inside = {row.tobytes() for row in session.plain(session.filled)}
        rows = np.rint(vectors[party] * 65536).astype(np.int64)
        missing = [i for i, row in enumerate(rows) if row.tobytes() not in inside]
        session.add(vectors[party][missing])
        session.step()
        place = {
            row.tobytes(): slot
            for slot, row in zip(session.filled, session.plain(session.filled), strict=True)
        }
        return table(session, session.results()), [place[row.tobytes()] for row in rows]

    return work


def assert_complete(terms, vectors, found, *, burnt):
    """All that either side holds is true, and nothing is missing but what may be burnt on that side."""
    (first, rows), (second, columns) = found
    right, known = truth(terms, vectors), []
    for side in (first[np.ix_(rows, columns)], second[np.ix_(columns, rows)].T):
        known.append(side != -1)
        assert (side == right)[known[-1]].all()
        assert burnt or known[-1].all()
    return known


def first_part(vectors, shown):
    return [
        feed([v[:2], v[2:count]], shown[i]) for i, (v, count) in enumerate(zip(vectors, COUNTS, strict=True))
    ]


PROGRAMS = {"product": Product(), "near": Near(), "cosine": Cosine(), "twice": Twice()}


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_connection_breaks_at_any_frame(galleries, monkeypatch, name, security):
    """Every frame that one side does not get, or sends half of; then both are back, and bring the rest."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    prepare_at_a_time(monkeypatch, 2)
    terms = Terms(PROGRAMS[name], DIM, security)
    several_rounds = name in ("cosine", "twice") and security == "malicious"  # between two checks
    vectors, watch = data(), Watch(monkeypatch)
    ends, shown = cables(), ([], [])
    no_errors(galleries(terms, SLOTS).meet(*first_part(vectors, shown), channels=ends))
    total = len(ends[0].frames)
    generator, reruns, complete = random.Random(name), 0, 0
    numbers = range(total) if EVERY else sorted(generator.sample(range(total), 6))
    for number in numbers:
        side = generator.randrange(2)
        for how in ("sent", generator.choice(["unsent", "torn", b"\0" * 40])):
            watch.forget()
            mission, ends, shown = galleries(terms, SLOTS), cables(), ([], [])
            ends[side].cut = (number, how)
            broken = mission.meet(*first_part(vectors, shown), channels=ends)
            assert all(isinstance(outcome, SpdzError) for outcome in broken) or number == total - 1, broken
            repeated, before = watch.repeated, ([], [])
            found = no_errors(mission.meet(bring_the_rest(vectors, before)))
            reruns += watch.repeated > repeated
            known = assert_complete(terms, vectors, found, burnt=several_rounds)
            complete += all(side.all() for side in known)
            for i in (0, 1):  # what its caller saw before the break is there
                kept = {(b.own, b.peer): b.results for b in before[i]}
                for block in shown[i]:
                    assert np.array_equal(kept[block.own, block.peer], block.results)
                assert known[i].sum() >= sum(block.results.size for block in shown[i])
    assert complete and (reruns or several_rounds)


@pytest.mark.parametrize("name", ["product", "cosine"])
def test_it_breaks_again_and_again(galleries, monkeypatch, name):
    """Breaks of breaks: every meeting is cut at a random frame, until one is not."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    prepare_at_a_time(monkeypatch, 2)
    terms, vectors, watch = Terms(PROGRAMS[name], DIM), data(), Watch(monkeypatch)
    burn_some(monkeypatch, random.Random(1))
    for seed in range(12 if EVERY else 3):
        rng = random.Random(seed)
        watch.forget()
        mission = galleries(terms, (64, 64))
        for _ in range(12):
            ends = cables()
            ends[rng.randrange(2)].cut = (rng.randrange(30), rng.choice(["sent", "sent", "unsent", "torn"]))
            for outcome in mission.meet(bring_the_rest(vectors, ([], [])), channels=ends):
                assert isinstance(outcome, SpdzError | tuple), outcome
        found = no_errors(mission.meet(bring_the_rest(vectors, ([], []))))
        assert_complete(terms, vectors, found, burnt=name == "cosine")


def test_what_is_in_is_known_before_the_first_step(galleries):
    """Also of slots that were filled and not prepared when the connection broke."""
    terms, vectors = Terms(Product(), DIM), data()
    mission, ends = galleries(terms, SLOTS), cables()
    ends[0].cut = (5, "unsent")
    mission.meet(*[feed([v]) for v in vectors], channels=ends)

    def look(session):
        with pytest.raises(ValueError, match="in no slot"):
            session.plain([0, len(vectors[session.party])])
        return session.plain(session.filled)

    for found, right in zip(no_errors(mission.meet(look)), vectors, strict=True):
        assert np.array_equal(found, np.rint(right * 65536))


def test_breaks_never_add_up_to_more_than_the_two_may_differ_by(galleries, monkeypatch):
    """Every break comes after this side has filled all that it may, and before the peer has a word of it."""
    monkeypatch.setattr("spdz.session.filling.MOST", 4)
    monkeypatch.setattr("spdz.session.meeting.MOST", 4)
    terms, vectors = Terms(Product(), DIM), [np.concatenate([v, -v]) for v in data()]
    mission, rest = galleries(terms, SLOTS), [list(v) for v in vectors]

    def bring(session):
        held = len(session.filled)
        session.add(vectors[session.party][held:])
        return session.step()

    for number in (3, 3, 3, 2, 3):
        ends = cables()
        ends[0].cut = (number, "unsent")
        mission.meet(bring, channels=ends)
    no_errors(mission.meet(bring))
    found = no_errors(mission.meet(lambda session: (table(session, session.results()), session.filled)))
    (first, rows), (second, columns) = found
    assert (len(rows), len(columns)) == (len(rest[0]), len(rest[1]))
    assert (first[np.ix_(rows, columns)] == truth(terms, vectors)).all()
    assert (second[np.ix_(columns, rows)] == truth(terms, vectors).T).all()


class Stop(BaseException):
    """The process is gone."""


@pytest.mark.parametrize("name", ["product", "cosine", "twice"])
def test_a_process_that_stops_at_any_durable_step_goes_on(galleries, monkeypatch, name):
    """Before and after each thing that the ledger is told."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    prepare_at_a_time(monkeypatch, 2)
    terms, vectors, watch = Terms(PROGRAMS[name], DIM), data(), Watch(monkeypatch)
    step, count, stop = Journal.step, [0, 0], [None, None, None]

    def counted(journal, mark, changes):
        party = mark.party
        count[party] += 1
        if (party, count[party], "before") == tuple(stop):
            raise Stop
        step(journal, mark, changes)
        if (party, count[party], "after") == tuple(stop):
            raise Stop

    monkeypatch.setattr(Journal, "step", counted)
    shown = ([], [])
    no_errors(galleries(terms, SLOTS).meet(*first_part(vectors, shown)))
    total = min(count)
    numbers = range(1, total + 1) if EVERY else range(1, total + 1, 4)
    for number in numbers:
        for when in ("before", "after"):
            watch.forget()
            mission, shown = galleries(terms, SLOTS), ([], [])
            count[:], stop[:] = [0, 0], [number // 4 % 2, number, when]
            broken = mission.meet(*first_part(vectors, shown))
            assert any(isinstance(outcome, Stop) for outcome in broken)
            stop[0] = None
            found = no_errors(mission.meet(bring_the_rest(vectors, ([], []))))
            assert_complete(terms, vectors, found, burnt=name != "product")


def test_words_are_in_the_ledger_before_anything_is_told_of_them(galleries, monkeypatch):
    terms, vectors = Terms(Product(), DIM), data()
    mission = galleries(terms, SLOTS)
    told = []
    control = Agreement.control

    def watched(agreement, message, *keys):
        if "void" in message and "slots" in message:
            session = sessions[agreement._party]
            told.append(session._ledger.slots[session.party].filled)
        return control(agreement, message, *keys)

    sessions = {}

    def work(session):
        sessions[session.party] = session
        session.add(vectors[session.party][:3])
        session.step()

    monkeypatch.setattr(Agreement, "control", watched)
    no_errors(mission.meet(work))
    assert told == [3, 3]


@pytest.mark.parametrize("lost", ["tape folder", "ledger", "ledger alone"])
def test_copies_from_a_backup(galleries, lost):
    """What was used since is void; what is new is compared, and both go on."""
    terms, vectors = Terms(Product(), DIM), data()
    mission = galleries(terms, (64, 64))
    no_errors(mission.meet(*[feed([v[:2]]) for v in vectors]))
    backup = mission.copy(mission.folder.with_name(f"backup-{lost}"))
    no_errors(mission.meet(*[feed([v[2:4]]) for v in vectors]))
    name = "alice.ledger"
    if lost == "ledger alone":
        (mission.folder / name).unlink()
    else:
        shutil.copy(backup.folder / name, mission.folder / name)
        if lost == "tape folder":
            shutil.copy(backup.folder / "alice.tape", mission.folder / "alice.tape")
    found = no_errors(mission.meet(bring_the_rest(vectors, ([], []))))
    (first, rows), (second, columns) = found
    first, second = first[np.ix_(rows, columns)], second[np.ix_(columns, rows)].T
    right = truth(terms, vectors)
    for side in (first, second):
        assert (side[side != -1] == right[side != -1]).all()
    assert (first[4:, 4:] != -1).all() and (second[4:, 4:] != -1).all()


def test_slots_of_which_the_owner_has_lost_ledger_and_mark_are_void(galleries):
    """Restored to before they were filled, it would mask others with masks that the peer has words of."""
    terms, vectors = Terms(Product(), DIM), data()
    mission = galleries(terms, (64, 64))
    no_errors(mission.meet(*[feed([v[:1]]) for v in vectors]))
    backup = mission.copy(mission.folder.with_name("backup-lost"))
    ends = cables()
    ends[0].cut = (4, "unsent")  # the peer has the words, and no pair was begun
    mission.meet(*[feed([v[1:3]]) for v in vectors], channels=ends)
    shutil.copy(backup.folder / "alice.ledger", mission.folder / "alice.ledger")
    shutil.rmtree(mission.state(0))
    shutil.copytree(backup.state(0), mission.state(0))
    found = no_errors(mission.meet(bring_the_rest([vectors[0][::-1], vectors[1]], ([], []))))
    (_, rows), _ = found
    assert sorted(rows) == [0, 3, 4, 5, 6, 7]
    assert_complete(terms, [vectors[0][::-1], vectors[1]], found, burnt=False)


def test_a_side_that_stops_at_a_strip_of_void_slots_is_not_left_behind(galleries, monkeypatch):
    """Strips without a pair to compare take an exchange all the same."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 1)
    terms, vectors = Terms(Product(), DIM), data()
    mission = galleries(terms, SLOTS)
    no_errors(mission.meet(*[feed([v[:2]]) for v in vectors]))
    inside, begin, burnt, stopped = filling.inside, Ledger.begin, [], []

    def four_are_void(words, bits, norm):
        good = inside(words, bits, norm)
        if len(burnt) < 4:
            burnt.append(1)
            good[0] = False
        return good

    def stops(ledger, strip, notes):
        begin(ledger, strip, notes)
        if ledger._journal.mark.party == 1 and not stopped:
            stopped.append(strip)
            raise Stop

    monkeypatch.setattr("spdz.session.filling.inside", four_are_void)
    monkeypatch.setattr(Ledger, "begin", stops)
    broken = mission.meet(feed([vectors[0][2:4]]), feed([vectors[1][:0]]))
    assert isinstance(broken[1], Stop) and stopped[0].rows == range(2, 3)
    assert_complete(terms, vectors, no_errors(mission.meet(bring_the_rest(vectors, ([], [])))), burnt=False)


def test_ledger_and_state_restored_together_are_noticed_by_the_peer(galleries):
    terms, vectors = Terms(Product(), DIM), data()
    mission = galleries(terms, (64, 64))
    no_errors(mission.meet(*[feed([v[:1]]) for v in vectors]))
    backup = mission.copy(mission.folder.with_name("backup-all"))
    no_errors(mission.meet(*[feed([v[1:3], v[3:4]]) for v in vectors]))
    shutil.copy(backup.folder / "alice.ledger", mission.folder / "alice.ledger")
    shutil.rmtree(mission.state(0))
    shutil.copytree(backup.state(0), mission.state(0))
    for outcome in mission.meet(feed([vectors[0][:1]])):
        assert isinstance(outcome, TapeMismatch) and "old copy" in str(outcome)
