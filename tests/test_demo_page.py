"""The whole demo, once: its numbers, the files that it writes, and its page in a real browser."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_helpers import WIDTHS, Elements, browse, measure

from bench.offline_page import POLICY
from protocols.geometry.files import read_g2o, read_tum
from protocols.geometry.pose_graph import optimise

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder that the demo wrote, and its report."""
    for module in ("rtbdata", "matplotlib", "rich", "scipy"):
        pytest.importorskip(module)
    folder = tmp_path_factory.mktemp("demo")
    run = subprocess.run(
        [sys.executable, "-m", "spdz", "demo", "--json", "--out", str(folder / "out")],
        env=os.environ | {"PYTHONPATH": str(ROOT)}, cwd=folder, capture_output=True, text=True, timeout=110,
        check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return folder / "out", json.loads(run.stdout)


def test_both_false_candidates_are_rejected_and_most_right_ones_verified(demo: tuple[Path, Any]) -> None:
    _, report = demo
    assert report["candidates"] == report["clear_candidates"] == 31 and report["disagreements"] == 0
    assert report["private_quality"]["false_positives"] == 2
    assert report["verified_quality"]["false_positives"] == 0
    assert report["verified"] >= 20


def test_merged_map_is_better_than_either_alone_and_than_one_that_believes_all(
    demo: tuple[Path, Any],
) -> None:
    errors = demo[1]["errors"]
    assert errors["alice_alone"] == pytest.approx(2.33, abs=0.01)
    assert errors["bob_alone"] == pytest.approx(1.60, abs=0.01)
    assert errors["merged"] < 0.8 < 10 < errors["unverified"]
    assert errors["kernel_only"] < 1.0


def test_submaps_change_hands_for_candidates_alone(demo: tuple[Path, Any]) -> None:
    _, report = demo
    assert all(0 < shown <= report["candidates"] for shown in report["shown"])
    assert all(shown < of for shown, of in zip(report["shown"], report["keyframes"], strict=True))


def test_every_file_that_the_report_names_is_there(demo: tuple[Path, Any]) -> None:
    out, report = demo
    assert {path.name for path in out.iterdir()} == {"index.html", *report["files"]}
    assert Path(report["page"]).is_file()
    assert (out / "map.png").stat().st_size < 300_000


def test_merged_graph_that_was_written_is_solved_by_the_poses_in_it(demo: tuple[Path, Any]) -> None:
    out, report = demo
    graph = read_g2o(out / "merged.g2o")
    assert len(graph.poses) == 1800 and int(graph.doubtful.sum()) == report["verified"]
    np.testing.assert_allclose(optimise(graph).poses, graph.poses, atol=1e-4)
    _, merged = read_tum(out / "merged.tum")
    np.testing.assert_allclose(merged[:, :2], graph.poses[:, :2], atol=1e-12)


def test_trajectories_are_in_the_order_of_time(demo: tuple[Path, Any]) -> None:
    for name, scans in (("alice", 800), ("bob", 1000), ("merged", 1800)):
        stamps, poses = read_tum(demo[0] / f"{name}.tum")
        assert len(poses) == scans and (np.diff(stamps) > 0).all()


# --- the page --------------------------------------------------------------------------------------------


def text_of(demo: tuple[Path, Any]) -> str:
    return (demo[0] / "index.html").read_text(encoding="utf-8")


def test_page_is_whole_without_scripts_and_loads_nothing(demo: tuple[Path, Any]) -> None:
    text, elements = text_of(demo), Elements()
    elements.feed(text)
    elements.close()
    assert elements.open == []
    assert not elements.tags & {"script", "iframe", "object", "embed", "form"}
    assert all(link.startswith("data:") for link in elements.links)
    assert "@import" not in text and "url(" not in text and POLICY in text
    assert len(text) < 1_000_000


def test_page_tells_the_numbers_of_the_report(demo: tuple[Path, Any]) -> None:
    text, report = text_of(demo), demo[1]
    for words in (
        f"{report['pairs']:,} comparisons",
        f"{report['verified']} verified, {report['candidates'] - report['verified']} rejected",
        f"{report['errors']['merged']:.2f} m",
        f"{report['errors']['unverified']:.2f} m",
        f"({report['shown'][0]} of 99, {report['shown'][1]} of 117)",
        "since some matched more than once",
        f"recall, of {report['same_places']} right pairs",
    ):
        assert words in re.sub(r"\s+", " ", text), words


def test_dots_and_table_count_the_same_kinds(demo: tuple[Path, Any]) -> None:
    """Of the candidates: at most 1 m apart, up to 4 m, and another place."""
    text, report = re.sub(r"\s+", " ", text_of(demo)), demo[1]
    quality = report["private_quality"]
    same, wrong = quality["true_positives"], quality["false_positives"]
    near = report["candidates"] - same - wrong
    for kind, count in (("same", same), ("near", near), ("wrong", wrong)):
        assert text.count(f'class="dot {kind}"') == count
    for words in (f"at most 1 m apart ({same})", f"1 to 4 m ({near})", f"another place ({wrong})"):
        assert words in text
    assert re.search(rf"not counted</th><td>{near}</td>", text)
    assert f"The other {report['candidates'] - report['verified'] - wrong} would have been right" in text


def test_no_time_is_in_milliseconds(demo: tuple[Path, Any]) -> None:
    assert not re.search(r"\d ms\b", text_of(demo))


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_screen_and_every_picture_shows(
    width: int, demo: tuple[Path, Any], tmp_path: Path
) -> None:
    measured = measure(text_of(demo), width, tmp_path)
    assert measured["width"] == width and measured["scroll"] == width and measured["wide"] == []
    assert len(measured["pictures"]) == 9 and measured["broken"] == 0
    assert all(inside > 30 and across > width / 5 for inside, across in measured["pictures"])


def test_browser_has_nothing_to_complain_of(demo: tuple[Path, Any], tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    run = browse(
        demo[0] / "index.html", 360, tmp_path, "--enable-logging=stderr", f"--screenshot={picture}"
    )  # fmt: skip
    assert ":CONSOLE" not in run.stderr, run.stderr
    assert picture.stat().st_size > 20_000
