"""What is brought to a gallery: refused before anything is used, or in order and once."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from gallery_session_helpers import Product, cables, feed, no_errors, unit_vectors

from spdz.foundations.errors import ChannelClosed, SpdzError, TapeExhausted, TapeInUse
from spdz.readings.gallery import Terms

pytestmark = pytest.mark.usefixtures("no_sync")

DIM, SLOTS = 4, (3, 4)
X = unit_vectors(np.random.default_rng(2), 40, DIM)

BAD = {
    "NaN": np.array([[np.nan, 0, 0, 0]]),
    "infinite": np.array([[0, np.inf, 0, 0]]),
    "one vector": np.ones(DIM) / 2,
    "another length": np.ones((2, DIM + 1)) / 3,
    "three axes": np.zeros((1, 1, DIM)),
    "no length": np.zeros((2, 0)),
    "too long": np.array([[1.0, 0, 0, 0], [1.01, 0, 0, 0]]),
    "far too long": np.array([[1e300, 0, 0, 0]]),
    "too short": np.array([[0.5, 0, 0, 0.4], [0.4, 0, 0, 0.1]]),
    "zero": np.zeros((1, DIM)),
    "text": np.array([["a", "b", "c", "d"]]),
    "complex": np.full((1, DIM), 0.5j),
    "ragged": [[1.0, 0, 0, 0], [1.0]],
    "nothing": None,
}


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_bad_descriptors_are_refused_and_the_gallery_lives_on(galleries, security):
    def work(session):
        for name, bad in BAD.items():
            room = session.room
            with pytest.raises((ValueError, TypeError)):
                session.add(bad)
                pytest.fail(f"{name} was taken")
            assert session.room == room
        session.add(X[:2])
        return session.step()

    terms = Terms(Product(), DIM, security, min_norm=0.6)
    for step in no_errors(galleries(terms, SLOTS).meet(work)):
        assert step.own == [0, 1] and len(step.blocks) == 1


def test_secrets_are_not_in_what_is_said(galleries):
    def work(session):
        with pytest.raises(ValueError) as refused:
            session.add(np.array([[1.234567, 0, 0, 0]]))
        session.add(X[:1])
        step = session.step()
        return (
            f"{refused.value} {session!r} {step!r} {session._shelves!r} {session._ledger!r} {step.blocks!r}"
        )

    for said in no_errors(galleries(Terms(Product(), DIM), SLOTS).meet(work)):
        assert "1.234567" not in said
        for number in X[0]:
            assert str(number)[:8] not in said


def test_a_full_gallery_says_how_to_deal_more_and_takes_what_fits(galleries):
    def work(session):
        capacity = session.room
        session.add(X[:2])
        with pytest.raises(TapeExhausted, match=r"Nothing was used\. Deal more: .*dealer") as error:
            session.add(X[: capacity - 1])
        assert f"{capacity} slots" in str(error.value) and f"{capacity - 2} are free" in str(error.value)
        assert session.room == capacity - 2
        session.add(X[2:capacity])
        with pytest.raises(TapeExhausted):
            session.add(X[:1])
        session.add(X[:0])
        step = session.step()
        with pytest.raises(TapeExhausted):
            session.add(X[:1])
        assert session.room == 0
        session.step()
        return step, capacity

    for step, capacity in no_errors(galleries(Terms(Product(), DIM), SLOTS).meet(work)):
        assert step.own == list(range(capacity))


def test_a_gallery_that_is_full_because_of_a_void_slot_loses_nothing(galleries, monkeypatch):
    """The last descriptor finds no slot: told, with nothing sent; one fewer goes in."""
    from spdz.session import filling

    inside, burnt = filling.inside, []

    def first_is_void(words, bits, norm):
        good = inside(words, bits, norm)
        if len(words) == 3 and len(burnt) < 2:
            good[0] = False
            burnt.append(1)
        return good

    monkeypatch.setattr("spdz.session.filling.inside", first_is_void)
    mission = galleries(Terms(Product(), DIM), (3, 3))
    outcomes = mission.meet(feed([X[:3]]))
    assert any(isinstance(outcome, TapeExhausted) and "Deal more" in str(outcome) for outcome in outcomes)
    for steps in no_errors(mission.meet(feed([X[:2]]))):
        assert len(steps[0].own) == 2


def test_threads_take_turns(galleries):
    """A second thread may bring descriptors for the next step; a step of its own is refused."""

    def work(session):
        refused, ready, go = [], threading.Event(), threading.Event()

        def other():
            ready.wait(10)
            for call in (lambda: session.add(X[:1]), session.step):
                try:
                    call()
                except TapeInUse as error:
                    refused.append(str(error))
            go.set()

        thread = threading.Thread(target=other)
        thread.start()

        def show(block):
            ready.set()
            go.wait(10)

        session.add(X[:2])
        step = session.step(show)
        thread.join(10)
        return step, refused, session.step()

    for step, refused, later in no_errors(galleries(Terms(Product(), DIM), SLOTS).meet(work)):
        assert len(step.blocks) == 1 and len(refused) == 1 and "thread" in refused[0]
        assert later.own == [2] and later.peer == [2]


def test_a_fork_uses_nothing_of_its_parents(galleries):
    def work(session):
        session.add(X[:1])
        if session.party == 0:
            child = os.fork()
            if child == 0:  # pragma: no cover
                code = 1
                try:
                    for call in (lambda: session.add(X[:1]), session.step):
                        try:
                            call()
                        except TapeInUse:
                            code -= 0.5
                    session.close()
                finally:
                    os._exit(int(code))
            assert os.waitpid(child, 0)[1] == 0
        step = session.step()
        session.add(X[1:2])
        return step, session.step()

    for steps in no_errors(galleries(Terms(Product(), DIM), SLOTS).meet(work)):
        assert [step.own for step in steps] == [[0], [1]]


def test_a_closed_or_dead_session_takes_nothing(galleries):
    def work(session):
        session.close()
        session.close()
        for call in (lambda: session.add(X[:1]), session.step):
            with pytest.raises(ChannelClosed, match="has ended"):
                call()
        with pytest.raises(SpdzError):
            list(session.results())
        assert "dead" in repr(session)

    no_errors(galleries(Terms(Product(), DIM), SLOTS).meet(work))


def test_a_caller_that_raises_ends_the_session_and_keeps_the_results(galleries):
    def work(session):
        def show(block):
            raise KeyError("of the caller")

        session.add(X[:2])
        with pytest.raises(KeyError):
            session.step(show)
        with pytest.raises(ChannelClosed):
            session.add(X[:1])

    mission = galleries(Terms(Product(), DIM), SLOTS)
    no_errors(mission.meet(work))
    for blocks in no_errors(mission.meet(lambda session: list(session.results()))):
        assert blocks[0].results.shape == (2, 2)


def test_another_process_is_told_that_the_tape_is_in_use(galleries):
    mission = galleries(Terms(Product(), DIM), SLOTS)
    script = (
        "import sys; from pathlib import Path; from spdz.gallery.tape import GalleryTape\n"
        "try: GalleryTape.open(sys.argv[1], state_dir=Path(sys.argv[2]))\n"
        "except Exception as error: print(type(error).__name__)"
    )

    def work(session):
        if session.party:
            return ""
        call = [sys.executable, "-c", script, str(mission.tape_path(0)), str(mission.state(0))]
        return subprocess.run(call, capture_output=True, text=True, cwd=Path(__file__).parents[1]).stdout

    assert no_errors(mission.meet(work))[0] == "TapeInUse\n"


def test_sessions_that_never_began_leave_tape_and_ledger_free(galleries):
    mission, ends = galleries(Terms(Product(), DIM), SLOTS), cables(timeout=0.2)
    with pytest.raises(SpdzError):
        mission.open(0, ends[0])
    no_errors(mission.meet(feed([X[:1]])))
