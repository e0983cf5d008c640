"""The folder that a sweep writes: what is complete, what is dropped, and what is refused."""

import csv
import dataclasses
import io
import json

import pytest

from bench.sweep.cells import Cell
from bench.sweep.results import (
    ABOUT,
    PROFILED,
    TABLE,
    TRIALS,
    About,
    Results,
    ResultsError,
    Trial,
    complete,
    read_about,
    read_trials,
    table,
)

COUNT = 2


def about(**changes):
    machine = {"cpu": "a", "cores": 2, "compiler": "g++ 1"}
    base = About("cmd", "abc", False, "then", None, machine, False, COUNT, 3, 1, "digest", "note")
    return dataclasses.replace(base, **changes)


def trials(protocol="malicious", score="S10", n=16, ms=1.0):
    first = Trial(protocol, score, n, 0, ms, [64, 72], 3, 6, [5, 6], 1e-5, 0.1, 0.25, 9.0)
    profiled = [first.but(trial=PROFILED, error=None, phases={"rest": ms})]
    return [*(first.but(trial=k, ms=ms + k) for k in range(COUNT)), *profiled * (protocol == "malicious")]


LINE = json.dumps(Trial("numpy", "S10", 16, 0, 1.0, [1, 1], 1, 2, [0, 0], 0.0, 0.1).as_dict()) + "\n"


def fill(folder, *cells):
    with Results(folder, about()) as results:
        for cell in cells:
            results.add(cell)
        results.finish("now")


def test_what_is_written_is_what_is_read(tmp_path):
    cells = trials(), trials("numpy"), trials("malicious", "S2", 256)
    fill(tmp_path, *cells)
    assert read_trials(tmp_path) == [trial for cell in cells for trial in cell]
    assert read_about(tmp_path) == about(finished="now")
    rows = [json.loads(line) for line in (tmp_path / TRIALS).read_text().splitlines()]
    assert [row["profiled"] for row in rows[:3]] == [False, False, True]
    assert rows[0]["bytes_sent"] == [64, 72] and rows[0]["phases"] is None and rows[2]["phases"]


def test_the_table_has_a_line_a_measured_trial(tmp_path):
    fill(tmp_path, trials(), trials("cpp"))
    rows = list(csv.DictReader(io.StringIO((tmp_path / TABLE).read_text())))
    assert [(row["protocol"], row["trial"]) for row in rows] == [
        ("malicious", "0"),
        ("malicious", "1"),
        ("cpp", "0"),
        ("cpp", "1"),
    ]
    assert rows[0]["bytes_sent_1"] == "72" and rows[0]["tape_bytes_0"] == "5" and "phases" not in rows[0]
    assert rows[0]["ahead_ms"] == "0.25" and rows[0]["compile_ms"] == "9.0"
    assert table([]).count("\n") == 1


@pytest.mark.parametrize("cut", range(0, 900, 7))
def test_a_folder_cut_at_any_byte_goes_on_after_its_last_complete_cell(tmp_path, cut):
    cells = trials(), trials("numpy"), trials("malicious", "S2")
    fill(tmp_path, *cells)
    data = (tmp_path / TRIALS).read_bytes()
    (tmp_path / TRIALS).write_bytes(data[: len(data) - cut])
    with Results(tmp_path, about()) as results:
        kept = list(results.done)
        for cell in cells:
            if cell[0].cell not in results.done:
                results.add(cell)
    assert kept == [cell[0].cell for cell in cells][: len(kept)] and (cut == 0) == (len(kept) == 3)
    assert (tmp_path / TRIALS).read_bytes() == data


def test_a_cell_without_all_its_trials_is_not_complete():
    whole = trials()
    assert list(complete(whole, COUNT)) == [Cell(16, "S10", "malicious")]
    for rows in (whole[:2], whole[1:], [*whole, whole[0]], [whole[0], whole[2], whole[1]]):
        assert complete(rows, COUNT) == {}
    assert list(complete(trials("numpy"), COUNT)) == [Cell(16, "S10", "numpy")]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"trials": 3}, "trials 2 (now 3)"),
        ({"quick": True}, "quick False (now True)"),
        ({"seed": 2}, "seed 1 (now 2)"),
        ({"source": "other"}, "source digest (now other)"),
        ({"machine": {"cpu": "b", "cores": 2, "compiler": None}}, "cpu a (now b)"),
    ],
)
def test_other_settings_are_refused_and_nothing_is_lost(tmp_path, changes, says):
    fill(tmp_path, trials())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ResultsError) as caught:
        Results(tmp_path, about(**changes))
    assert says in str(caught.value) and "--out" in str(caught.value)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_same_settings_go_on_whatever_the_compiler_and_the_commit(tmp_path):
    fill(tmp_path, trials())
    later = about(machine={"cpu": "a", "cores": 2, "compiler": None}, commit="def", started="later")
    with Results(tmp_path, later) as results:
        assert list(results.done) == [Cell(16, "S10", "malicious")]
    assert read_about(tmp_path).started == "then" and read_about(tmp_path).finished == "now"


def test_what_is_measured_later_is_noted_with_its_command(tmp_path):
    fill(tmp_path, trials())
    with Results(tmp_path, about(command="more", started="later")) as results:
        assert read_about(tmp_path).finished == "now"  # nothing was measured yet
        results.add([one.but(score="S6") for one in trials()])
        assert read_about(tmp_path).finished is None
        results.finish("then again")
    noted = read_about(tmp_path)
    assert (noted.command, noted.started, noted.finished) == ("cmd; more", "then", "then again")


def test_two_sweeps_do_not_write_to_one_folder(tmp_path):
    with Results(tmp_path, about()), pytest.raises(ResultsError, match="another sweep"):
        Results(tmp_path, about())
    Results(tmp_path, about()).close()


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        (TRIALS, "no json\n", "no trial"),
        (TRIALS, '{"protocol": "malicious"}\n', "no trial"),
        (TRIALS, LINE.replace('"ahead_ms": null, ', ""), "no trial.*ahead_ms"),
        (ABOUT, "{", "not about a sweep"),
        (ABOUT, '{"format": 2}', "format 2, expected 1"),
    ],
)
def test_a_damaged_folder_is_refused(tmp_path, name, text, says):
    fill(tmp_path, trials())
    (tmp_path / name).write_text(text)
    with pytest.raises(ResultsError, match=says):
        Results(tmp_path, about())


def test_trials_that_nothing_is_known_about_are_refused(tmp_path):
    fill(tmp_path, trials())
    (tmp_path / ABOUT).unlink()
    with pytest.raises(ResultsError, match=ABOUT):
        Results(tmp_path, about())
