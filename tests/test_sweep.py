"""``python -m bench sweep`` as a command: what it measures, and how it goes on after a stop."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from itertools import groupby

import numpy as np
import pytest

from bench.sweep.ahead import ABOUT as ABOUT_AHEAD
from bench.sweep.results import ABOUT, TABLE, TRIALS, read_about, read_trials
from protocols.scores import SCORES
from spdz.channels.frames import HEADER_BYTES
from spdz.local import run_local

WORDS = ["--scores", "S10", "S2", "--sizes", 8, 40, "--trials", 2]
PROTOCOLS = ["malicious", "semi-honest", "numpy", "cpp"]


def command(*words):
    return [sys.executable, "-m", "bench", "sweep", *map(str, words)]


def sweep(*words, **environment):
    return subprocess.run(
        command(*words),
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "results"
    done = sweep(*WORDS, "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder, [json.loads(line) for line in done.stdout.splitlines()], done.stderr


def cells_of(measured):
    _, rows, errors = measured
    protocols = PROTOCOLS[:3] if "no C++ compiler" in errors else PROTOCOLS
    return [(n, score, protocol) for n in (8, 40) for score in ("S10", "S2") for protocol in protocols], rows


def test_every_cell_is_measured_and_told(measured):
    expected, rows = cells_of(measured)
    assert [(row["n"], row["score"], row["protocol"]) for row in rows] == expected
    for row in rows:
        assert row["trials"] == 2 and row["median_ms"] > 0 and row["max_abs_error"] < 1e-3
        secure = row["protocol"] in PROTOCOLS[:2]
        assert bool(row["phases"]) == secure and (sum(row["tape_bytes"]) > 0) == secure
        assert row["messages"] == 2 * row["rounds"]
        for name in ("ahead_ms", "compile_ms"):
            assert row[name] > 0 if secure else row[name] is None


def test_the_floor_is_told_and_lower(measured):
    for row in cells_of(measured)[1]:
        assert (row["floor_ms"] is None) == (row["protocol"] == "cpp")
        if row["protocol"] in PROTOCOLS[:2]:
            assert 0 < row["floor_ms"] < row["median_ms"]


def test_bytes_and_rounds_are_the_engines(measured):
    rows = {(row["protocol"], row["score"], row["n"]): row for row in cells_of(measured)[1]}
    assert rows["malicious", "S10", 40]["rounds"] == 3 and rows["semi-honest", "S10", 40]["rounds"] == 2
    assert rows["numpy", "S2", 40]["bytes_sent"] == [8 * 40 + HEADER_BYTES] * 2
    for (protocol, score, n), row in rows.items():
        if protocol in PROTOCOLS[:2]:
            stats = run_local(SCORES[score].within(1.0), np.zeros(n), np.zeros(n), protocol).stats
            assert row["rounds"] == stats[0].rounds and row["bytes_sent"] == [one.bytes_sent for one in stats]


def test_phases_sum_to_the_median(measured):
    for row in cells_of(measured)[1]:
        if row["phases"]:
            assert sum(row["phases"].values()) == pytest.approx(row["median_ms"], rel=1e-3, abs=1e-5)
            assert row["phases"]["network"] > 0


def test_the_folder_holds_what_was_told(measured):
    folder, rows, _ = measured
    assert {path.name for path in folder.iterdir()} == {ABOUT, TRIALS, TABLE}
    trials = read_trials(folder)
    assert Counter(trial.cell.protocol for trial in trials)["malicious"] == 4 * 3
    about = read_about(folder)
    assert about.finished and about.trials == 2 and not about.quick and about.machine["cpu"]
    for cell, rows_of in groupby(trials, lambda trial: trial.cell):
        figures = {(trial.ahead_ms, trial.compile_ms) for trial in rows_of}
        assert len(figures) == 1 and ((None, None) in figures) == (cell.protocol not in PROTOCOLS[:2])
    with (folder / TABLE).open(newline="") as stream:
        assert all(
            bool(row["ahead_ms"]) == (row["protocol"] in PROTOCOLS[:2]) for row in csv.DictReader(stream)
        )
    assert about.command.startswith("python -m bench sweep --scores S10 S2")
    assert (folder / TABLE).read_text().count("\n") == 1 + 2 * len(rows)


def test_a_killed_sweep_goes_on_with_the_cells_that_are_missing(tmp_path, measured):
    words = [*WORDS, "--out", tmp_path]
    process = subprocess.Popen(
        command(*words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    file = tmp_path / TRIALS
    deadline = time.monotonic() + 60
    while not (file.exists() and file.read_bytes().count(b"\n") >= 5) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    (tmp_path / "tapes").mkdir(exist_ok=True)  # as a killed sweep may leave them
    with file.open("ab") as stream:
        stream.write(b'{"protocol": "malicious", "score": "S2", "n"')
    before = read_trials(tmp_path)
    done = sweep(*words)
    assert done.returncode == 0, done.stderr
    after = read_trials(tmp_path)
    expected, _ = cells_of(measured)
    assert before and after[: len(before)] == before
    kept = len({trial.cell for trial in before})
    assert f"{kept} of {len(expected)} cells are in" in done.stdout
    assert {(trial.n, trial.score, trial.protocol) for trial in after} == set(expected)
    assert not (tmp_path / "tapes").exists()
    again = sweep(*words)
    assert again.returncode == 0 and read_trials(tmp_path) == after, "nothing was missing"


def test_other_settings_in_the_same_folder_are_refused(measured):
    folder = measured[0]
    before = (folder / TRIALS).read_bytes()
    done = sweep(*WORDS[:-1], 3, "--out", folder)
    assert done.returncode == 1 and "trials 2 (now 3)" in done.stderr and "--out" in done.stderr
    assert "Traceback" not in done.stderr and (folder / TRIALS).read_bytes() == before


def test_without_a_compiler_the_baseline_is_left_out_with_a_sentence(tmp_path):
    words = ["--scores", "S10", "--sizes", 4, "--trials", 1, "--protocols", "numpy", "cpp", "--out", tmp_path]
    done = sweep(*words, CXX="no-such-compiler")
    assert done.returncode == 0 and "no C++ compiler" in done.stderr and "left out" in done.stderr
    assert {trial.protocol for trial in read_trials(tmp_path)} == {"numpy"}
    assert read_about(tmp_path).machine["compiler"] is None


def test_a_compiler_that_fails_is_told(tmp_path):
    compiler = tmp_path / "c++"
    compiler.write_text("#!/bin/sh\necho this is broken >&2\nexit 1\n")
    compiler.chmod(0o755)
    done = sweep("--scores", "S10", "--sizes", 4, "--protocols", "cpp", "--out", tmp_path, CXX=str(compiler))
    assert done.returncode == 1 and "this is broken" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["--trials", 0],
        ["--sizes", 0],
        ["--seed", -1],
        ["--scores", "S11"],
        ["--quick", "--sizes", 17],
        ["--protocols", "x"],
    ],
)
def test_bad_arguments_are_refused(tmp_path, words):
    done = sweep(*words, "--out", tmp_path / "none")
    assert done.returncode == 2 and "usage" in done.stderr and not (tmp_path / "none").exists()


def test_help_teaches():
    done = sweep("--help")
    assert done.returncode == 0 and "examples:" in done.stdout and "CowGear" in done.stdout
    assert ABOUT_AHEAD in done.stdout and "It is not in ms" in done.stdout
