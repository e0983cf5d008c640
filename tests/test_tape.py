import os
import shutil
import stat
import subprocess
import sys
import threading
import warnings
from dataclasses import replace

import numpy as np
import pytest
from tape_helpers import ALPHA, HEADER, chains, corrections, deal, skip_sync

from spdz.arithmetic import prf
from spdz.foundations.errors import TapeError, TapeExhausted, TapeInUse, TapeMismatch
from spdz.tape import Tape
from spdz.tape.format import CHUNK


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


@pytest.mark.parametrize("jobs", [1, 1000])
@pytest.mark.parametrize("size", [0, 1, 16, 40])
def test_jobs_come_back_as_dealt(tmp_path, state, jobs, size):
    path = deal(tmp_path / "t.tape", jobs=jobs, correction_bytes=size)
    with Tape.open(path, state_dir=state) as tape:
        assert tape.header == replace(HEADER, jobs=jobs, correction_bytes=size)
        assert (tape.alpha, tape.cursor, tape.remaining, tape.rolled_back) == (ALPHA, 0, jobs, False)
        taken = tape.reserve(1) + tape.reserve(jobs - 1)
        assert tape.remaining == 0
    assert [job.index for job in taken] == list(range(jobs))
    assert [bytes(job.correction) for job in taken] == corrections(tape.header)
    assert [job.key for job in taken] == [prf.job_key(chain) for chain in chains(jobs)]


def test_corrections_of_several_chunks_are_aligned_and_read_only(tmp_path, state):
    path = deal(tmp_path / "t.tape", jobs=2, correction_bytes=2 * CHUNK + 24)
    with Tape.open(path, state_dir=state) as tape:
        for job, dealt in zip(tape.reserve(2), corrections(tape.header), strict=True):
            words = np.frombuffer(job.correction, np.uint64)
            assert words.ctypes.data % 16 == 0
            assert job.correction.readonly
            assert words.tobytes() == dealt


def test_cursor_survives_closing(path, state):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(3)
    with Tape.open(path, state_dir=state) as tape:
        assert (tape.cursor, tape.rolled_back) == (3, False)
        assert tape.reserve(1)[0].key == prf.job_key(chains(4)[3])


def test_used_chain_values_are_nowhere_in_the_file(path, state):
    ratchet = chains(8)
    with Tape.open(path, state_dir=state) as tape:
        for cursor, step in ((1, 1), (4, 3), (5, 1), (7, 2)):
            assert ratchet[tape.cursor] in path.read_bytes()
            tape.reserve(step)
            content = path.read_bytes()
            assert not any(chain in content or prf.job_key(chain) in content for chain in ratchet[:cursor])


def test_repr_shows_no_secret(path, state):
    with Tape.open(path, state_dir=state) as tape:
        job = tape.reserve(1)[0]
        for shown in (repr(job), repr(tape), repr(tape._usable())):
            assert "correction" not in shown
            assert "key" not in shown
            assert repr(ALPHA) not in shown


def test_files_are_private(path, state):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(1)
    for file in (path, *state.iterdir()):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    for folder in (path.parent, state):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert [file.name for file in path.parent.iterdir()] == ["bob.tape"]


def test_header_names_both_robots():
    assert (HEADER.name, HEADER.peer) == ("alice", "bob")
    other = replace(HEADER, party=1)
    assert (other.name, other.peer) == ("bob", "alice")


def test_exhausted_tape_consumes_nothing_and_says_how_to_deal_more(path, state):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(8)
        with pytest.raises(TapeExhausted) as caught:
            tape.reserve(3)
        assert "of 10 jobs dealt for alice and bob, 8 are used and 2 left; 3 are needed" in str(caught.value)
        command = (
            "python -m spdz.dealer --agents alice bob --dim 1536 --max-norm 1.5 --reveal bit --score S10 "
        )
        command += "--tile 1x1 --security malicious --count N --out FOLDER"
        assert command in str(caught.value)
        assert tape.remaining == 2
        assert [job.index for job in tape.reserve(2)] == [8, 9]


def test_reserving_nothing_changes_nothing(path, state):
    with Tape.open(path, state_dir=state) as tape:
        before = path.read_bytes()
        assert tape.reserve(0) == []
        with pytest.raises(ValueError, match="cannot reserve -1"):
            tape.reserve(-1)
        assert path.read_bytes() == before


def test_resume_starts_at_the_larger_cursor(path, state):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(2)
        assert tape.resume(1) == 2
        assert tape.resume(6) == 6
    with Tape.open(path, state_dir=state) as tape:
        assert tape.cursor == 6
        assert tape.reserve(1)[0].key == prf.job_key(chains(7)[6])
        assert tape.resume(10) == 10
        with pytest.raises(TapeExhausted):
            tape.reserve(1)


@pytest.mark.parametrize("claim", [11, -1, 1 << 70, 7.0, None, True])
def test_impossible_claim_is_refused_and_not_stored(path, state, claim):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(2)
        with pytest.raises(TapeMismatch, match="bob says that it is at job"):
            tape.resume(claim)
        assert tape.cursor == 2
    with Tape.open(path, state_dir=state) as tape:
        assert tape.cursor == 2


def test_claim_too_far_ahead_is_refused_and_not_stored(tmp_path, state):
    path = deal(tmp_path / "t.tape", jobs=Tape.MAX_JUMP + 10, correction_bytes=0)
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(1)
        with pytest.raises(TapeMismatch, match="more than 65536 ahead of this tape's 1"):
            tape.resume(Tape.MAX_JUMP + 2)
        with pytest.raises(TapeMismatch):
            tape.resume(5, max_jump=3)
        assert tape.cursor == 1
        assert tape.resume(Tape.MAX_JUMP + 1) == Tape.MAX_JUMP + 1


def test_threads_never_share_a_job(tmp_path, state):
    path = deal(tmp_path / "t.tape", jobs=100)
    with Tape.open(path, state_dir=state) as tape:
        taken = []
        threads = [
            threading.Thread(target=lambda: taken.extend(tape.reserve(1)[0].index for _ in range(25)))
            for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
    assert sorted(taken) == list(range(100))


def test_closed_tape_refuses(path, state):
    tape = Tape.open(path, state_dir=state)
    tape.close()
    tape.close()
    for use in (lambda: tape.reserve(1), lambda: tape.resume(1), lambda: tape.alpha, tape.destroy):
        with pytest.raises(TapeError, match="closed"):
            use()


def test_second_open_is_refused_until_the_first_is_closed(path, state):
    with Tape.open(path, state_dir=state), pytest.raises(TapeInUse, match=r"bob\.tape"):
        Tape.open(path, state_dir=state)
    Tape.open(path, state_dir=state).close()


def test_other_process_is_refused(path, state):
    script = (
        "import sys, pathlib, spdz.tape, spdz.foundations.errors\n"
        "try: spdz.tape.Tape.open(sys.argv[1], state_dir=pathlib.Path(sys.argv[2]))\n"
        "except spdz.foundations.errors.TapeInUse: print('in use')\n"
    )
    command = [sys.executable, "-c", script, str(path), str(state)]
    with Tape.open(path, state_dir=state):
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "in use\n"


def test_copy_of_an_open_tape_is_refused(path, state):
    copy = shutil.copy(path, path.with_name("copy.tape"))
    with Tape.open(path, state_dir=state), pytest.raises(TapeInUse, match="copy"):
        Tape.open(copy, state_dir=state)


def test_both_parties_tapes_may_be_open_on_one_machine(path, state):
    other = deal(path.with_name("alice.tape"), party=1)
    with Tape.open(path, state_dir=state), Tape.open(other, state_dir=state) as tape:
        assert tape.header.name == "bob"


def test_fork_is_noticed(path, state):
    with Tape.open(path, state_dir=state) as tape:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # forking beside BLAS threads, from Python 3.12
            child = os.fork()
        if child == 0:
            refused = 0
            for use in (lambda: tape.reserve(1), lambda: tape.resume(1), tape.destroy):
                try:
                    use()
                except TapeInUse:
                    refused += 1
            tape.close()
            os._exit(refused)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
        assert [job.index for job in tape.reserve(1)] == [0]
        with pytest.raises(TapeInUse):
            Tape.open(path, state_dir=state)


def test_used_corrections_cannot_be_read_from_a_captured_tape(tmp_path, monkeypatch):
    """Not even by a peer that kept its own half: they are sealed under keys that the ratchet has passed."""
    skip_sync(monkeypatch)
    path = deal(tmp_path / "alice.tape")
    with Tape.open(path, state_dir=tmp_path / "state") as tape:
        jobs = tape.reserve(4)
    stored = path.read_bytes()
    assert [bytes(job.correction) for job in jobs] == corrections(HEADER)[:4]
    for correction in corrections(HEADER):
        assert correction not in stored
    for chain in chains(5)[:4]:
        assert prf.seal_key(chain) not in stored and chain not in stored
