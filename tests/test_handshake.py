"""What a peer may greet with: anything, and every lie is refused before a job is used."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from session_helpers import deal, state_dirs

from protocols.scores import S10
from spdz import ProtocolViolation, Session, TapeMismatch
from spdz.channels import FrameKind, memory_pair
from spdz.session.handshake import Hello, session_id
from spdz.tape import Tape


@pytest.fixture
def robots(tmp_path):
    """Two dealt tapes and their state folders."""
    return deal(tmp_path / "m", S10, ((4,), (4,)), 3), state_dirs(tmp_path)


def honest_greeting(robots) -> dict:
    paths, states = robots
    with Tape.open(paths[1], state_dir=states[1]) as tape:
        return json.loads(Hello.of(tape).encode())


def refusal(robots, message: bytes) -> str:
    """Greet party 0 with ``message``; returns its error, having seen that no job was used."""
    paths, states = robots
    ours, theirs = memory_pair(timeout=2.0)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(theirs.exchange, FrameKind.CONTROL, [message], None)
        with pytest.raises((TapeMismatch, ProtocolViolation)) as caught:
            Session(Tape.open(paths[0], state_dir=states[0]), ours)
        future.result(timeout=5)
    theirs.close()
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        assert tape.cursor == 0
    return str(caught.value)


def test_the_honest_greeting_is_accepted(robots):
    paths, states = robots
    ours, theirs = memory_pair(timeout=2.0)
    message = json.dumps(honest_greeting(robots)).encode()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(theirs.exchange, FrameKind.CONTROL, [message], None)
        with Session(Tape.open(paths[0], state_dir=states[0]), ours) as session:
            assert session.remaining == 3
        future.result(timeout=5)
    theirs.close()


@pytest.mark.parametrize(
    "message",
    [b"", b"[]", b"{}", b"\xff\xfe", b'{"version":1}', b"[" * 60000, b'{"version":99}', b"null", b"1e999"],
)
def test_a_malformed_greeting_is_refused(robots, message):
    refusal(robots, message)


@pytest.mark.parametrize("claim", [-1, 4, 1 << 70])
def test_a_peer_that_claims_an_absurd_cursor_is_refused(robots, claim):
    refusal(robots, json.dumps({**honest_greeting(robots), "cursor": claim}).encode())


@pytest.mark.parametrize(
    "change",
    [
        {"program": {"shapes": float("nan")}},
        {"program": {"\x1b[2J evil\n" * 900: 1}},
        {"security": "\x1b[31m" + "x" * 9000},
        {"cursor": 10**2000},
        {"agents": ["alice", "eve\n\x1b"]},
    ],
)
def test_what_a_peer_greets_with_cannot_deface_an_error(robots, change):
    error = refusal(robots, json.dumps({**honest_greeting(robots), **change}).encode())
    assert len(error) < 1000 and error.isprintable()


def test_the_session_id_depends_on_everything_that_either_side_said(robots):
    paths, states = robots
    with (
        Tape.open(paths[0], state_dir=states[0]) as first,
        Tape.open(paths[1], state_dir=states[1]) as second,
    ):
        greetings = Hello.of(first), Hello.of(second)
    known = {session_id(*greetings)}
    assert session_id(*greetings[::-1]) in known
    for side in (0, 1):
        for name in Hello.__slots__:
            old = getattr(greetings[side], name)
            new = {int: 7, str: "another", tuple: ("a", "b"), dict: {"x": 1}}[type(old)]
            if name == "party":
                continue  # which says whose greeting comes first
            changed = [*greetings]
            changed[side] = replace(greetings[side], **{name: new})
            known.add(session_id(*changed))
    assert len(known) == 1 + 2 * (len(Hello.__slots__) - 1)
