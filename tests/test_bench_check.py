"""The guard of ratios, with invented measurements: red when something is worse, and only then."""

import json
import subprocess
import sys

import pytest

from bench.check import cli, ratios
from bench.check.measuring import BLOCKS, CELLS, keys_of, measure, trials_of
from bench.check.ratios import TOLERANCE, Key, RatiosError, judge

S10 = ("S10", 16, "malicious")
FLOOR, TEXTBOOK = Key(*S10, "floor"), Key(*S10, "textbook")


def invented(*runs):
    """A measurement that gives each run's ratio for every key of the asked-for cells, or what a dict says."""
    left = iter(runs)

    def measuring(cells, blocks, on_cell):
        answer = next(left)
        keys = [key for cell in cells for key in keys_of(cell)]
        return {key: answer.get(key, 10.0) if isinstance(answer, dict) else answer for key in keys}

    return measuring


@pytest.fixture
def committed(tmp_path, monkeypatch):
    """A file in which every ratio is 10."""
    monkeypatch.setattr(ratios, "FILE", tmp_path / "ratios.json")
    ratios.write({key: 10.0 for cell in CELLS for key in keys_of(cell)}, {"command": "invented"})
    return tmp_path / "ratios.json"


def test_a_ratio_may_be_as_large_as_the_tolerance_says_and_no_larger():
    words = {
        measured: judge({FLOOR: measured}, {FLOOR: 10.0}, 1.6)[0].word
        for measured in (1.0, 6.2, 6.3, 10.0, 15.9, 16.1, 99.0)
    }
    assert list(words.values()) == ["better", "better", "ok", "ok", "ok", "WORSE", "WORSE"]
    assert judge({FLOOR: 99.0}, {}, 1.6)[0].word == "new"


def test_what_is_as_quick_as_committed_passes(committed, capsys):
    assert cli.main([], invented(10.0 * TOLERANCE * 0.99)) == 0
    out = capsys.readouterr()
    assert "WORSE" not in out.out and out.err == ""


@pytest.mark.parametrize("key", [FLOOR, TEXTBOOK], ids=lambda key: key.against)
def test_what_is_worse_each_time_fails_and_says_what_to_do(committed, capsys, key):
    assert cli.main([], invented({key: 17.0}, {key: 18.0}, {key: 17.5})) == 1
    out = capsys.readouterr()
    assert out.out.count("WORSE") == 1 and "17.00" in out.out
    assert "python -m bench versus COMMIT --score S10 --dim 16 --security malicious" in out.err
    assert "--update" in out.err and "cores" in out.err


def test_what_is_worse_once_is_measured_again_alone(committed):
    asked = []
    measuring = invented({FLOOR: 17.0}, 10.0)

    def noting(cells, blocks, on_cell):
        asked.append((list(cells), blocks))
        return measuring(cells, blocks, on_cell)

    assert cli.main([], noting) == 0
    assert asked == [(list(CELLS), BLOCKS), ([S10], BLOCKS)]


def test_a_second_measurement_does_not_make_another_ratio_of_the_cell_worse(committed):
    assert cli.main([], invented({FLOOR: 17.0}, {TEXTBOOK: 17.0})) == 0


def test_a_gain_passes_and_is_told_to_be_committed(committed, capsys):
    assert cli.main([], invented({FLOOR: 1.0})) == 0
    assert "--update" in capsys.readouterr().err


def test_update_writes_what_is_measured_and_a_check_then_passes(committed, capsys):
    assert cli.main(["--update"], invented(25.0)) == 0
    assert set(ratios.read().values()) == {25.0}
    assert json.loads(committed.read_text())["machine"]["cores"] >= 1
    assert cli.main([], invented(25.0)) == 0
    assert cli.main(["--update", "--score", "S1"], invented(3.0)) == 0
    kept = ratios.read()
    assert {key.score for key, ratio in kept.items() if ratio == 3.0} == {"S1"} and kept[FLOOR] == 25.0


def test_without_committed_ratios_there_is_nothing_to_hold_to(committed, capsys):
    committed.unlink()
    assert cli.main(["--json"], invented()) == 2
    said = json.loads(capsys.readouterr().out)
    assert said["error"] == "RatiosError" and "--update" in said["message"]
    assert cli.main(["--update"], invented(2.0)) == 0 and ratios.read()[FLOOR] == 2.0


@pytest.mark.parametrize("text", ["", "[]", '{"format": 2}', '{"format": 1, "ratios": [{"score": "S1"}]}'])
def test_a_broken_file_is_told(committed, text):
    committed.write_text(text)
    with pytest.raises(RatiosError, match="--update"):
        ratios.read()


def test_json_has_a_line_for_each_ratio(committed, capsys):
    assert cli.main(["--score", "S10", "--json"], invented(*[{FLOOR: 17.0}] * 3)) == 1
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(rows) == 2 * 2 * 3  # two models, floor and textbook, three lengths
    assert [row["against"] for row in rows if row["verdict"] == "worse"] == ["floor"]
    assert set(rows[0]) == {
        "score",
        "n",
        "security",
        "against",
        "ratio",
        "committed",
        "tolerance",
        "verdict",
    }


def test_a_tolerance_of_one_is_refused():
    with pytest.raises(SystemExit):
        cli.main(["--tolerance", "1"], invented())


def test_the_committed_file_has_every_ratio_that_is_measured():
    assert set(ratios.read()) == {key for cell in CELLS for key in keys_of(cell)}


def test_a_true_measurement_has_every_ratio_of_its_cells(monkeypatch):
    monkeypatch.setattr("bench.check.measuring._MOST_TRIALS", 2)
    monkeypatch.setattr("bench.check.measuring._FEWEST_TRIALS", 2)
    assert trials_of(16) == 2
    seen = []
    found = measure([S10], 2, seen.append)
    assert list(found) == [FLOOR, TEXTBOOK] and seen == [S10, S10]
    assert found[FLOOR] > 1  # computing something takes longer than computing nothing


def test_help_teaches():
    words = [sys.executable, "-m", "bench", "check", "--help"]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "examples:" in text and "bench check --update" in text
