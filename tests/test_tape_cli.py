"""``python -m spdz tape``: what it shows, that it disturbs nobody, and that it tells no secret."""

import fcntl
import json
import os
import subprocess
import sys
import threading

import pytest
from session_helpers import state_dirs
from tape_helpers import deal as deal_any
from tape_helpers import skip_sync

from dealer.mission import deal_mission
from protocols.catalog import Purpose
from spdz.__main__ import main
from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError
from spdz.tape import Tape, tape_status
from spdz.tape.state import latest_slot


@pytest.fixture
def tape(tmp_path):
    purpose = Purpose("S6", 8, tile=(2, 3), max_norm=1.0)
    deal_mission(tmp_path / "m", ("alice", "bob"), purpose, 60)
    return tmp_path / "m" / "alice" / "bob.tape"


def show(capsys, *words):
    """Status, standard output and standard error."""
    status = main(["tape", *map(str, words)])
    return status, *capsys.readouterr()


def facts(capsys, *words):
    status, out, err = show(capsys, "--json", *words)
    assert (status, err) == (0, "")
    return json.loads(out)


def test_text_says_what_it_is_for_what_is_left_and_how_to_deal_more(tape, capsys):
    with Tape.open(tape) as opened:
        opened.reserve(3)
    status, out, err = show(capsys, tape)
    assert (status, err) == (0, "")
    for part in ("alice", "bob", "S6", "8-D", "norm at most 1", "the candidate bit alone", "malicious"):
        assert part in out
    assert "42 comparisons in 7 of 10 jobs (2 of alice x 3 of bob descriptors a job)" in out
    assert "ready" in out and "t*t" in out
    assert "python -m spdz.dealer --agents alice bob" in out and "--tile 2x3" in out


def test_json_has_the_same_facts(tape, capsys):
    with Tape.open(tape) as opened:
        header = opened.header
        opened.reserve(4)
    answer = facts(capsys, tape)
    wanted = {"robot": "alice", "peer": "bob", "score": "S6", "dim": 8, "tile": [2, 3], "reveal": "bit"}
    wanted |= {"jobs": 10, "used": 4, "left": 6, "comparisons_left": 36, "security": "malicious"}
    wanted |= {"bytes": tape.stat().st_size, "in_use": False, "destroyed": False, "rolled_back": False}
    assert wanted.items() <= answer.items()
    assert header.mission.startswith(answer["mission"]) and header.tape.startswith(answer["tape"])
    assert len(answer["tape"]) < len(header.tape)


def test_nothing_is_written_and_no_secret_is_shown(tape, capsys):
    with Tape.open(tape) as opened:
        opened.reserve(1)
        secrets = [opened.alpha, opened._usable().chain]
    state = tape.parent.parent.parent / "xdg-state" / "spdz"
    files = [tape, *state.iterdir()]
    assert all(any(secret in file.read_bytes() for file in files) for secret in secrets)
    before = [(file, file.read_bytes(), file.stat().st_mtime_ns) for file in files]
    shown = show(capsys, tape)[1] + show(capsys, "--json", tape)[1]
    assert [(file, file.read_bytes(), file.stat().st_mtime_ns) for file in files] == before
    assert sorted(state.iterdir()) == sorted(set(files) - {tape})
    for secret in secrets:
        assert secret.hex() not in shown and str(int.from_bytes(secret, "little")) not in shown
    assert not any(secret in repr(tape_status(tape)).encode("latin1", "replace") for secret in secrets)


def test_a_tape_that_was_never_open_needs_no_state_folder(tape, capsys, tmp_path):
    assert facts(capsys, tape, "--state-dir", tmp_path / "nowhere")["used"] == 0
    assert not (tmp_path / "nowhere").exists()
    assert "unused" in show(capsys, tape)[1]


def test_a_tape_in_use_is_shown_as_such_also_by_its_copy(tape, capsys, tmp_path):
    copy = tmp_path / "copy.tape"
    copy.write_bytes(tape.read_bytes())
    holder = (
        "import sys, time; from spdz.tape import Tape\n"
        "tape = Tape.open(sys.argv[1]); tape.reserve(2); print(flush=True); sys.stdin.read()"
    )
    words = [sys.executable, "-c", holder, str(tape)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        for path in (tape, copy):
            answer = facts(capsys, path)
            assert (answer["in_use"], answer["used"], answer["rolled_back"]) == (True, 2, False)
        assert "in use" in show(capsys, tape)[1]
        process.communicate(b"")
    assert facts(capsys, tape)["in_use"] is False
    assert facts(capsys, copy)["rolled_back"] is True


def test_looking_never_keeps_a_robot_from_opening(tape, monkeypatch):
    """Many looks a moment, and as many openings: none fails, and every look sees a whole state."""
    skip_sync(monkeypatch)
    stop, seen, errors = threading.Event(), [], []

    def look():
        while not stop.is_set():
            try:
                seen.append(tape_status(tape).used)
            except TapeError as error:
                errors.append(error)

    looking = [threading.Thread(target=look) for _ in range(2)]
    for thread in looking:
        thread.start()
    try:
        for _ in range(10):
            with Tape.open(tape) as opened:
                opened.reserve(1)
    finally:
        stop.set()
        for thread in looking:
            thread.join()
    assert errors == [] and len(seen) > 10 and set(seen) <= set(range(11))


def test_a_look_at_the_lock_only_delays_an_opening(tape):
    with tape.open("rb") as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        done = threading.Timer(0.03, fcntl.flock, (looking, fcntl.LOCK_UN))
        done.start()
        with Tape.open(tape) as opened:
            assert opened.cursor == 0
        done.join()


def test_a_state_that_moves_on_between_two_reads_is_read_again(tape, monkeypatch):
    reads = []

    def torn_at_first(slots, binding):
        reads.append(slots)
        return latest_slot(slots, binding) if len(reads) > 2 else None

    monkeypatch.setattr("spdz.tape.status.latest_slot", torn_at_first)
    assert tape_status(tape).used == 0 and len(reads) == 3


def test_an_older_copy_counts_the_jobs_in_between_as_used(tape, capsys):
    old = tape.read_bytes()
    with Tape.open(tape) as opened:
        opened.reserve(5)
    tape.write_bytes(old)
    answer = facts(capsys, tape)
    assert (answer["rolled_back"], answer["used"], answer["left"]) == (True, 5, 5)
    assert "older copy" in show(capsys, tape)[1]


def test_a_destroyed_tape_and_its_copies_have_nothing_left(tape, capsys, tmp_path):
    copy = tmp_path / "copy.tape"
    copy.write_bytes(tape.read_bytes())
    with Tape.open(tape) as opened:
        opened.destroy()
    for path in (tape, copy):
        answer = facts(capsys, path)
        assert answer["destroyed"] and answer["left"] == answer["comparisons_left"] == 0
        assert "destroyed" in show(capsys, path)[1]
    with pytest.raises(TapeDestroyed):
        Tape.open(copy)


def test_a_used_up_tape_says_so(tape, capsys):
    with Tape.open(tape) as opened:
        opened.reserve(10)
    assert "used up" in show(capsys, tape)[1]


def test_another_state_folder_is_another_memory(tape, capsys, tmp_path):
    states = state_dirs(tmp_path)
    old = tape.read_bytes()
    with Tape.open(tape, state_dir=states[0]) as opened:
        opened.reserve(2)
    tape.write_bytes(old)
    assert facts(capsys, tape, "--state-dir", states[0])["used"] == 2
    assert facts(capsys, tape, "--state-dir", states[1])["used"] == 0


def test_folders_show_every_tape_below_them(tape, capsys):
    status, out, _ = show(capsys, "--json", tape.parent.parent)
    robots = [json.loads(line)["robot"] for line in out.splitlines()]
    assert (status, robots) == (0, ["alice", "bob"])


def test_a_tape_of_a_program_of_ones_own_is_shown_without_a_purpose(tmp_path, capsys):
    path = deal_any(tmp_path / "own.tape", program={"shapes": [[4], [4]]})
    answer = facts(capsys, path)
    assert answer["program"] == {"shapes": [[4], [4]]} and "comparisons_left" not in answer
    out = show(capsys, path)[1]
    assert "program of your own" in out and "deal more" not in out


@pytest.mark.parametrize(
    "program",
    [
        {"score": "S10", "reveal": "bit", "dim": "x", "tile": [1, 1], "max_norm": 1},
        {"score": ["S10"], "reveal": {}, "dim": 3, "tile": 7, "max_norm": None},
        {"score": "S10", "reveal": "bit", "dim": 3, "tile": [1, 1], "max_norm": "nan"},
        {"score": "\x1b[2J", "shapes": "\x1b[31m"},
    ],
)
def test_a_strange_header_breaks_nothing_and_reaches_no_terminal(tmp_path, capsys, program):
    path = deal_any(tmp_path / "strange.tape", program=program)
    status, out, err = show(capsys, path)
    assert (status, err) == (0, "") and "\x1b" not in out and "10 of 10 jobs" in out


def damage(path, offset, data=b"\xff" * 16):
    with open(path, "r+b") as file:
        file.seek(offset)
        file.write(data)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b""), "not a tape"),
        (lambda path: path.write_bytes(b"x" * 5000), "not a tape"),
        (lambda path: os.truncate(path, 9000), "truncated"),
        (lambda path: damage(path, 30), "checksum of the header"),
        (lambda path: damage(path, 4096), "makes no sense"),
        (lambda path: (path.unlink(), os.mkfifo(path)), "not a tape: a pipe"),
        (lambda path: (path.unlink(), path.mkdir()), "no *.tape"),
    ],
    ids=["missing", "empty", "foreign", "cut", "header", "state", "pipe", "empty folder"],
)
def test_what_is_no_tape_is_one_line_and_status_2_and_the_others_are_shown(tape, capsys, spoil, says):
    spoil(tape)
    other = tape.parent.parent / "bob" / "alice.tape"
    status, out, err = show(capsys, tape, other)
    assert status == 2 and "robot     bob" in out
    assert says in err and len(err.splitlines()) == 1
    status, out, err = show(capsys, "--json", tape, other)
    first, second = map(json.loads, out.splitlines())
    assert (status, err) == (2, "") and says in first["message"] and second["robot"] == "bob"


def test_a_damaged_mark_is_told(tape, capsys):
    with Tape.open(tape) as opened:
        opened.reserve(1)
    (mark,) = (tape.parent.parent.parent / "xdg-state" / "spdz").glob("*.mark")
    mark.write_text("rubbish")
    status, out, err = show(capsys, tape)
    assert (status, out) == (2, "") and "high-water mark is damaged" in err
    with pytest.raises(TapeDamaged):
        tape_status(tape)
