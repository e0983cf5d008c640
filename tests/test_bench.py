"""The commands around the benchmark: recorded figures beside ours, and MP-SPDZ run live."""

import json
import os
import subprocess
import sys
import time
from importlib.resources import files

import pytest
from mp_spdz_helpers import fake_mp_spdz

from bench.mp_spdz import MpSpdzError, parse
from bench.mpc import BODIES, MARK, program_text
from bench.processes import run_together
from bench.recorded import recorded
from protocols.scores import SCORES

STATED = {"spdz", "textbook", "clear"}
"""The engines of the benchmark's rows."""


def bench(*words):
    return subprocess.run(
        [sys.executable, "-m", "bench", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def oracle(folder, *words):
    return bench("oracle", "--mp-spdz", folder, "--dim", 4, "--trials", 2, *words)


# Recorded figures


def test_compare_adds_recorded_figures_and_changes_no_field():
    words = ["--score", "S10", "--dim", 16, "--trials", 2, "--json", "--security", "malicious", "semi-honest"]
    plain, compared = (
        [json.loads(line) for line in bench(*words, *extra).stdout.splitlines()]
        for extra in ([], ["--compare"])
    )
    assert len(plain) == len(compared) == 6
    for row, beside in zip(plain, compared, strict=True):
        figures = beside.pop("recorded")
        assert list(row) == list(beside) and row["engine"] in STATED
        assert bool(figures) == (row["engine"] == "spdz")
        for figure in figures:
            assert figure["bytes_factor"] == round(figure["bytes_sent"] / row["bytes_sent"], 2)
            assert figure["ms_factor"] == pytest.approx(figure["ms"] / beside["median_ms"], abs=0.01)
    engines = {figure.engine for figure in recorded("S10", 16, "semi-honest")}
    assert engines == {"MP-SPDZ v0.4.2", "SPU SEMI2K/64 0.9.5", "SPU SEMI2K/128 0.9.5"}


def test_compare_prints_a_line_for_each_recorded_engine():
    result = bench(*"--score S10 --dim 16 17 --trials 1 --engine spdz --compare".split())
    lines = result.stdout.splitlines()
    assert len(lines) == 4, result.stdout  # a header, two of ours, and MP-SPDZ at 16
    assert "MP-SPDZ v0.4.2, mascot" in lines[2] and "x time" in lines[2] and "1008" in lines[2]


def test_nothing_is_compared_with_an_opened_bit():
    result = bench(*"--score S10 --dim 16 --trials 1 --engine spdz --compare --reveal bit --json".split())
    assert json.loads(result.stdout)["recorded"] == []


def test_the_quickest_protocol_of_each_engine_is_the_one_to_compare_with():
    data = json.loads(files("bench").joinpath("recorded.json").read_text(encoding="utf-8"))
    for row in data["rows"]:
        title = data["engines"][row["engine"]]["title"]
        figures = [f for f in recorded(row["score"], row["n"], row["security"]) if f.engine.startswith(title)]
        assert len(figures) == 1 and figures[0].ms <= row["ms"]
    # S10, N = 8192, semi-honest: "semi" took 3.27 ms and "hemi" 3.58.
    quickest = recorded("S10", 8192, "semi-honest")[0]
    assert (quickest.protocol, quickest.ms) == ("semi", 3.2654)


def test_every_recorded_figure_says_where_it_comes_from():
    data = json.loads(files("bench").joinpath("recorded.json").read_text(encoding="utf-8"))
    assert {row["engine"] for row in data["rows"]} == set(data["engines"])
    for about in data["engines"].values():
        assert all(about[field] for field in ("title", "version", "machine", "how"))
    assert len(data["rows"]) == len({json.dumps(row) for row in data["rows"]}) == 93


# MP-SPDZ


@pytest.mark.parametrize(
    ("protocol", "security", "scores"),
    [("mascot", "malicious", list(SCORES)), ("hemi", "semi-honest", ["S6", "S10"])],
)
def test_programs_compute_their_scores(tmp_path, protocol, security, scores):
    folder = fake_mp_spdz(tmp_path / "mp-spdz", protocols=(protocol,))
    result = oracle(folder, "--protocol", protocol, "--json", "--score", *scores)
    assert result.returncode == 0, result.stderr
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(row["score"], row["kind"]) for row in rows] == [
        (score, kind) for score in scores for kind in ("unit", "near", "normal", "uniform")
    ]
    for row in rows:
        assert (row["protocol"], row["security"], row["n"], row["pairs"]) == (protocol, security, 4, 2)
        assert row["theirs"] <= 0.51, row  # the stand-in rounds a float64 to the grid
        assert row["ours"] < 5 and row["apart"] <= row["ours"] + row["theirs"] + 0.001


def test_a_program_of_another_score_would_be_seen(tmp_path):
    """The stand-in runs the text that it is given: break the text, and the error is large."""
    broken = """
import runpy, sys
from pathlib import Path
source = Path("Programs/Source", sys.argv[1] + ".mpc")
source.write_text(source.read_text().replace("x - y", "x + y"))
sys.argv[0] = "real.py"
runpy.run_path("real.py", run_name="__main__")
"""
    folder = fake_mp_spdz(tmp_path / "mp-spdz")
    (folder / "compile.py").rename(folder / "real.py")
    (folder / "compile.py").write_text(broken)
    row = json.loads(oracle(folder, "--score", "S6", "--kind", "unit", "--json").stdout)
    assert row["theirs"] > 1000 and row["ours"] < 1


def test_the_table_names_both_engines(tmp_path):
    result = oracle(fake_mp_spdz(tmp_path / "mp-spdz"), "--score", "S10", "--kind", "unit")
    assert result.returncode == 0, result.stderr
    header, row = result.stdout.splitlines()
    assert "ours" in header and "MP-SPDZ" in header and row.split()[:4] == ["S10", "4", "unit", "mascot"]


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: folder / "elsewhere", "not a folder"),
        (lambda folder: (folder / "compile.py").unlink(), "no compile.py"),
        (lambda folder: (folder / "mascot-party.x").unlink(), "no mascot-party.x"),
    ],
)
def test_what_is_missing_is_told_with_how_to_get_it(tmp_path, spoil, says):
    folder = fake_mp_spdz(tmp_path / "mp-spdz")
    result = oracle(spoil(folder) or folder)
    assert result.returncode == 2 and not result.stdout
    assert says in result.stderr and "git clone" in result.stderr and "v0.4.2" in result.stderr
    assert "make -j2 mascot-party.x" in result.stderr and "Traceback" not in result.stderr


def test_a_machine_that_may_not_run_is_told(tmp_path):
    folder = fake_mp_spdz(tmp_path / "mp-spdz")
    (folder / "mascot-party.x").chmod(0o644)
    result = oracle(folder)
    assert result.returncode == 2 and "not executable" in result.stderr


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"compiler": "raise SystemExit('CompilerError: no such type')"}, "compiling spdz_S10 failed"),
        ({"compiler": "raise SystemExit('CompilerError: no such type')"}, "CompilerError: no such type"),
        ({"machine": "#!/bin/sh\necho program needs a longer prime >&2\nexit 3\n"}, "exit status 3"),
        ({"machine": "#!/bin/sh\necho program needs a longer prime >&2\nexit 3\n"}, "needs a longer prime"),
        ({"machine": "#!/bin/sh\nexit 0\n"}, "expected 2 scores in MP-SPDZ's output, got 0"),
        ({"machine": f"#!/bin/sh\necho {MARK} 0 nan\n"}, "cannot read this line"),
        ({"machine": "#!/no/such/interpreter\n"}, "running spdz_S10-4-2"),
    ],
)
def test_a_failure_of_mp_spdz_is_told_with_its_last_words(tmp_path, parts, says):
    result = oracle(fake_mp_spdz(tmp_path / "mp-spdz", **parts), "--score", "S10", "--kind", "unit")
    assert result.returncode == 1 and says in result.stderr and "Traceback" not in result.stderr


def test_a_machine_that_hangs_is_ended(tmp_path):
    folder = fake_mp_spdz(tmp_path / "mp-spdz", machine="#!/bin/sh\nsleep 61.25 & wait\n")
    result = oracle(folder, "--score", "S10", "--kind", "unit", "--timeout", "0.5")
    assert result.returncode == 1 and "more than 0.5 s" in result.stderr and "--timeout" in result.stderr


@pytest.mark.parametrize("words", [["--timeout", 0], ["--trials", 0], ["--dim", 0], ["--protocol", "yao"]])
def test_the_oracle_refuses_bad_arguments(tmp_path, words):
    result = oracle(tmp_path, *words)
    assert result.returncode == 2 and "usage" in result.stderr


def test_programs_state_their_precision_and_bring_their_own_score():
    assert len({program_text(name) for name in BODIES}) == len(BODIES) == 10
    for name in BODIES:
        text = program_text(name)
        assert "sfix.set_precision(16, 64)" in text and text.startswith(f"# {name}: ")
        compile(text, name, "exec")


def test_output_is_read_to_the_last_bit():
    lines = [f"{MARK} 0 -1.2492218017578125", "noise", f"{MARK} 1 1.52587890625e-05", f"{MARK} 2 -0"]
    assert parse("\n".join(lines), 3) == [-81869, 1, 0]


@pytest.mark.parametrize(
    "output",
    [
        f"{MARK} 0",
        f"{MARK} 0 0.1",  # not on the grid
        f"{MARK} 1 0.5",  # out of order
        f"{MARK} 0 0.5 0.5",
        f"{MARK} x 0.5",
        f"{MARK} 0 infinity",
        f"{MARK} 0 0.5\n{MARK} 1 0.5",  # one too many
        "",
    ],
)
def test_output_that_is_not_as_it_should_be_is_refused(output):
    with pytest.raises(MpSpdzError):
        parse(output, 1)


# Processes


def has_writer(reader):
    """Whether a process still holds the other end of a pipe."""
    try:
        return os.read(reader, 1) != b""
    except BlockingIOError:
        return True


def test_processes_share_a_limit_and_leave_nothing_behind(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    sleeper = ["sh", "-c", "sleep 20 > pipe & echo said; wait"]
    finished = run_together([sleeper, ["true"]], tmp_path, {}, 1.0)
    assert finished.statuses == [None, 0] and finished.outputs == ["said\n", ""] and not finished.worked
    for _ in range(50):  # a killed process takes a moment to go
        if not has_writer(reader):
            break
        time.sleep(0.1)
    assert not has_writer(reader)
    os.close(reader)


def test_a_process_that_fails_ends_the_others(tmp_path):
    commands = [["sleep", "20"], ["sh", "-c", "echo $WORD; exit 4"]]
    finished = run_together(commands, tmp_path, {"WORD": "hi"}, 60)
    assert finished.statuses == [None, 4] and finished.outputs[1] == "hi\n"


def test_a_long_output_stalls_nobody(tmp_path):
    words = [sys.executable, "-c", "print('x' * 1000000)"]
    assert [len(text) for text in run_together([words, words], tmp_path, {}, 30).outputs] == [1000001] * 2


@pytest.mark.parametrize("words", [["accuracy"], ["oracle"]])
def test_help_teaches(words):
    result = bench(*words, "--help")
    assert (
        result.returncode == 0
        and "examples:" in result.stdout
        and f"python -m bench {words[0]}" in result.stdout
    )


def test_the_help_of_the_benchmark_names_the_other_commands():
    text = bench("--help").stdout
    assert "python -m bench accuracy" in text and "python -m bench oracle" in text
