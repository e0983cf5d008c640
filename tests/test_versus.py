"""``python -m bench versus``: this tree against another commit, with invented times and a small history."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import bench.versus
from bench.commits import HistoryError, resolve, tree_of
from bench.recorded_ratios import recorded_ratios
from bench.versus import Trees, VersusRow, compare, row_of, summary

CELL = ("S10", 16, "malicious")


def git(folder, *words):
    author = ["-c", "user.name=A", "-c", "user.email=a@b.c", "-c", "init.defaultBranch=main"]
    done = subprocess.run(
        ["git", "-C", str(folder), *author, *words], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path):
    folder = (tmp_path / "repository").resolve()
    folder.mkdir()
    git(folder, "init", "--quiet")
    for number in (1, 2):
        (folder / "file").write_text(str(number))
        git(folder, "add", "file")
        git(folder, "commit", "--quiet", "-m", str(number))
    return folder


def test_both_trees_are_measured_in_turn_and_the_order_turns():
    order = []

    def measure(tree, cell, trials):
        order.append((str(tree), trials))
        return {"base": (6.0, 4.0), "ours": (2.0, 1.0)}[str(tree)]

    trees = Trees(Path("base"), Path("ours"), 7, 3, {CELL: 0.5})
    (row,) = compare(trees, [CELL], measure, lambda done, total: None)
    assert order == [(tree, 7) for tree in ("base", "ours", "ours", "base", "base", "ours")]
    assert row == VersusRow(*CELL, [6.0] * 3, [2.0] * 3, 3.0, 4.0, 0.5, 1.5)


def test_a_speed_up_is_the_median_of_its_repetitions():
    base, ours = [(1.0, 0.5), (10.0, 0.9), (3.0, 0.8)], [(1.0, 0.6), (2.0, 0.25), (1.5, 0.4)]
    row = row_of(CELL, base, ours, None)
    assert (row.speedup, row.least_speedup) == (2.0, 2.0)
    assert (row.base_ms, row.mp_spdz_to_ours) == ([1.0, 10.0, 3.0], None)


def test_the_summary_has_geometric_means_and_the_least_cell_of_either_model():
    rows = [
        row_of(CELL, [(4.0, 3.0)], [(1.0, 1.0)], 1.0),
        row_of(("S2", 16, "malicious"), [(1.0, 1.0)], [(1.0, 1.0)], 1.5),
        row_of(("S10", 17, "semi-honest"), [(1.0, 1.0)], [(2.0, 1.0)], None),
    ]
    found = summary(rows)
    assert found["malicious"] == {
        "cells": 2,
        "speedup": 2.0,
        "least_speedup": 1.732,
        "mp_spdz_to_ours": 2.449,
        "least": "S2 at N = 16",
        "least_is": 1.5,
    }
    assert found["semi-honest"]["mp_spdz_to_ours"] is None
    assert found["semi-honest"]["least_is"] == 0.5


def test_recorded_ratios_are_of_one_commit_and_are_the_default_cells():
    recorded = recorded_ratios()
    assert recorded.of("0" * 40) == {} and recorded.of(recorded.base) == recorded.ratios
    cells = bench.versus.asked_cells(bench.versus.parser().parse_args(["HEAD"]))
    assert cells == list(recorded.ratios) and len(cells) == 36
    options = bench.versus.parser().parse_args(["HEAD", "--dim", "16", "--security", "semi-honest"])
    assert bench.versus.asked_cells(options) == [("S10", 16, "semi-honest")]


def test_a_commit_is_checked_out_aside_and_removed(repository):
    first = resolve(repository, "HEAD~1")
    with tree_of(repository, first) as tree:
        assert (tree / "file").read_text() == "1"
        assert len(git(repository, "worktree", "list").splitlines()) == 2
    assert not tree.exists() and len(git(repository, "worktree", "list").splitlines()) == 1


def test_what_is_missing_is_told_with_what_to_do(repository, tmp_path, monkeypatch):
    with pytest.raises(HistoryError, match="git log"):
        resolve(repository, "no-such-commit")
    with pytest.raises(HistoryError, match="git clone"):
        resolve(tmp_path, "HEAD")
    git(tmp_path, "clone", "--quiet", "--depth", "1", repository.as_uri(), "shallow")
    with pytest.raises(HistoryError, match="unshallow"):
        resolve(tmp_path / "shallow", git(repository, "rev-parse", "HEAD~1"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(HistoryError, match="git is not installed"):
        resolve(repository, "HEAD")


def test_an_option_is_no_commit(repository):
    with pytest.raises(HistoryError):
        resolve(repository, "--all")


def test_a_run_writes_its_rows_and_tells_them(repository, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench.versus, "own_tree", lambda: repository)
    monkeypatch.setattr(bench.versus, "check_tree", lambda tree: None)
    monkeypatch.setattr(bench.versus, "measure_tree", lambda tree, *rest: (2.0 - (tree == repository),) * 2)
    words = ["HEAD~1", "--score", "S10", "--dim", "16", "--out", str(tmp_path / "out")]
    assert bench.versus.main(words) == 0
    assert "speed-up 2.0" in capsys.readouterr().out
    written = json.loads((tmp_path / "out" / "versus.json").read_text())
    assert written["base"] == git(repository, "rev-parse", "--short=7", "HEAD~1")
    assert [row["speedup"] for row in written["rows"]] == [2.0, 2.0]
    assert bench.versus.main([*words, "--json"]) == 0
    *rows, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert rows == written["rows"] and last["summary"]["malicious"]["speedup"] == 2.0


def test_a_tree_without_a_benchmark_is_told(repository, monkeypatch, capsys):
    monkeypatch.setattr(bench.versus, "own_tree", lambda: repository)
    assert bench.versus.main(["HEAD", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"] == "MeasuringError"


def test_help_teaches():
    words = [sys.executable, "-m", "bench", "versus", "--help"]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "examples:" in text and "python -m bench versus ff69b37" in text
