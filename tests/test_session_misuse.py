"""A session misused by its own side: forks, threads, programs that change, questions after the end."""

import gc
import json
import os
import weakref
from dataclasses import dataclass, field
from threading import Event, Thread, get_ident

import numpy as np
import pytest
from session_helpers import deal, run_pair, state_dirs

from protocols import Score, is_candidate
from protocols.scores import S10
from spdz import (
    ChannelClosed,
    ChannelError,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    TapeInUse,
    TapeMismatch,
    dot,
)
from spdz.channels import FrameKind, memory_pair
from spdz.readings.plans import KEPT, Plans, constants, unchanging
from spdz.readings.streams import JobStream
from spdz.tape import Tape

SHAPES = ((4,), (4,))
OWN = (np.array([0.5, -0.5, 0.5, 0.5]), np.array([0.5, 0.5, -0.5, 0.5]))


def in_a_fork(work):
    """Run ``work`` in a fork, which ends at once; the name of what it raised, or ``""``."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException as error:
            os.write(writer, type(error).__name__.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said


@pytest.mark.parametrize("error", [MemoryError, KeyboardInterrupt])
def test_a_session_whose_reserving_broke_off_is_dead(tmp_path, monkeypatch, error):
    """Else the two robots would run different jobs: wrong numbers where nothing is checked."""
    paths = deal(tmp_path / "m", S10, SHAPES, 9, "semi-honest")

    def work(session):
        if session.party == 0:
            made, make, own = [], JobStream.__init__, get_ident()

            def broken(self, *given):
                if get_ident() == own:
                    made.append(self)
                    if len(made) == 3:
                        raise error
                make(self, *given)

            with monkeypatch.context() as patch, pytest.raises(error):
                patch.setattr(JobStream, "__init__", broken)
                session.reserve(4)
            with pytest.raises(ChannelClosed):
                session.run(S10, OWN[0])
            return session.remaining
        session.reserve(4)
        with pytest.raises(ChannelError):
            session.run(S10, OWN[1])
        return session.remaining

    assert run_pair(paths, state_dirs(tmp_path), work) == [5, 5]


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_robots_at_different_jobs_find_out_before_anything_is_opened(tmp_path, security):
    paths = deal(tmp_path / "m", S10, SHAPES, 9, security)

    def work(session):
        session.run(S10, OWN[session.party])
        session.reserve(2)
        if session.party == 0:
            session._reserved.popleft()
        return session.run(S10, OWN[session.party])

    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (ProtocolViolation, PeerAborted))


def test_a_session_can_be_closed_after_its_tape_failed(tmp_path):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 3), state_dirs(tmp_path)

    def work(session):
        session.run(S10, OWN[session.party])
        session._tape._state = None  # as after an error of the disk
        session.close()
        session.close()
        return repr(session)

    assert all("dead (closed)" in text for text in run_pair(paths, states, work))
    Tape.open(paths[0], state_dir=states[0]).close()


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("end", ["runs", "raises", "fails a check", "exits", "closes"])
def test_a_fork_that_leaves_a_session_touches_neither_tape_nor_connection(tmp_path, end):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 3), state_dirs(tmp_path)

    def leave(session):
        with session:
            if end == "runs":
                session.run(S10, OWN[0])
            elif end == "raises":
                raise RuntimeError("an error of the child's own")
            elif end == "fails a check":
                raise MacCheckFailed
            elif end == "exits":
                raise SystemExit

    def work(session):
        first = session.run(S10, OWN[session.party]).value
        if session.party == 0:
            session._channel._send_last = lambda *frame: os.abort()
            before = paths[0].read_bytes()
            said = in_a_fork(lambda: leave(session))
            named = {"runs": "TapeInUse", "raises": "RuntimeError", "fails a check": "MacCheckFailed"}
            assert said == (named | {"exits": "SystemExit", "closes": ""})[end]
            assert paths[0].read_bytes() == before
        return first, session.run(S10, OWN[session.party]).value, session.remaining

    assert run_pair(paths, states, work) == [(0.0, 0.0, 1)] * 2


def test_a_second_thread_is_told_and_changes_nothing(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)
    inside, told = Event(), Event()

    def work(session):
        post = session._channel.post

        def slow(kind, payload, expect, *rest):
            inside.set()
            assert told.wait(10)
            return post(kind, payload, expect, *rest)

        errors = []

        def intrude():
            assert inside.wait(10)
            for call in (
                lambda: session.run(S10, OWN[0]),
                lambda: session.reserve(1),
                lambda: session.exchange_note({}),
            ):
                with pytest.raises(TapeInUse, match="another thread") as caught:
                    call()
                errors.append(caught)
            told.set()

        if session.party == 0:
            session._channel.post = slow
            other = Thread(target=intrude)
            other.start()
            value = session.run(S10, OWN[0]).value
            other.join()
            assert len(errors) == 3
        else:
            value = session.run(S10, OWN[1]).value
        return value, session.remaining

    assert run_pair(paths, state_dirs(tmp_path), work) == [(0.0, 2)] * 2


def test_the_jobs_left_are_known_after_the_end(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 5)
    kept = []

    def work(session):
        kept.append(session)
        session.reserve(2)
        session.run(S10, OWN[session.party])
        if session.party == 0:
            raise RuntimeError("an error of this side's own")
        session.run(S10, OWN[session.party])

    errors = run_pair(paths, state_dirs(tmp_path), work)
    assert isinstance(errors[0], RuntimeError) and isinstance(errors[1], ChannelError)
    assert [session.remaining for session in kept] == [3, 3]  # what was reserved is lost
    assert {repr(session).split(": ")[1] for session in kept} == {
        "dead (RuntimeError)>",
        "dead (PeerAborted)>",
    }


def test_the_jobs_left_are_known_after_a_quiet_end(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 5)

    def work(session):
        session.run(S10, OWN[session.party])
        session.close()
        return session.remaining

    assert run_pair(paths, state_dirs(tmp_path), work) == [4, 4]


ESCAPES = "\x1b[2J\x1b]0;owned\x07\u202e\x9b"


@pytest.mark.parametrize("where", ["version", "jobs", "title", "agents"])
def test_nothing_that_a_terminal_obeys_gets_from_a_peer_into_an_error(tmp_path, where):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)
    first, second = memory_pair(timeout=5.0)
    honest = second.post

    def post(kind, payload, expect, *rest):
        text = b"".join(bytes(part) for part in payload)
        if kind == FrameKind.CONTROL:
            hostile = json_with(text, where)
            return honest(kind, [hostile], expect, *rest)
        return honest(kind, payload, expect, *rest)

    second.post = post
    error, _ = run_pair(
        paths, state_dirs(tmp_path), lambda s: s.run(S10, OWN[s.party]), channels=(first, second)
    )
    assert isinstance(error, TapeMismatch)
    assert str(error).isprintable() and "[2J" in str(error)


def json_with(text, where):
    """A control message with escapes in one field (of the agreement, where both messages have it)."""
    fields = json.loads(text)
    if where in fields and (where != "jobs" or "text" in fields):
        fields[where] = [ESCAPES, ESCAPES] if where == "agents" else ESCAPES
        fields |= {"text": "another"} if "text" in fields else {}
    return json.dumps(fields).encode()


@dataclass(frozen=True)
class Weighted:
    weights: object

    max_norm: float = 8.0

    async def __call__(self, engine, x, y):
        return dot(x * self.weights, y)


@dataclass(frozen=True)
class Shifted:
    by: float = field(compare=False, default=0.0)
    max_norm: float = 8.0

    @unchanging
    async def __call__(self, engine, x, y):
        return dot(x, y) + self.by


@pytest.mark.parametrize("weights", [np.array([1, 2, 3, 4]), [1, 2, 3, 4], (1, 2, 3, 4)], ids=type)
def test_a_program_may_hold_what_cannot_be_hashed(tmp_path, weights):
    paths = deal(tmp_path / "m", Weighted(weights), SHAPES, 2)
    results = run_pair(paths, state_dirs(tmp_path), lambda s: s.run(Weighted(weights), [1.0] * 4).value)
    assert results == [10.0, 10.0]


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_a_constant_that_is_left_out_of_comparison_is_agreed_on_all_the_same(tmp_path, security):
    paths = deal(tmp_path / "m", Shifted(), SHAPES, 4, security)

    def work(session):
        session.run(Shifted(0.0), [1.0] * 4)
        return session.run(Shifted(5.0 if session.party == 0 else 0.0), [1.0] * 4)

    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (OutOfStep, PeerAborted, TapeMismatch))


def test_an_array_that_changes_under_a_frozen_program_is_noticed(tmp_path):
    paths = deal(tmp_path / "m", Shifted(np.zeros(1)), SHAPES, 4, "semi-honest")

    def work(session):
        program = Shifted(np.zeros(1))
        session.run(program, [1.0] * 4)
        program.by[0] = session.party
        session.run(program, [1.0] * 4)

    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (OutOfStep, PeerAborted, TapeMismatch))


def test_plans_are_kept_for_what_cannot_change_and_for_few_programs():
    plans = Plans(SHAPES, "malicious")
    first = plans.of(is_candidate(S10, 0.5))
    assert plans.of(is_candidate(S10, 0.5)) is first
    for k in range(3 * KEPT):
        plans.of(is_candidate(S10, k / 100 - 0.3))
    assert len(plans) == KEPT
    assert (
        plans.of(is_candidate(S10, 0.5)) is not first and plans.of(is_candidate(S10, 0.5)).text == first.text
    )


def test_what_a_program_is_made_of_tells_apart_whatever_differs():
    different = [0, 0.0, -0.0, False, "0", None, (0,), (0.0,), Shifted(0.0), Shifted(-0.0), Shifted(0)]
    assert len({constants(one) for one in different}) == len(different)
    bound = [1]
    assert constants(Weighted(1.0)) is None  # its __call__ is not declared unchanging
    for changing in ([0], np.zeros(1), Shifted([0]), ((0, [0]),), lambda: bound, Shifted(0.0).__call__):
        assert constants(changing) is None
    assert constants(S10.formula) is not None


def test_a_number_that_a_users_score_reads_may_change(tmp_path):
    """Whatever a function reads (a global, a default) is read anew: only a declared function is kept."""
    paths = deal(tmp_path / "m", scaled_score(), SHAPES, 4)

    def work(session):
        first = session.run(scaled_score(), [0.5] * 4).value
        if session.party == 0:
            FACTOR[0] = 3
        told = session.run(scaled_score(), [0.5] * 4)
        return first, told

    FACTOR[0] = 2
    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (TapeMismatch, PeerAborted, OutOfStep))


FACTOR = [2]


async def scaled(engine, x, y):
    return dot(x * FACTOR[0], y)


def scaled_score():
    return Score("W", "scaled", similarity=True, formula=scaled, max_norm=8.0)


def test_a_tape_that_a_fork_closes_stays_locked_by_its_parent(tmp_path):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 3), state_dirs(tmp_path)
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        in_a_fork(tape.close)
        with pytest.raises(TapeInUse):
            Tape.open(paths[0], state_dir=states[0])
        assert len(tape.reserve(1)) == 1


def test_a_session_that_nobody_holds_any_more_goes_at_once(tmp_path):
    """Not with the next collection of cycles, which may be far away."""
    paths = deal(tmp_path / "m", S10, SHAPES, 2)
    seen = []

    def work(session):
        session.run(S10, OWN[session.party])
        seen.append(weakref.ref(session))

    gc.disable()
    try:
        run_pair(paths, state_dirs(tmp_path), work, channels=memory_pair(timeout=5.0))
        assert [one() for one in seen] == [None, None]
    finally:
        gc.enable()


def test_a_job_is_used_up_when_both_pad_and_record_are():
    stream = JobStream(bytes(32), 16, bytes(16))
    assert not stream.exhausted
    stream.pad((1,))
    assert not stream.exhausted
    stream.correction((1,))
    assert stream.exhausted
