"""Reading a results folder: what is there is read as it is, what is damaged is refused with file and line."""

import json

import pytest
from report_helpers import QUICK, ms, refusal, sent, trial, versus, write, write_lines

from bench.report.folder import read_results
from bench.report.gaps import cell_words, gap_words
from bench.sweep.cells import PROTOCOLS, SIZES
from protocols.scores import SCORES


def test_a_cell_has_the_figures_of_its_trials(tmp_path):
    cell = read_results(write(tmp_path)).cell("malicious", "S10", 1536)
    times = [ms("malicious", "S10", 1536, number) for number in range(3)]
    assert cell.mean_ms == pytest.approx(sum(times) / 3) and cell.median_ms == times[1]
    spread = sum((time - sum(times) / 3) ** 2 for time in times) / 2
    assert cell.std_ms == pytest.approx(spread**0.5)
    assert cell.bytes_party == max(sent("malicious", "S10", 1536))
    assert (cell.rounds, cell.messages, cell.tape_bytes) == (3, 6, 16 * 1536 + 16)
    assert cell.floor_ms == 0.05 and cell.error == 1e-5


def test_the_profiled_trial_counts_for_no_time(tmp_path):
    cell = read_results(write(tmp_path)).cell("semi-honest", "S1", 16)
    assert len(cell.trials) == 3 and cell.profiled is not None and cell.profiled.phases is not None
    assert cell.profiled.ms not in [trial.ms for trial in cell.trials]


def test_a_single_trial_has_no_deviation(tmp_path):
    write(tmp_path)
    write_lines(tmp_path / "trials.jsonl", [trial("numpy", "S10", 16, 0)])
    found = read_results(tmp_path)
    assert found.cell("numpy", "S10", 16).std_ms is None
    assert found.short() == [("numpy", "S10", 16)]


def test_what_was_not_run_is_missing_and_nothing_else(tmp_path):
    found = read_results(write(tmp_path))
    missing = set(found.missing())
    ran = {(p, s, n) for n, scores in QUICK.items() for s in scores for p in PROTOCOLS}
    assert ran == set(found.cells)
    assert missing == {(p, s, n) for p in PROTOCOLS for s in SCORES for n in SIZES} - ran


def test_cells_in_words_are_grouped():
    everything = [("cpp", score, n) for score in SCORES for n in SIZES]
    assert cell_words(everything) == "cpp: all scores at all N"
    some = [(p, s, n) for p in ("malicious", "semi-honest") for s in ("S10", "S2") for n in (512, 256)]
    assert cell_words([*some, ("numpy", "S1", 16)]) == (
        "malicious, semi-honest: S2 S10 at N = 256 512; numpy: S1 at N = 16"
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ms": float("nan")}, "ms is nan"),
        ({"ms": 0}, "ms is 0"),
        ({"ms": -1.0}, "ms is -1.0"),
        ({"ms": "fast"}, "ms is 'fast'"),
        ({"ms": None}, "ms is None"),
        ({"ms": True}, "ms is True"),
        ({"bytes_sent": []}, "is empty"),
        ({"bytes_sent": [1.5, 2]}, "bytes_sent is 1.5"),
        ({"rounds": -3}, "rounds is -3"),
        ({"trial": None}, "trial is None"),
        ({"protocol": "mascot"}, "no cell mascot"),
        ({"score": "S11"}, "no cell malicious S11"),
        ({"n": 0}, "no cell malicious S10 0"),
        ({"ahead_ms": -1}, "ahead_ms is -1"),
        ({"compile_ms": "long"}, "compile_ms is 'long'"),
        ({"phases": {"mask": 1}}, "has no 'network'"),
    ],
)
def test_a_damaged_line_is_named(tmp_path, change, words):
    write(tmp_path)
    rows = [trial("malicious", "S10", 16, number) for number in range(3)]
    write_lines(tmp_path / "trials.jsonl", [*rows[:2], rows[2] | change])
    said = refusal(tmp_path)
    assert words in said and "trials.jsonl, line 3" in said


@pytest.mark.parametrize("key", ["protocol", "score", "n", "trial", "ms", "bytes_sent", "ahead_ms"])
def test_a_line_without_a_field_is_named(tmp_path, key):
    write(tmp_path)
    row = trial("malicious", "S10", 16, 0)
    del row[key]
    write_lines(tmp_path / "trials.jsonl", [row])
    assert "line 1" in refusal(tmp_path)


def test_half_a_line_at_the_end_does_not_count_and_its_cell_is_told(tmp_path):
    path = write(tmp_path) / "trials.jsonl"
    path.write_text(path.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    results = read_results(tmp_path)
    assert results.short() == [("cpp", "S10", 1536)]
    assert "With fewer than 3 trials: cpp: S10 at N = 1536" in " ".join(gap_words(results))


def test_a_trial_that_stands_there_twice_is_refused(tmp_path):
    write(tmp_path)
    write_lines(tmp_path / "trials.jsonl", [trial("cpp", "S10", 16, 1)] * 2)
    assert "trial 1 of cpp S10 16 stands there twice" in refusal(tmp_path)


def test_a_folder_without_results_says_how_to_get_some(tmp_path):
    assert "python -m bench sweep --quick" in refusal(tmp_path / "nowhere")
    write(tmp_path)
    (tmp_path / "trials.jsonl").write_text("", encoding="utf-8")
    assert "no trials" in refusal(tmp_path)
    (tmp_path / "trials.jsonl").unlink()
    assert "trials.jsonl is missing" in refusal(tmp_path)


@pytest.mark.parametrize("name", ["sweep.json", "versus.json"])
@pytest.mark.parametrize("text", ["", "[]", "{", '{"format": 2}', '{"format": 1}'])
def test_damaged_objects_are_named(tmp_path, name, text):
    (write(tmp_path, more=True) / name).write_text(text, encoding="utf-8")
    assert name in refusal(tmp_path)


@pytest.mark.parametrize("change", [{"pairs_per_s": 0}, {"security": "covert"}, {"n": 1.5}])
def test_a_damaged_gallery_is_named(tmp_path, change):
    row = {"n": 1536, "rows": 2, "columns": 2, "security": "malicious", "pairs_per_s": 1.0}
    row |= {"bytes_per_pair": 1.0, "tape_bytes_per_pair": 1.0}
    write(tmp_path)
    write_lines(tmp_path / "gallery.jsonl", [row])
    assert len(read_results(tmp_path).galleries) == 1
    write_lines(tmp_path / "gallery.jsonl", [row, row | change])
    assert "gallery.jsonl, line 2" in refusal(tmp_path)


def test_a_line_of_something_else_is_no_gallery(tmp_path):
    write(tmp_path)
    others = [{"n": 5, "security": "malicious", "stored": 9}, {"n": 5, "security": "malicious", "rate": 2.0}]
    write_lines(tmp_path / "gallery.jsonl", others)
    assert len(read_results(tmp_path).galleries) == 2
    write_lines(tmp_path / "gallery.jsonl", [*others, {"n": 5, "security": "malicious", "ms": 0.1}])
    assert "gallery.jsonl, line 3: `python -m bench gallery --json` prints no such line" in refusal(tmp_path)


def test_a_damaged_row_of_versus_is_named(tmp_path):
    write(tmp_path, more=True)
    data = versus()
    del data["rows"][1]["speedup"]
    (tmp_path / "versus.json").write_text(json.dumps(data), encoding="utf-8")
    assert "versus.json: has no 'speedup'" in refusal(tmp_path)
