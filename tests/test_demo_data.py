"""The demo's data: the log's format, what descriptors keep, and how good the matches are."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from bench.demo import dataset, places, scan_context
from bench.demo.cli import NEEDS
from bench.demo.dataset import Run
from bench.demo.local_map import LocalMap, describes
from bench.demo.mapping import PublicMap
from bench.demo.places import Robot, robots, truth
from protocols.geometry.submap import Submap
from spdz.foundations.types import FloatArray

ROOT = Path(__file__).resolve().parent.parent
HITS = "0 3 1.5 2.5 50.9"
SCAN = f"ROBOTLASER1 0 -1.570796 3.141593 1.570796 50.0 0.1 {HITS} 0 1 2 0.5 1 2 0.5 0 0 0 0 0 7.5 iB21 6.5"
LOG = f"""#SEQUENTIAL EDGES
VERTEX_SE2 0 1.0 2.0 0.5
{SCAN}
VERTEX_SE2 1 2.0 2.0 0.25
{SCAN}
VERTEX_SE2 2 3.0 2.0 -0.25

{SCAN}
EDGE_SE2 0 1 0.9 -0.1 0.01 500 0 0 500 0 5000
EDGE_SE2 1 2 1.1 0.1 0.02 500 0 0 500 0 5000
#LOOP EDGES
EDGE_SE2 0 2 2.0 0.0 0.03 500 0 0 500 0 5000
"""


def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)


def robot(positions: list[tuple[float, float]], turns: int = 1) -> Robot:
    n = len(positions) * turns
    positioned = np.array(positions, dtype=np.float64)
    local = LocalMap(range(0), np.zeros((0, 3)), np.zeros(0, dtype=np.int64), ())
    return Robot("bob", np.zeros((2, 2)), positioned, np.eye(n, 1200), turns, local=local)


# --- the log ---------------------------------------------------------------------------------------------


def test_log_is_parsed_into_poses_scans_odometry_and_loops() -> None:
    run = dataset.parse(LOG.splitlines())
    np.testing.assert_array_equal(run.poses, [[1, 2, 0.5], [2, 2, 0.25], [3, 2, -0.25]])
    np.testing.assert_array_equal(run.ranges, [[1.5, 2.5, 50.9]] * 3)
    np.testing.assert_array_equal(run.stamps, [7.5] * 3)
    np.testing.assert_allclose(run.bearings, [-np.pi / 2, 0, np.pi / 2], atol=1e-5)
    np.testing.assert_array_equal(run.odometry, [[0.9, -0.1, 0.01], [1.1, 0.1, 0.02]])
    np.testing.assert_array_equal(run.loops, [[0, 2]])
    np.testing.assert_array_equal(run.loop_poses, [[2.0, 0.0, 0.03]])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("VERTEX_SE2 1 2.0", "VERTEX_SE2 1 two", "line 4 .*two"),
        ("VERTEX_SE2 2", "VERTEX_SE2 7", "line 6 .*VERTEX_SE2"),
        ("VERTEX_SE2 2", "VERTEX_SE3 2", "line 6 .*VERTEX_SE3"),
        (f"VERTEX_SE2 1 2.0 2.0 0.25\n{SCAN}", "VERTEX_SE2 1 2.0 2.0 0.25", "line 5 .*VERTEX_SE2"),
        (f"\n\n{SCAN}", "\n", "one scan a vertex"),
        (f"\n\n{SCAN}", f"\n{SCAN.replace(' 1.570796 ', ' 0.7 ')}", "same beams"),
        (" 0 3 1.5", " 0 99 1.5", "line 3 .*99 readings"),
        (" 7.5 iB21 6.5", "", "line 3 .*the time"),
        ("EDGE_SE2 1 2", "EDGE_SE2 0 2", r"odometry edge \(1, 2\)"),
    ],
)
def test_damaged_log_is_refused_with_its_line(old: str, new: str, words: str) -> None:
    assert old in LOG
    with pytest.raises(ValueError, match=words):
        dataset.parse(LOG.replace(old, new, 1).splitlines())


def test_missing_scans_are_told_by_their_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> None:
        raise ModuleNotFoundError("No module named 'rtbdata'")

    monkeypatch.setattr("importlib.resources.files", missing)
    with pytest.raises(ModuleNotFoundError, match="rtb-data"):
        dataset.load()


# --- the command -----------------------------------------------------------------------------------------


def demo(folder: Path, *words: str, without: str = "") -> "subprocess.CompletedProcess[str]":
    """Run the demo's command in a folder, as if a module were not installed."""
    code = f"import sys; sys.modules[{without!r}] = None; from spdz.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "demo", *words]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False
    )


EXTRAS = {"rtbdata", "matplotlib", "rich", "scipy"}


@pytest.mark.parametrize("module", sorted(EXTRAS))
def test_missing_extra_is_told_with_a_command_that_installs_it(module: str, tmp_path: Path) -> None:
    for other in EXTRAS - {module}:
        pytest.importorskip(other)
    result = demo(tmp_path, without=module)
    assert result.returncode == 1 and not result.stdout and "Traceback" not in result.stderr
    advice = result.stderr.splitlines()[-1]
    assert module.replace("rtbdata", "rtb-data") in advice.partition("The demo needs")[0]
    _, _, command = advice.rpartition(": ")
    assert shlex.split(command) == [sys.executable, "-m", "pip", "install", *NEEDS]
    assert list(tmp_path.iterdir()) == []


def test_the_command_names_what_the_extra_names() -> None:
    extra = re.search(
        r"^demo = \[(.*)\]$", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert extra is not None and re.findall(r'"([^"]+)"', extra.group(1)) == list(NEEDS)


def test_folder_that_cannot_be_made_is_told_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("rtbdata")
    (tmp_path / "file").write_text("")
    result = demo(tmp_path, "--out", "file/map")
    assert result.returncode == 1 and "file/map" in result.stderr and "Traceback" not in result.stderr


def test_report_accounts_for_every_candidate(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rich")
    pytest.importorskip("matplotlib")
    from bench.demo.merged import Errors
    from bench.demo.report import show
    from bench.demo.result import Report

    report = Report(
        security="malicious",
        keyframes=(9, 11),
        dimension=8,
        threshold=0.5,
        pairs=99,
        candidates=31,
        clear_candidates=28,
        verified=25,
        private_quality=places.Quality(0.9, 0.7, 21, 2),
        clear_quality=places.Quality(0.8, 0.6, 20, 3),
        verified_quality=places.Quality(1.0, 0.6, 20, 0),
        errors=Errors(2.3, 1.6, 43.7, 0.7, 0.6, 0.8, 0.5),
        same_places=30,
        disagreements=3,
        dealt_slots=(10, 12),
        dealing_seconds=0.5,
        folder_bytes=(1000, 1000),
        bytes_sent=(2000, 2000),
        rounds=20,
        milliseconds=100.0,
        shown=(5, 6),
        payload_bytes=(700, 800),
        verifying_milliseconds=50.0,
        clear_bytes=(300, 300),
        clear_milliseconds=0.1,
        page="index.html",
        picture="map.png",
        files=("map.png",),
    )
    show(report, 100)
    shown = capsys.readouterr().out
    assert re.search(r"│ a vector's norm +│ at most 1, as was proved │ yes ", shown)
    found = re.findall(r"│ (.*?) +│ +(\d+) │ +(\d+) │ +(\d+) │", shown)
    rows = {label: (int(private), int(clear), int(verified)) for label, private, clear, verified in found}
    parts = ("right: at most 1 m apart", "near: 1 to 4 m, not counted", "wrong: another place")
    assert [sum(column) for column in zip(*(rows[part] for part in parts), strict=True)] == [31, 28, 25]


# --- descriptors -----------------------------------------------------------------------------------------


def test_scan_lands_where_the_beam_points() -> None:
    points = scan_context.scan_points(
        np.array([[2.0, 50.0]]), np.array([0.0, 0.1]), np.array([[1.0, 1.0, np.pi / 2]])
    )
    np.testing.assert_allclose(points[0, 0], [1.0, 3.0], atol=1e-12)
    assert np.isnan(points[0, 1]).all()


@pytest.mark.parametrize("angle", [-0.7, -0.2, 0.0, 0.4, 0.78])
@pytest.mark.parametrize("quarter", [-1, 0, 1, 2])
def test_walls_are_found_at_the_quarter_turn_nearest_to_the_compass(angle: float, quarter: int) -> None:
    along = np.arange(0, 4, 0.1)
    room = np.stack([np.stack([along, 0 * along], 1), np.stack([0 * along, along], 1)])
    z = (room[..., 0] + 1j * room[..., 1]) * np.exp(1j * angle)
    near = angle + quarter * np.pi / 2 + 0.6
    found = scan_context.wall_direction(np.stack([z.real, z.imag], -1), near)
    assert found == pytest.approx(angle + quarter * np.pi / 2, abs=1e-9)


def test_grid_counts_squares_not_readings() -> None:
    points = rng().uniform(-22, 22, (3000, 2))
    once, thrice = scan_context.polar_grid(points), scan_context.polar_grid(np.tile(points, (3, 1)))
    np.testing.assert_array_equal(once, thrice)
    assert once.max() <= np.sqrt(scan_context.SATURATION) + 1e-12


def test_point_falls_into_its_ring_and_sector() -> None:
    angle = np.radians(6 * 20 + 3)
    grid = scan_context.polar_grid(7.52 * np.array([[np.cos(angle), np.sin(angle)]]))
    assert grid.argmax() == 7 * 60 + 20
    assert grid.sum() == pytest.approx(1.0)


def test_quarter_turn_of_the_points_rolls_the_grid_by_fifteen_sectors() -> None:
    points = rng().normal(0, 8, (4000, 2))
    turned = np.stack([-points[:, 1], points[:, 0]], axis=1)
    rolled = np.roll(scan_context.polar_grid(points), 15, axis=1)
    np.testing.assert_allclose(scan_context.polar_grid(turned), rolled, atol=1e-12)
    np.testing.assert_array_equal(scan_context.quarter_turns(scan_context.polar_grid(points), 4)[1], rolled)


def test_descriptors_have_norm_one_and_turn_with_the_grid() -> None:
    grids = np.stack([scan_context.polar_grid(rng().normal(k, 4 + k, (2000, 2))) for k in range(6)])
    background = scan_context.Background.fit(grids[:4])
    descriptors = background.describe(grids)
    assert descriptors.shape == (6, 1200) and descriptors.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1.0, atol=1e-12)
    turned = background.describe(np.roll(grids, 15, axis=2))
    rolled = np.roll(descriptors.reshape(6, 20, 60), 15, axis=2).reshape(6, 1200)
    np.testing.assert_allclose(turned, rolled, atol=1e-9)


def test_whitening_evens_out_the_spread_of_the_background() -> None:
    grids = np.stack([scan_context.polar_grid(rng().normal(0, 3 + k, (2000, 2))) for k in range(8)])
    background = scan_context.Background.fit(grids)
    flat = np.concatenate([scan_context.quarter_turns(grid, 4) for grid in grids]).reshape(-1, 1200)

    def spread(rows: FloatArray) -> float:
        variances = np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False)[:7] ** 2
        return float(variances.max() / variances.sum())

    assert spread(flat @ background.whitening) < spread(flat) / 2


# --- folding, ground truth, precision and recall ---------------------------------------------------------


def test_any_turn_that_matches_makes_the_keyframe_match() -> None:
    decisions = np.zeros((3, 8), dtype=np.bool_)
    decisions[0, 1] = decisions[1, 6] = decisions[2, 3] = decisions[2, 4] = True
    folded = robot([(0, 0), (1, 1)], turns=4).fold(decisions)
    np.testing.assert_array_equal(folded, [[True, False], [False, True], [True, True]])


def test_one_turn_a_keyframe_folds_to_itself() -> None:
    decisions = rng().random((5, 3)) < 0.5
    np.testing.assert_array_equal(robot([(0, 0)] * 3).fold(decisions), decisions)


@pytest.mark.parametrize("shape", [(8,), (3, 7), (8, 3), (3, 2)])
def test_decisions_of_another_shape_are_not_folded(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected shape \(m, 8\)"):
        robot([(0, 0), (1, 1)], turns=4).fold(np.zeros(shape, dtype=np.bool_))


def test_truth_leaves_out_what_is_neither_near_nor_far() -> None:
    alice, bob = robot([(0, 0), (10, 0)]), robot([(0.6, 0.8), (0, 1.1), (10, 4.0), (10, 4.1)])
    labels = truth(alice, bob)
    assert labels.dtype == np.int8
    np.testing.assert_array_equal(labels, [[1, -1, 0, 0], [0, 0, -1, 0]])


def labels_and_decisions() -> tuple[npt.NDArray[np.int8], npt.NDArray[np.bool_]]:
    labels = np.array([[1, 1, 1, 0], [1, 0, -1, 1]], dtype=np.int8)
    decisions = np.array([[True, True, True, True], [False, False, True, False]])
    return labels, decisions


def test_precision_and_recall_ignore_pairs_left_out() -> None:
    labels, decisions = labels_and_decisions()
    assert places.precision_recall(decisions, labels) == (3 / 4, 3 / 5, 3, 1)
    assert places.precision_recall(labels == 1, labels) == (1.0, 1.0, 5, 0)
    assert places.precision_recall(labels == 0, labels) == (0.0, 0.0, 0, 2)


def test_precision_of_no_match_is_not_a_number() -> None:
    labels, decisions = labels_and_decisions()
    precision, *rest = places.precision_recall(np.zeros_like(decisions), labels)
    assert np.isnan(precision) and rest == [0.0, 0, 0]


def test_precision_refuses_unfolded_decisions_and_empty_truth() -> None:
    labels, decisions = labels_and_decisions()
    with pytest.raises(ValueError, match=r"shape \(2, 4\)"):
        places.precision_recall(np.repeat(decisions, 4, axis=1), labels)
    with pytest.raises(ValueError, match="recall has no meaning"):
        places.precision_recall(decisions, np.zeros_like(labels))


# --- the real run ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run() -> Run:
    pytest.importorskip("rtbdata")
    return dataset.load()


@pytest.fixture(scope="module")
def pair(run: Run) -> tuple[Robot, Robot]:
    return robots(run)


def test_vertices_agree_with_every_loop_edge_so_they_can_be_the_truth(run: Run) -> None:
    assert run.ranges.shape == (3873, 180) and run.loops.shape == (1115, 2)
    first, second = run.poses[run.loops[:, 0]], run.poses[run.loops[:, 1]]
    offset = second[:, :2] - first[:, :2]
    seen = (offset[:, 0] + 1j * offset[:, 1]) * np.exp(-1j * first[:, 2])
    error = np.abs(seen - (run.loop_poses[:, 0] + 1j * run.loop_poses[:, 1]))
    assert np.median(error) < 0.02 and error.max() < 0.21


def test_robots_find_common_places_with_few_mistakes(pair: tuple[Robot, Robot]) -> None:
    alice, bob = pair
    assert (alice.name, bob.name, bob.turns) == ("alice", "bob", 1)
    for one in pair:
        assert one.descriptors.shape == (len(one.positions), 1200)
        np.testing.assert_allclose(np.linalg.norm(one.descriptors, axis=1), 1.0, atol=1e-12)
    labels = truth(alice, bob)
    assert labels.size > 10_000
    scores = alice.descriptors @ bob.descriptors.T
    quality = places.precision_recall(bob.fold(scores >= places.DEFAULT_THRESHOLD), labels)
    assert quality.precision >= 0.85 and quality.recall >= 0.6 and quality.true_positives >= 18


def test_robot_shows_neither_path_nor_descriptors_in_its_repr(pair: tuple[Robot, Robot]) -> None:
    assert repr(pair[1]) == "Robot(name='bob', turns=1)"


def test_submap_gives_the_descriptor_that_was_compared_and_no_other(
    run: Run, pair: tuple[Robot, Robot]
) -> None:
    public = PublicMap.of(run, places.SPACING).background
    for robot in pair:
        local = robot.local
        assert len(local.payloads) == len(robot.descriptors) == len(local.keyframes)
        opened = np.round(robot.descriptors * 2**16) / 2**16
        for keyframe in range(0, len(opened) - 1, 9):
            payload = local.payloads[keyframe]
            assert describes(public, payload, opened[keyframe])
            assert not describes(public, payload, opened[keyframe + 1])
            assert not describes(public, payload, -opened[keyframe])
            assert not describes(public, payload[:-8], opened[keyframe])


def test_submap_lies_in_the_keyframes_frame(run: Run, pair: tuple[Robot, Robot]) -> None:
    local = pair[0].local
    for keyframe in (0, 20, 40):
        scan = local.keyframes[keyframe]
        own = scan_context.scan_points(run.ranges[scan : scan + 1], run.bearings, np.zeros((1, 3)))[0]
        own = own[np.isfinite(own[:, 0])]
        points = Submap.from_bytes(local.payloads[keyframe]).points
        distance = np.hypot(*(own[:, None] - points[None]).T).min(axis=0)
        assert np.median(distance) < 0.05 and len(points) == len(np.unique(points, axis=0))


def test_robots_refuse_a_run_without_public_map() -> None:
    with pytest.raises(ValueError, match="more than 1800 scans, got 3"):
        robots(dataset.parse(LOG.splitlines()))
    with pytest.raises(ValueError, match="turns 1 or 4"):
        robots(dataset.parse(LOG.splitlines()), turns=2)


def test_pictures_are_written_without_touching_pyplot(
    run: Run, pair: tuple[Robot, Robot], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    from bench.demo.picture import draw_before, draw_merged
    from bench.demo.scene import views

    local = [robot.local for robot in pair]
    shown = views(run, local, [own.poses for own in local])
    for pairs in ([(1, 73), (2, 74)], []):
        draw_merged(tmp_path / "map.png", shown, pairs, "a line")
        data = (tmp_path / "map.png").read_bytes()
        assert data.startswith(b"\x89PNG") and 50_000 < len(data) < 300_000
    draw_before(tmp_path / "before.png", shown, "a line")
    assert (tmp_path / "before.png").read_bytes().startswith(b"\x89PNG")
