"""Where the benchmarks' commands write."""

from pathlib import Path

import pytest

from bench.out import out_folder
from bench.report.cli import main as report
from bench.sweep.cli import main as sweep

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "benchmarks"


def test_a_folder_is_made_with_those_above_it_and_may_be_there(tmp_path):
    folder = tmp_path / "a" / "b"
    assert out_folder(folder) == out_folder(folder) == folder
    assert folder.is_dir()


@pytest.mark.parametrize(
    "command",
    [
        lambda out: sweep(["--scores", "S10", "--sizes", "16", "--out", out]),
        lambda out: report([str(RESULTS), "--out", out]),
    ],
    ids=["sweep", "report"],
)
@pytest.mark.parametrize("below", ["", "/below"])
def test_a_file_in_a_folders_place_is_said_in_words(tmp_path, capsys, command, below):
    (tmp_path / "file").write_text("kept")
    assert command(f"{tmp_path / 'file'}{below}") == 1
    error = capsys.readouterr().err
    assert "cannot be a folder: a file is in its place" in error and "Errno" not in error
    assert (tmp_path / "file").read_text() == "kept"
