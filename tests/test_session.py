"""Networked parties: values, costs, reuse, and everything that can go wrong between two robots."""

import os

import numpy as np
import pytest
from session_helpers import deal, run_pair, state_dirs

from protocols import is_candidate
from protocols.scores import S6, S10
from spdz import (
    ChannelClosed,
    ChannelError,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
    TapeDestroyed,
    TapeExhausted,
    TapeInUse,
    TapeMismatch,
    dot,
    measure,
    run_local,
)
from spdz.channels import FrameKind, memory_pair
from spdz.tape import Tape

SHAPES = ((4,), (4,))
X, Y = np.array([0.5, -0.5, 0.5, 0.5]), np.array([0.5, 0.5, -0.5, 0.5])
OWN = (X, Y)


def once(program):
    return lambda session: session.run(program, OWN[session.party])


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("program", [S6, S10, is_candidate(S10, 0.5)], ids=["S6", "S10", "candidate"])
def test_a_session_computes_what_run_local_does_at_the_same_cost(tmp_path, program, security):
    paths = deal(tmp_path / "m", program, SHAPES, 3, security)
    results = run_pair(paths, state_dirs(tmp_path), once(program))
    local = run_local(program, X, Y, security)
    for result, stats in zip(results, local.stats, strict=True):
        assert result.value == local.value
        assert result.stats == stats


def test_many_jobs_share_rounds(tmp_path):
    paths = deal(tmp_path / "m", is_candidate(S10, 0.0), SHAPES, 8)
    first, second = run_pair(
        paths,
        state_dirs(tmp_path),
        lambda session: session.run_many(is_candidate(S10, 0.5), [OWN[session.party]] * 7),
    )
    assert first.value == second.value == [False] * 7
    assert first.stats.rounds == 5


def test_the_threshold_may_change_from_call_to_call(tmp_path):
    paths = deal(tmp_path / "m", is_candidate(S10, 0.0), SHAPES, 4)

    def work(session):
        return [session.run(is_candidate(S10, t), OWN[session.party]).value for t in (-0.5, 0.0, 0.25, -1.0)]

    assert run_pair(paths, state_dirs(tmp_path), work) == [[True, True, False, True]] * 2


def test_thresholds_that_differ_are_told_in_words_and_consume_nothing(tmp_path):
    for security in ("malicious", "semi-honest"):
        folder = tmp_path / security
        paths = deal(folder / "m", is_candidate(S10, 0.0), SHAPES, 4, security)
        errors = run_pair(
            paths,
            state_dirs(folder),
            lambda session: session.run(is_candidate(S10, 0.1 * session.party), OWN[session.party]),
        )
        assert all(isinstance(error, TapeMismatch) for error in errors)
        assert "S10 >= 0.0 here, 1 x S10 >= 0.1 there" in str(errors[0])
        with Tape.open(paths[0], state_dir=state_dirs(folder)[0]) as tape:
            assert tape.cursor == 0


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ({"security": "semi-honest"}, "security: malicious here, semi-honest there"),
        ({"jobs": 5}, "number of jobs: 3 here, 5 there"),
        ({"program": S6}, "program fingerprint"),
        ({"shapes": ((5,), (5,))}, "program fingerprint"),
        ({"description": {"score": "S6"}}, "score: S10 here, S6 there"),
        ({}, "dealing run"),
    ],
)
def test_tapes_that_do_not_belong_together_are_refused_with_the_reason(tmp_path, other, says):
    base = {
        "program": S10,
        "shapes": SHAPES,
        "jobs": 3,
        "security": "malicious",
        "description": {"score": "S10"},
    }
    mine = deal(tmp_path / "a", **base)
    theirs = deal(tmp_path / "b", **{**base, **other})
    errors = run_pair((mine[0], theirs[1]), state_dirs(tmp_path), once(S10))
    assert all(isinstance(error, (TapeMismatch, PeerAborted)) for error in errors)
    assert any(says in str(error) for error in errors)


def test_two_tapes_of_the_same_party_are_refused(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)
    copy = tmp_path / "copy.tape"
    copy.write_bytes(paths[0].read_bytes())
    errors = run_pair((paths[0], copy), state_dirs(tmp_path), once(S10))
    assert any("both sides hold the tape of party 0" in str(error) for error in errors)


def test_a_program_that_the_tape_was_not_dealt_for_is_refused(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3, description={"score": "S10"})
    errors = run_pair(paths, state_dirs(tmp_path), once(S6))
    assert all(isinstance(error, TapeMismatch) and "dealt for score S10" in str(error) for error in errors)


def test_an_empty_tape_says_how_to_deal_more(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 2)

    def work(session):
        for _ in range(2):
            session.run(S10, OWN[session.party])
        with pytest.raises(TapeExhausted, match=r"python -m spdz\.dealer"):
            session.run(S10, OWN[session.party])
        with pytest.raises(ChannelClosed):
            session.run(S10, OWN[session.party])
        return True

    assert run_pair(paths, state_dirs(tmp_path), work) == [True, True]


@pytest.mark.parametrize("bad", [[np.nan] * 4, [np.inf] * 4, [1.0] * 5, [[1.0] * 4], [1e9] * 4, ["a"] * 4])
def test_bad_input_consumes_nothing_and_the_session_lives_on(tmp_path, bad):
    paths = deal(tmp_path / "m", S10, SHAPES, 1)

    def work(session):
        with pytest.raises(ValueError):
            session.run(S10, bad)
        return session.run(S10, OWN[session.party]).value

    assert run_pair(paths, state_dirs(tmp_path), work) == [0.0, 0.0]


def tampered_pair(at, change):
    """A memory pair whose second end changes the payload of its exchange number ``at``."""
    first, second = memory_pair(timeout=5.0)
    honest, count = second.post, [0]

    def post(kind, payload, expect, *rest):
        if kind != FrameKind.CONTROL:
            count[0] += 1
            if count[0] == at:
                payload = [change(b"".join(bytes(part) for part in payload))]
        return honest(kind, payload, expect, *rest)

    second.post = post
    return first, second


@pytest.mark.parametrize("round_", [1, 2, 3, 4, 5])
def test_a_cheating_peer_costs_the_honest_side_its_tape_and_nothing_else(tmp_path, round_):
    program = is_candidate(S10, 0.0)
    paths, states = deal(tmp_path / "m", program, SHAPES, 3), state_dirs(tmp_path)
    channels = tampered_pair(round_, lambda frame: bytes([frame[0] ^ 1]) + frame[1:])
    honest, _ = run_pair(paths, states, once(program), channels=channels)
    assert isinstance(honest, MacCheckFailed)
    with pytest.raises(TapeDestroyed):
        Tape.open(paths[0], state_dir=states[0])


def test_a_frame_that_is_no_field_element_is_a_protocol_violation(tmp_path):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 3), state_dirs(tmp_path)
    channels = tampered_pair(2, lambda frame: b"\xff" * len(frame))
    honest, cheat = run_pair(paths, states, once(S10), channels=channels)
    assert isinstance(honest, ProtocolViolation)
    assert isinstance(cheat, ChannelError)
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        assert tape.cursor == 1  # the job stays burnt


@pytest.mark.parametrize("when", [1, 2, 3])
def test_a_peer_that_dies_gives_an_error_and_burns_the_job(tmp_path, when):
    program = is_candidate(S10, 0.0)
    paths, states = deal(tmp_path / "m", program, SHAPES, 3), state_dirs(tmp_path)

    def die(frame):
        raise KeyboardInterrupt

    def guarded(session):
        try:
            return once(program)(session)
        except KeyboardInterrupt:
            return "died"

    honest, dead = run_pair(paths, states, guarded, channels=tampered_pair(when, die))
    assert dead == "died"
    assert isinstance(honest, ChannelError)
    first = run_pair(paths, states, once(program))
    assert [result.value for result in first] == [True, True]
    for path, state in zip(paths, states, strict=True):
        with Tape.open(path, state_dir=state) as tape:
            assert tape.cursor == 2


def test_a_tape_copied_back_never_uses_a_mask_twice(tmp_path):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 6), state_dirs(tmp_path)
    backups = [path.read_bytes() for path in paths]
    frames = []

    def work(session):
        original = session._channel.post

        def spy(kind, payload, expect, *rest):
            if kind == FrameKind.DATA and session.party == 0:
                frames.append(b"".join(bytes(part) for part in payload))
            return original(kind, payload, expect, *rest)

        session._channel.post = spy
        return session.run(S10, OWN[session.party]).value

    # own mark, then a robot that lost its state folder too (caught through the peer's cursor)
    for round_ in range(3):
        assert run_pair(paths, states, work) == [0.0, 0.0]
        paths[0].write_bytes(backups[0])
        if round_ == 1:
            states = [tmp_path / "a fresh home", states[1]]
    masked = [frame for frame in frames if len(frame) == 64]
    assert len(masked) == 3 and len(set(masked)) == 3


def test_no_secret_shows_in_a_repr(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)

    def work(session):
        return repr(session) + repr(session._agreement.mac_check) + repr(session._tape)

    for text in run_pair(paths, state_dirs(tmp_path), work):
        assert "0x" not in text and "b'" not in text


def test_reserving_ahead_runs_without_the_disk(tmp_path, monkeypatch):
    paths = deal(tmp_path / "m", S10, SHAPES, 5)

    def work(session):
        session.reserve(3)
        reserve = session._tape.reserve
        session._tape.reserve = None
        values = [session.run(S10, OWN[session.party]).value for _ in range(3)]
        session._tape.reserve = reserve
        return values, session.remaining

    assert run_pair(paths, state_dirs(tmp_path), work) == [([0.0] * 3, 2)] * 2


def test_errors_are_one_family():
    assert issubclass(MacCheckFailed, SpdzError) and issubclass(TapeExhausted, SpdzError)


def test_only_one_robot_changing_its_threshold_is_told_in_words(tmp_path):
    paths, states = deal(tmp_path / "m", is_candidate(S10, 0.0), SHAPES, 4), state_dirs(tmp_path)

    def work(session):
        session.run(is_candidate(S10, 0.5), OWN[session.party])
        session.run(is_candidate(S10, 0.5 if session.party else 0.6), OWN[session.party])

    for error in run_pair(paths, states, work):
        assert isinstance(error, (OutOfStep, PeerAborted))
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        assert tape.cursor <= 2  # at most the job that was under way is lost, never the tape


def test_programs_that_differ_after_the_last_gate_are_told_apart(tmp_path):
    async def doubled(engine, x, y):
        return dot(x, y) * 2

    assert measure(doubled, SHAPES, "malicious").text != measure(S10, SHAPES, "malicious").text


def test_a_note_that_is_no_object_is_a_protocol_violation(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)

    def liar(session):
        session._agreement.control({"note": 5}, "note")

    honest, _ = run_pair(
        paths, state_dirs(tmp_path), lambda session: session.exchange_note({"descriptors": 1}), liar
    )
    assert isinstance(honest, ProtocolViolation)


def test_too_many_jobs_at_once_are_refused_before_anything_is_consumed(tmp_path, monkeypatch):
    monkeypatch.setattr("spdz.session.session.MAX_FRAME", 200)
    paths, states = deal(tmp_path / "m", S10, SHAPES, 4), state_dirs(tmp_path)

    def work(session):
        with pytest.raises(ValueError, match="fewer at once"):
            session.run_many(S10, [OWN[session.party]] * 4)
        return session.run(S10, OWN[session.party]).value

    assert run_pair(paths, states, work) == [0.0, 0.0]


def test_a_fork_cannot_run_what_its_parent_reserved(tmp_path):
    """Whoever forks, C code too: a job that ran in both processes would show how their inputs differ."""
    paths = deal(tmp_path / "m", S10, SHAPES, 3)

    def work(session):
        session.reserve(2)
        assert session._process == os.getpid()
        session._process -= 1
        with pytest.raises(TapeInUse, match="after the fork"):
            session.run(S10, OWN[session.party])
        session._process += 1
        return session.run(S10, OWN[session.party]).value is not None

    ends = memory_pair(timeout=5.0)
    assert run_pair(paths, state_dirs(tmp_path), work, channels=ends) == [True, True]


@pytest.mark.parametrize("runs", [0, 2])
def test_a_note_that_was_changed_on_the_line_fails_the_next_check(tmp_path, runs):
    paths, states = deal(tmp_path / "m", S10, SHAPES, 3), state_dirs(tmp_path)
    first, second = memory_pair(timeout=5.0)
    honest = second.post

    def post(kind, payload, expect, *rest):
        changed = [bytes(payload[0]).replace(b'"descriptors":2', b'"descriptors":4')]
        return honest(kind, changed if kind == FrameKind.CONTROL else payload, expect, *rest)

    second.post = post

    def work(session):
        for _ in range(runs):
            session.run(S10, OWN[session.party])
        session.exchange_note({"descriptors": 2})
        return session.run(S10, OWN[session.party])

    results = run_pair(paths, states, work, channels=(first, second))
    assert any(isinstance(error, MacCheckFailed) for error in results)
    assert all(isinstance(error, SpdzError) for error in results)


def test_a_control_message_waits_for_the_check_of_what_was_opened(tmp_path):
    paths = deal(tmp_path / "m", S10, SHAPES, 3)

    def work(session):
        session.run(S10, OWN[session.party])
        session._agreement.mac_check.record(np.zeros((1, 2), np.uint64), np.zeros((1, 2), np.uint64))
        session.exchange_note({})

    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (MacCheckFailed, ChannelError))


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_a_program_that_changes_its_own_threshold_is_noticed(tmp_path, security):
    class Movable:
        threshold = 0.0

        async def __call__(self, engine, x, y):
            return await is_candidate(S10, self.threshold)(engine, x, y)

    paths = deal(tmp_path / "m", Movable(), SHAPES, 4, security)

    def work(session):
        program = Movable()
        session.run(program, OWN[session.party])
        program.threshold = float(session.party)
        session.run(program, OWN[session.party])

    for error in run_pair(paths, state_dirs(tmp_path), work):
        assert isinstance(error, (OutOfStep, PeerAborted, TapeMismatch))
