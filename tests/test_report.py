"""The report's tables: their numbers are those of the folder, of the paper, and of what was recorded."""

import json
import re
import statistics
import sys

import pytest
from report_helpers import QUICK, WHOLE, ahead_ms, lines, ms, versus, write, write_lines

import bench.cli
from bench.recorded import recorded
from bench.recorded_ratios import recorded_ratios
from bench.recorded_table import recorded_table
from bench.report import cli, floor, gallery, paper, phases, ratios
from bench.report.cells import MODELS
from bench.report.folder import read_results
from bench.report.sections import mean_factors, sections
from bench.report.table import NOTHING, amount, milliseconds, times
from bench.sweep.ahead import ABOUT

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return read_results(write(tmp_path_factory.mktemp("quick")))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return read_results(write(tmp_path_factory.mktemp("whole"), WHOLE, more=True))


def rows_of(table, *first):
    return [row for row in table.rows if tuple(row[: len(first)]) == first]


def all_words(results):
    return " ".join(word for part in sections(results) for word in part.words)


# The paper's table


def test_ours_stand_beside_the_papers_figures_and_what_was_recorded(whole):
    table = next(paper.tables(whole))
    ours, printed, theirs = rows_of(table, "1536", "S10")
    three = [ms("malicious", "S10", 1536, number) for number in range(3)]
    assert ours[3:8] == (
        "ours",
        milliseconds(statistics.fmean(three)),
        milliseconds(statistics.stdev(three)),
        amount((8 * 1536 + 83) / 1e6),
        "6",
    )
    bare = [1e3 * ms("cpp", "S10", 1536, number) for number in range(3)]
    assert ours[12:] == (
        milliseconds(statistics.fmean(bare)),
        milliseconds(statistics.stdev(bare)),
        "12.288",
        "2",
    )
    assert printed[3:] == ("paper", "2.70", "0.11", "0.075", "29", "1.16", "0.17", "0.050", "14",
                           "9.13", "1.83", "12.288", "2")  # fmt: skip
    found = recorded("S10", 1536, "malicious")[0]
    assert theirs[3:8] == ("MP-SPDZ", milliseconds(found.ms), NOTHING, "0.074", f"({found.rounds})")


def test_every_row_that_the_paper_prints_is_there_in_its_order(quick):
    table = next(paper.tables(quick))
    printed = [(row[0], row[1], row[2]) for row in table.rows if row[3] == "paper"]
    assert printed == [(str(row.n), row.score, row.name) for row in recorded_table().printed]
    assert len(printed) == 24
    assert all(len(row) == len(table.head) for row in table.rows)
    assert sum(span for _, span in table.groups) == len(table.head)


def test_what_was_not_run_is_no_number(quick):
    table = next(paper.tables(quick))
    (ours,) = [row for row in rows_of(table, "8192", "S10") if row[3] == "ours"]
    assert set(ours[4:]) == {NOTHING}
    assert "316 of 360 cells were not run" in all_words(quick)


def test_all_cells_that_were_run_are_listed_and_no_others(quick, whole):
    for results, lengths in ((quick, QUICK), (whole, WHOLE)):
        _, everything = paper.tables(results)
        listed = [tuple(row[:2]) for row in everything.rows]
        assert listed == [(str(n), score) for n, scores in lengths.items() for score in scores]


def test_the_printed_bytes_are_those_of_one_party():
    """What the notes say of the paper's MB: S10's are what one party was recorded to send."""
    for row in recorded_table().printed:
        for model in MODELS if row.score in ("S2", "S6", "S10") else ():
            for one in recorded(row.score, row.n, model)[:1]:
                assert row.of(model).comms == pytest.approx(one.bytes_sent / 1e6, rel=0.02, abs=0.0011)


# Ratios


def test_ratios_are_theirs_by_ours(whole):
    one = next(
        one for one in ratios.besides(whole, "malicious") if (one.cell.score, one.cell.n) == ("S4", 1536)
    )
    found = recorded("S4", 1536, "malicious")[0]
    median = ms("malicious", "S4", 1536, 1)
    assert one.ms == pytest.approx(found.ms / median)
    assert one.with_ahead == pytest.approx(found.ms / (median + ahead_ms("malicious", 1536)))
    assert one.sent == found.bytes_sent / (8 * 1536 + 82)
    assert one.rounds == found.rounds / 3
    mean = statistics.fmean(ms("malicious", "S4", 1536, number) for number in range(3))
    assert one.printed_ms == pytest.approx(27.52 / mean)


def test_the_last_row_has_geometric_means(whole):
    for model in MODELS:
        (table,) = [one for one in ratios.tables(whole) if one.title.endswith(f", {model}")]
        found = [one.ms for one in ratios.besides(whole, model) if one.ms is not None]
        assert table.rows[-1][7] == times(statistics.geometric_mean(found))
        assert mean_factors(whole, model)["time"] == pytest.approx(statistics.geometric_mean(found))
        strict = [one.with_ahead for one in ratios.besides(whole, model) if one.with_ahead is not None]
        assert len(strict) == len(found) and table.rows[-1][8] == times(statistics.geometric_mean(strict))
        mean = mean_factors(whole, model)
        assert mean["time_with_ahead"] == pytest.approx(statistics.geometric_mean(strict))
        assert mean["time_with_ahead"] < mean["time"]


def test_without_what_is_done_ahead_there_is_no_stricter_ratio(tmp_path):
    write(tmp_path)
    write_lines(tmp_path / "trials.jsonl", [row | {"ahead_ms": None} for row in lines(QUICK)])
    results = read_results(tmp_path)
    for model in MODELS:
        means = mean_factors(results, model)
        assert means["time_with_ahead"] is None and means["time"]
    (table,) = floor.tables(results)
    assert {row[table.head.index("ahead ms")] for row in table.rows[:-1]} == {NOTHING}


def test_the_product_is_of_cells_that_both_runs_have(whole):
    found = {(one.row.score, one.row.n): one.ratio for one in ratios.products(whole, "malicious")}
    before = recorded_ratios().ratios
    assert found == {
        ("S10", 16): 2.0 * before["S10", 16, "malicious"],
        ("S4", 1536): 3.0 * before["S4", 1536, "malicious"],
    }
    assert ratios.products(whole, "semi-honest") == []
    assert f"smallest product is {times(min(found.values()))}, of S10 at N = 16, malicious" in all_words(
        whole
    )
    assert "versus.json lacks them: malicious: S1 S2" in all_words(whole)


def test_a_product_with_another_commit_is_not_made(tmp_path):
    write(tmp_path, more=True)
    (tmp_path / "versus.json").write_text(json.dumps(versus("1234567")), encoding="utf-8")
    results = read_results(tmp_path)
    assert all(ratios.products(results, model) == [] for model in MODELS)
    assert "compares with 1234567" in all_words(results)


@pytest.mark.parametrize(("commit", "told"), [("abc1234" + "0" * 33, False), ("9999999", True), (None, True)])
def test_a_product_of_another_tree_than_the_sweeps_is_told(tmp_path, commit, told):
    write(tmp_path, more=True)
    (tmp_path / "versus.json").write_text(json.dumps(versus() | {"commit": commit}), encoding="utf-8")
    assert (", the sweep of abc1234." in all_words(read_results(tmp_path))) is told


def test_without_versus_the_command_is_named(quick):
    assert "python -m bench versus ff69b37" in all_words(quick)


# Floor, phases, galleries


def test_every_time_stands_above_its_floor(whole):
    (table,) = floor.tables(whole)
    (row,) = rows_of(table, "256", "S10")
    clear, ours, theirs = (ms(kind, "S10", 256, 1) for kind in ("numpy", "malicious", "semi-honest"))
    assert row[2] == milliseconds(clear)
    for at, time, model in ((3, ours, "malicious"), (8, theirs, "semi-honest")):
        assert row[at : at + 4] == (milliseconds(time), "0.050", times(time / 0.05), times(time / clear))
        assert row[at + 4] == milliseconds(ahead_ms(model, 256)) and table.head[at + 4] == "ahead ms"
    assert len(table.rows) == 90 + 1
    assert all(len(one) == len(table.head) == sum(span for _, span in table.groups) for one in table.rows)


def test_what_is_done_ahead_is_named(whole):
    words = all_words(whole)
    assert " ".join(ABOUT.split()) in words and "7.500 ms" in words
    notes = [note for one in ratios.tables(whole) for note in one.notes]
    assert f"x with ahead: {ratios.STRICTER}" in notes and "stricter" in ratios.STRICTER


def test_phases_are_those_of_the_profiled_trial(whole):
    table = next(phases.tables(whole))
    (row,) = rows_of(table, "1536", "S2")
    (profiled,) = [
        one for one in lines({1536: ("S2",)}) if one["trial"] == -1 and one["protocol"] == "malicious"
    ]
    figures = list(profiled["phases"].values())
    assert list(row[2:]) == [milliseconds(one) for one in (sum(figures), *figures)]


def test_galleries_stand_beside_engines_of_their_own_model(whole, quick):
    (table,) = gallery.tables(whole)
    ours = rows_of(table, "ours, gallery, 2^-16")
    assert [row[1] for row in ours] == list(MODELS)
    assert ours[0][4:7] == ("2.00", "500,000", "16")
    (mascot,) = rows_of(table, "MP-SPDZ v0.4.2, mascot")
    assert mascot[1:] == ("malicious", "1536", "24 x 24", "1,315.00", "760", "53,050", "658", "3,316")
    assert list(gallery.tables(quick)) == []
    assert "python -m bench gallery" in all_words(quick)


# Numbers in words


@pytest.mark.parametrize(
    ("write_as", "value", "text"),
    [
        (milliseconds, 0.19, "0.190"),
        (milliseconds, 42.123, "42.12"),
        (milliseconds, 1043.92, "1,043.9"),
        (milliseconds, None, NOTHING),
        (amount, 0.000192, "0.00019"),
        (amount, 0.0, "0.000"),
        (amount, 31.85, "31.850"),
        (times, 0.876, "0.88"),
        (times, 12.34, "12.3"),
        (times, 6134.2, "6,134"),
    ],
)
def test_numbers_are_written_so(write_as, value, text):
    assert write_as(value) == text


# The command


def test_the_command_writes_three_files_and_says_where(tmp_path, capsys):
    write(tmp_path / "in", more=True)
    assert bench.cli.main(["report", str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["cells"], told["missing"]) == (44, 316)
    assert told["geometric_means"]["malicious"]["one_machine_smallest"] == 2.0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"report.html", "report.md", "report.png"}
    assert (tmp_path / "out" / "report.png").read_bytes()[:4] == b"\x89PNG"
    words = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "python -m bench sweep --quick" in words and not re.search(r"\bnan\b|\bNone\b|\binf\b", words)


@pytest.mark.parametrize("as_json", [False, True])
def test_a_damaged_folder_is_one_line_and_status_2(tmp_path, capsys, as_json):
    (write(tmp_path) / "trials.jsonl").write_text("{\n", encoding="utf-8")
    assert cli.main([str(tmp_path), *(["--json"] if as_json else [])]) == 2
    said = capsys.readouterr()
    text = json.loads(said.out)["message"] if as_json else said.err
    assert "trials.jsonl, line 1" in text and text.strip().count("\n") == 0
    assert not (tmp_path / "report.html").exists()


def test_without_matplotlib_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    for name in list(sys.modules):
        if name.startswith(("matplotlib", "bench.report.p", "bench.report.sections")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main([str(write(tmp_path))]) == 1
    assert "pip install" in capsys.readouterr().err


@pytest.mark.parametrize("protocol", ["malicious", "semi-honest", "numpy", "cpp"])
def test_a_sweep_of_one_protocol_and_one_cell_has_a_report(tmp_path, protocol):
    write(tmp_path)
    rows = [row for row in lines({512: ("S3",)}) if row["protocol"] == protocol]
    write_lines(tmp_path / "trials.jsonl", rows)
    assert cli.main([str(tmp_path)]) == 0
