"""What is said about a tape that is damaged or is none, and that ``--verify`` finds damage in time."""

import errno
import json
import os

import pytest
from tape_helpers import deal, skip_sync

from spdz.__main__ import main
from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.tape import Tape, tape_status, verify, verify_corrections

NEVER = "never copy an old one back"


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


def flip(path, offset):
    data = bytearray(path.read_bytes())
    data[offset] ^= 1
    path.write_bytes(data)


def corrections_of(path, state):
    with Tape.open(path, state_dir=state) as tape:
        return tape._layout.corrections, tape._layout.stride


def told(path, state, count=10):
    """What the error says of a tape that a robot opens and uses."""
    with pytest.raises(TapeError) as caught, Tape.open(path, state_dir=state) as tape:
        tape.reserve(count)
    return str(caught.value)


def test_a_damaged_tape_may_be_copied_again_only_if_nothing_of_it_was_used(path, state):
    start, stride = corrections_of(path, state)
    flip(path, start + 5 * stride)
    assert "Nothing of this tape was used: copy it again" in told(path, state)
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(1)
    message = told(path, state, 9)
    assert "This tape has been used: deal anew for both robots" in message and NEVER in message
    assert "copy it again" not in message and "Nothing" not in message


def test_a_used_tape_that_was_copied_back_counts_as_used(path, state):
    start, stride = corrections_of(path, state)
    flip(path, start + 5 * stride)
    old = path.read_bytes()
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(2)
    path.write_bytes(old)
    assert "This tape has been used" in told(path, state, 8)


def test_a_tape_that_shrinks_comes_with_the_same_advice(path, state):
    with Tape.open(path, state_dir=state) as tape:
        os.truncate(path, path.stat().st_size - 1)
        with pytest.raises(TapeDamaged, match="Nothing of this tape was used"):
            tape.reserve(10)
        tape.reserve(0)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path: flip(path, 30), "checksum of the header"),
        (lambda path: os.truncate(path, 9000), "not copied whole"),
        (lambda path: flip(path, 4096), "state at byte 4096"),
    ],
    ids=["header", "cut", "state"],
)
def test_damage_that_hides_whether_a_tape_was_used_comes_with_both_ways(path, state, spoil, says):
    spoil(path)
    message = told(path, state)
    assert says in message and "If this tape was never used, copy it again" in message and NEVER in message
    with pytest.raises(TapeDamaged, match="If this tape was never used"):
        tape_status(path, state)


@pytest.mark.parametrize(("jobs", "says"), [(0, "Nothing of this tape was used"), (1, "has been used")])
def test_the_mark_knows_whether_a_tape_with_a_damaged_state_was_used(path, state, jobs, says):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(jobs)
    path.write_bytes(path.read_bytes()[:4096] + bytes(8192) + path.read_bytes()[12288:])
    assert says in told(path, state)
    with pytest.raises(TapeDamaged, match=says):
        tape_status(path, state)


@pytest.mark.parametrize("look", [lambda path, state: Tape.open(path, state_dir=state), tape_status])
def test_what_is_no_tape_is_named_and_an_example_given(tmp_path, path, state, look):
    (tmp_path / "foreign").write_bytes(b"x" * 5000)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "empty").mkdir()
    for name, says in (
        ("missing.tape", "no such file"),
        ("foreign", "not a tape: it does not start with"),
        ("pipe", "not a tape: a pipe"),
        ("mission", f"is a folder: give the tape in it, such as {path}"),
        (".", f"is a folder: give the tape in it, such as {path}"),
        ("empty", "is a folder: give the tape in it, such as .*PEER.tape"),
        ("foreign/x", r"cannot open the tape \(Not a directory\)"),
    ):
        with pytest.raises(TapeError, match=says) as caught:
            look(tmp_path / name, state)
        assert not any(words in str(caught.value) for words in ("writable", "deal anew", "disk failed"))


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS])
def test_a_tape_that_cannot_be_written_is_said_to_have_to_be_writable(path, state, monkeypatch, number):
    def refused(*arguments):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("spdz.tape.hold.FileIO", refused)
    with pytest.raises(TapeError, match="must be writable, because every use is recorded"):
        Tape.open(path, state_dir=state)


def shown(capsys, path, state, *words):
    status = main(["tape", str(path), "--state-dir", str(state), *words])
    return status, *capsys.readouterr()


def test_verify_finds_a_damaged_job_that_a_look_does_not(path, state, capsys):
    start, stride = corrections_of(path, state)
    flip(path, start + 7 * stride)
    status, out, err = shown(capsys, path, state)
    assert (status, err) == (0, "") and "no job (--verify)" in out
    status, out, err = shown(capsys, path, state, "--verify")
    assert (status, out) == (2, "") and "checksum of job 7" in err and len(err.splitlines()) == 1
    status, out, err = shown(capsys, path, state, "--verify", "--json")
    assert (status, err) == (2, "") and json.loads(out)["error"] == "TapeDamaged"


def test_verify_passes_a_whole_tape_and_says_what_it_read(path, state, capsys):
    before = path.read_bytes()
    status, out, err = shown(capsys, path, state, "--verify")
    assert (status, err) == (0, "") and "every job that is left" in out
    for words in ((), ("--verify",)):
        status, out, _ = shown(capsys, path, state, "--json", *words)
        assert (status, json.loads(out)["verified"]) == (0, bool(words))
    assert path.read_bytes() == before and not state.exists()


def test_damage_of_a_used_job_matters_no_more(path, state, capsys):
    start, stride = corrections_of(path, state)
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(3)
    flip(path, start + 2 * stride)
    assert shown(capsys, path, state, "--verify")[0] == 0
    flip(path, start + 3 * stride)
    status, _, err = shown(capsys, path, state, "--verify")
    assert status == 2 and "checksum of job 3" in err and "This tape has been used" in err


@pytest.mark.parametrize("size", [1, 100, 1 << 20])
def test_verify_reads_every_job_in_parts_and_reports_them(path, state, monkeypatch, size):
    monkeypatch.setattr(verify, "_READ_BYTES", size)
    start, stride = corrections_of(path, state)
    steps = []
    verify_corrections(path, tape_status(path, state), lambda done, total: steps.append((done, total)))
    assert steps[-1] == (10, 10) and len(steps) == {1: 10, 100: 5}.get(size, 1)
    for job in range(10):
        flip(path, start + job * stride)
        with pytest.raises(TapeDamaged, match=f"checksum of job {job} "):
            verify_corrections(path, tape_status(path, state))
        flip(path, start + job * stride)


def test_a_tape_in_use_is_verified_and_a_destroyed_one_has_nothing_to_verify(path, state, capsys):
    with Tape.open(path, state_dir=state) as tape:
        assert shown(capsys, path, state, "--verify")[0] == 0
        tape.destroy()
    status, out, _ = shown(capsys, path, state, "--verify")
    assert status == 0 and "destroyed" in out


def test_verify_of_a_file_that_has_gone_is_a_tape_error(path, state):
    status = tape_status(path, state)
    path.unlink()
    with pytest.raises(TapeError, match="no such file"):
        verify_corrections(path, status)
