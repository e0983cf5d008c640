"""Sessions run a program's code from the second run on, or from the first where jobs were reserved for it."""

import gc
import weakref
from collections import Counter
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import pytest
from compiled_helpers import SECURITIES, one_reads, readings, turned
from session_helpers import deal, run_pair, state_dirs

from protocols import is_candidate
from protocols.scores import S4, S6, S10
from spdz import MacCheckFailed, PeerAborted, dot, measure
from spdz.channels import FrameKind, memory_pair
from spdz.compiled.programs import Programs
from spdz.compiled.slots import NotCompiled
from spdz.compiled.straight import Straight
from spdz.foundations.errors import ChannelClosed, TapeDestroyed, TapeMismatch
from spdz.readings.plans import KEPT, unchanging
from spdz.session.session import _Reserved
from spdz.tape import Tape
from spdz.values.columns import columns

N = 6
SHAPES = ((N,), (N,))
X, Y = np.linspace(-0.3, 0.5, N), np.linspace(0.4, -0.2, N)
OWN = (X, Y)


def values(session, programs):
    return [session.run(one, OWN[session.party]).value for one in programs]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("program", [S4.within(1.0), is_candidate(S10.within(1.0), 0.1)], ids=str)
def test_the_second_run_is_compiled_and_costs_the_same(tmp_path, program, security):
    paths = deal(tmp_path / "m", program, SHAPES, 3, security)
    with readings() as seen:
        runs = run_pair(
            paths, state_dirs(tmp_path), lambda one: [one.run(program, OWN[one.party]) for _ in range(3)]
        )
    assert seen == {("read", 0): 1, ("read", 1): 1, "run": 4, "ahead": 4}
    for party in runs:
        assert {repr(result.stats) for result in party} == {repr(party[0].stats)}
        assert party[2].value == pytest.approx(party[0].value, abs=2**-10)
    assert [one.value for one in runs[0]] == [one.value for one in runs[1]]


def test_reserved_for_a_program_the_first_run_is_compiled(tmp_path):
    program = S6.within(1.0)
    paths = deal(tmp_path / "m", program, SHAPES, 3)

    def work(session):
        session.reserve(2, program)
        return values(session, [program] * 3)

    with readings() as seen:
        first, second = run_pair(paths, state_dirs(tmp_path), work)
    assert seen == {"run": 6, "ahead": 6}  # the third is computed when it runs
    assert first == second == [pytest.approx(((X - Y) ** 2).sum(), abs=1e-3)] * 3


def test_jobs_reserved_for_one_threshold_serve_another(tmp_path):
    def past(threshold):
        return is_candidate(S10.within(1.0), threshold)

    exact = float(X @ Y)
    paths = deal(tmp_path / "m", past(0.0), SHAPES, 5)

    def work(session):
        session.reserve(4, past(exact - 0.1))
        return values(session, [past(exact + d) for d in (-0.1, 0.1, 0.1, -0.1, 0.1)])

    with readings() as seen:
        found = run_pair(paths, state_dirs(tmp_path), work)
    assert found == [[True, False, False, True, False]] * 2
    # The first with another threshold is read; what was computed ahead of it is not used.
    assert seen == {("read", 0): 1, ("read", 1): 1, "run": 8, "ahead": 2 * (4 + 2)}


def test_thresholds_in_turn_keep_their_code(tmp_path):
    programs = [is_candidate(S10.within(1.0), t) for t in (-0.5, 0.5)]
    paths = deal(tmp_path / "m", programs[0], SHAPES, 8)
    with readings() as seen:
        found = run_pair(paths, state_dirs(tmp_path), lambda one: values(one, programs * 4))
    assert found == [[True, False] * 4] * 2
    assert seen["run"] == 2 * 6 and seen["read", 0] == 2


def test_several_jobs_a_run(tmp_path):
    for security in SECURITIES:
        program = S4.within(1.0)
        paths = deal(tmp_path / security, program, SHAPES, 7, security)

        def work(session):
            session.reserve(3, program)  # noqa: B023
            many = session.run_many(program, [OWN[session.party] * k for k in (1, 0.5, -1, 0)])  # noqa: B023
            rest = session.run_many(program, [OWN[session.party]] * 3)  # noqa: B023
            return many, rest

        with readings() as seen:
            first, second = run_pair(paths, state_dirs(tmp_path / security), work)
        assert seen == {"run": 14, "ahead": 14}
        assert first[0].value == second[0].value
        distance = np.linalg.norm(X - Y)
        assert first[0].value == pytest.approx([distance, distance / 2, distance, 0], abs=2e-3)
        assert first[1].stats.rounds == first[0].stats.rounds


@pytest.mark.parametrize("reader", [0, 1])
@pytest.mark.parametrize("security", SECURITIES)
def test_one_robot_compiles_and_the_other_does_not(tmp_path, reader, security):
    program = S4.within(1.0)
    paths = deal(tmp_path / "m", program, SHAPES, 6, security)

    def work(session):
        one = session.run_many(program, [OWN[session.party]] * 3)
        return one.value, [session.run(program, OWN[session.party]).value for _ in range(3)]

    with readings() as seen, one_reads(reader):
        first, second = run_pair(paths, state_dirs(tmp_path), work)
    assert first == second
    assert seen["read", reader] == 6 and seen["read", 1 - reader] == 3 and seen["run"] == 3


def test_one_robot_reserves_for_a_program_and_the_other_does_not(tmp_path):
    program = is_candidate(S6.within(1.0), 0.5)
    paths = deal(tmp_path / "m", program, SHAPES, 2)

    def work(session):
        if session.party:
            session.reserve(2, program)
        return values(session, [program])

    with readings() as seen:
        first, second = run_pair(paths, state_dirs(tmp_path), work)
    assert first == second and seen == {("read", 0): 1, "run": 1, "ahead": 2}


# -- what is never compiled -------------------------------------------------------------------------------


async def a_function(engine, x, y):
    return dot(x, y)


@dataclass
class Changing:
    """A program that may be another one tomorrow."""

    more: int
    max_norm: float = 1.0

    async def __call__(self, engine, x, y):
        return dot(x, y) + self.more


@dataclass(frozen=True)
class Undeclared:
    """Frozen, but its call is not said to depend on nothing else."""

    max_norm: float = 1.0

    async def __call__(self, engine, x, y):
        return dot(x, y)


@dataclass(frozen=True)
class Looking:
    """Unchanging, and it takes cuts of an input, for which there is no code."""

    max_norm: float = 1.0

    @unchanging
    async def __call__(self, engine, x, y):
        return dot(columns(x, 0, 3), columns(y, 0, 3))


@pytest.mark.parametrize("program", [a_function, Changing(2), Undeclared(), Looking()])
def test_a_program_that_can_change_or_looks_at_numbers_is_read_each_time(tmp_path, program):
    paths = deal(tmp_path / "m", program, SHAPES, 4)

    def work(session):
        session.reserve(2, program)
        return values(session, [program] * 4)

    with readings() as seen:
        first, second = run_pair(paths, state_dirs(tmp_path), work)
    assert first == second
    assert seen["run"] == seen["ahead"] == 0 and seen["read", 0] == 4


def test_a_changed_program_is_not_run_as_it_was(tmp_path):
    paths = deal(tmp_path / "m", Changing(1), SHAPES, 3)

    def work(session):
        own, found = Changing(1), []
        for own.more in (1, 1, -1):
            found += values(session, [own])
        return found

    exact = [pytest.approx(X @ Y + more, abs=1e-3) for more in (1, 1, -1)]
    assert run_pair(paths, state_dirs(tmp_path), work) == [exact, exact]


def test_what_is_not_compiled_is_tried_once():
    programs = Programs(SHAPES, "malicious", 0, measure(S10, SHAPES, "malicious").recipe)
    with patch("spdz.compiled.programs.compiled", side_effect=NotCompiled("no")) as attempt:
        assert [programs.ready(S10)[1] for _ in range(4)] == [None] * 4
    assert attempt.call_count == 1


def test_what_is_not_compiled_keeps_no_job_and_no_input_alive(tmp_path):
    """An error that is kept keeps the frames that it went through, and their locals."""
    program = Looking()
    paths, jobs = deal(tmp_path / "m", program, SHAPES, 3), []

    class Watched(_Reserved):
        def __init__(self, *parts):
            super().__init__(*parts)
            jobs.append(weakref.ref(self))

    with patch("spdz.session.session._Reserved", Watched):
        sessions = run_pair(
            paths, state_dirs(tmp_path), lambda one: (values(one, [program] * 3), one._programs)
        )
    gc.collect()
    assert len(jobs) == 6 and len(sessions) == 2
    assert [one() for one in jobs] == [None] * 6


def test_code_goes_with_its_plan():
    """So many programs are kept, the latest used last."""
    first = is_candidate(S10, 0.0)
    programs = Programs(SHAPES, "semi-honest", 0, measure(first, SHAPES, "semi-honest").recipe)
    _, code = programs.ready(first, again=True)
    assert programs.ready(first)[1] is code and code is not None
    for k in range(KEPT):
        programs.ready(is_candidate(S10, 0.001 * (k + 1)))
    assert programs.ready(first)[1] is None and programs.ready(first)[1] is not None


def test_a_program_of_another_tape_is_not_compiled(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 2)

    def work(session):
        for _ in range(3):
            with pytest.raises(TapeMismatch):
                session.run(S6, OWN[session.party])
        return session.remaining

    with patch("spdz.compiled.programs.compiled", side_effect=AssertionError) as attempt:
        assert run_pair(paths, state_dirs(tmp_path), work) == [2, 2]
    assert not attempt.called


def test_a_vector_that_is_too_short_is_refused_by_compiled_code_too(tmp_path):
    program = S10.within(1.0, min_norm=0.5)
    paths = deal(tmp_path / "m", program, SHAPES, 4)

    def work(session):
        kept = [session.run(program, OWN[session.party]).value for _ in range(2)]
        for wrong in (OWN[session.party] / 4, OWN[session.party] * 4, OWN[session.party] * np.nan):
            with pytest.raises(ValueError, match=r"shorter than|norm above|not finite"):
                session.run(program, wrong)
        return session.remaining, [*kept, session.run(program, OWN[session.party]).value]

    first, second = run_pair(paths, state_dirs(tmp_path), work)
    assert first == second and first[0] == 2 and len(set(first[1])) == 1


def test_a_job_too_large_for_a_frame_is_refused_however_often_it_is_tried(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 2)

    def work(session):
        for _ in range(3):
            with pytest.raises(ValueError, match="could need frames"):
                session.run(S10, OWN[session.party])
        return session.remaining

    with patch("spdz.session.session.MAX_FRAME", 16):
        assert run_pair(paths, state_dirs(tmp_path), work) == [2, 2]


# -- what goes wrong --------------------------------------------------------------------------------------


def tampering(channel, wanted, number):
    """A channel that turns over a bit of the so-manyth frame of this kind that it receives."""
    post, take, seen, kinds = channel.post, channel.take, Counter(), []

    def noting(kind, *rest):
        kinds.append(kind)
        post(kind, *rest)

    def lying():
        kind, reply = kinds[-1], take()
        seen[kind] += 1
        return memoryview(bytearray(turned(reply, 5))) if (kind, seen[kind]) == (wanted, number) else reply

    channel.post, channel.take = noting, lying
    return channel


@pytest.mark.parametrize(
    ("kind", "number"), [(FrameKind.DATA, 1), (FrameKind.DATA, 2), (FrameKind.CHECK, 1)], ids=str
)
def test_a_tampered_frame_of_a_compiled_run_destroys_the_tape(tmp_path, kind, number):
    program = S10.within(1.0)
    paths = deal(tmp_path / "m", program, SHAPES, 2)

    def work(session):
        session.reserve(2, program)
        return values(session, [program])

    first, second = memory_pair(timeout=5.0)
    with readings() as seen:
        ends = run_pair(paths, state_dirs(tmp_path), work, channels=(tampering(first, kind, number), second))
    assert seen == {"run": 2, "ahead": 4}
    assert isinstance(ends[0], MacCheckFailed)
    assert isinstance(ends[1], list if kind is FrameKind.CHECK else MacCheckFailed | PeerAborted)
    with pytest.raises(TapeDestroyed):
        Tape.open(paths[0], state_dir=state_dirs(tmp_path)[0])


def test_a_job_that_cannot_be_prepared_ends_the_session(tmp_path):
    """Its number is used: to go on would pair other jobs at the two robots."""
    program = S10.within(1.0)
    paths = deal(tmp_path / "m", program, SHAPES, 5)

    whole, calls = Straight.ahead, Counter()

    def damaged(code, stream, alpha):
        calls[id(code)] += 1
        if calls[id(code)] == 2:
            raise ValueError("the key does not begin with a hash index")
        return whole(code, stream, alpha)

    def work(session):
        with pytest.raises(ValueError, match="hash index"):
            session.reserve(3, program)
        assert not session._reserved
        with pytest.raises(ChannelClosed):
            session.run(program, OWN[session.party])
        return session.remaining

    with patch.object(Straight, "ahead", damaged):
        assert run_pair(paths, state_dirs(tmp_path), work)[0] == 2
