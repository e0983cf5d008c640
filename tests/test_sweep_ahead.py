"""What is done before the inputs are known is timed with reserving, and with no comparison."""

import subprocess
import sys
import time

import bench.sweep.ahead
import bench.sweep.measuring
from bench.sweep.ahead import ABOUT, Ahead, reserved
from bench.sweep.cells import Cell
from bench.sweep.floor import WARM_UP
from bench.sweep.measuring import Bench
from bench.sweep.parties import SecureWork
from bench.sweep.standing import StandingPair
from protocols.scores import SCORES
from spdz.session import Session

SLEEP = 0.5
RESERVE = Session.reserve


def slow(session, jobs, program=None):
    """Reserve slowly; compile twice as slowly."""
    time.sleep(SLEEP if jobs else 2 * SLEEP)
    return RESERVE(session, jobs, program)


class SlowAtOne(SecureWork):
    """The same work; party 1 reserves slowly."""

    def __call__(self, index, line):
        Session.reserve = slow if index == 1 else RESERVE
        return super().__call__(index, line)


def test_reserving_is_timed_by_the_job_of_the_slower_party_and_in_no_trial(tmp_path, monkeypatch):
    monkeypatch.setattr(bench.sweep.measuring, "SecureWork", SlowAtOne)
    with StandingPair() as pair:
        trials = Bench(pair, None, tmp_path, 2, 1).measure(Cell(16, "S10", "malicious"))
    jobs = WARM_UP + 2 + 1
    for trial in trials:
        assert 2e3 * SLEEP <= trial.compile_ms and 1e3 * SLEEP <= jobs * trial.ahead_ms
    assert min(trial.ms for trial in trials) < trials[0].ahead_ms


class FakeSession:
    """Notes what it is asked for; it compiles for 7 s, and reserves for 2 s a job."""

    def __init__(self):
        self.asked = []
        self.now = 100.0

    def reserve(self, jobs, program=None):
        """As a session's."""
        self.asked.append((jobs, program))
        self.now += 2 * jobs or 7


def test_the_program_is_compiled_before_all_jobs_are_reserved_at_once(monkeypatch):
    session, program = FakeSession(), SCORES["S10"]
    monkeypatch.setattr(bench.sweep.ahead.time, "perf_counter", lambda: session.now)
    found = reserved(session, 4, program)
    assert session.asked == [(0, program), (4, program)]
    assert found == Ahead(compiling=7.0, a_job=2.0)


def test_the_benchmark_says_what_it_is_and_shows_it():
    text = subprocess.run(
        [sys.executable, "-m", "bench", "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert ABOUT in text and "not in median_ms" in text
    words = "--score S10 --dim 16 --trials 1 --engine spdz clear".split()
    shown = subprocess.run(
        [sys.executable, "-m", "bench", *words], capture_output=True, text=True, check=True
    ).stdout
    header, ours, clear = (line.split() for line in shown.splitlines())
    assert header[4:7] == ["ms", "ahead", "ms"] and float(ours[5]) > 0 and clear[5] == "-"
