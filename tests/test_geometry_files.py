"""Graphs and trajectories as files: read back to the last bit, and damaged ones refused with their line."""

import numpy as np
import pytest

from protocols.geometry.files import read_g2o, read_tum, write_g2o, write_tum
from protocols.geometry.pose_graph import PoseGraph


def graph():
    generator = np.random.default_rng(21)
    roots = generator.normal(0, 3, (4, 3, 3))
    information = roots @ roots.swapaxes(1, 2) + np.eye(3)
    pairs = np.array([(0, 1), (1, 2), (2, 3), (3, 0)])
    symmetric = (information + information.swapaxes(1, 2)) / 2
    return PoseGraph(
        generator.normal(0, 9, (4, 3)), pairs, generator.normal(0, 1, (4, 3)), symmetric,
        np.array([False, False, False, True]),
    )  # fmt: skip


def test_graph_is_read_as_it_was_written(tmp_path):
    written, path = graph(), tmp_path / "a.g2o"
    write_g2o(path, written, written.poses)
    read = read_g2o(path)
    for name in PoseGraph.__slots__:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))


def test_graph_is_written_with_the_poses_that_were_found(tmp_path):
    written, path = graph(), tmp_path / "a.g2o"
    write_g2o(path, written, written.poses + 1)
    np.testing.assert_array_equal(read_g2o(path).poses, written.poses + 1)


def test_other_programs_read_the_records(tmp_path):
    written, path = graph(), tmp_path / "a.g2o"
    write_g2o(path, written, written.poses)
    lines = [line.split() for line in path.read_text().splitlines()]
    assert lines[1] == ["FIX", "0"] and [line[0] for line in lines].count("VERTEX_SE2") == 4
    edge = next(line for line in lines if line[0] == "EDGE_SE2")
    xx, xy, xt, yy, yt, tt = map(float, edge[6:])
    np.testing.assert_array_equal([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]], written.information[0])


LOG = """# a graph of another program
VERTEX_SE2 10 1 2 0.5
VERTEX_SE2 4 0 0 0

EDGE_SE2 4 10 1 2 0.5 1 0 0 1 0 1
FIX 4
"""


def test_foreign_ids_are_numbered_in_their_order(tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text(LOG)
    read = read_g2o(path)
    np.testing.assert_array_equal(read.poses, [[0, 0, 0], [1, 2, 0.5]])
    np.testing.assert_array_equal(read.pairs, [[0, 1]])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("VERTEX_SE2 4 0", "VERTEX_SE2 4 zero", "line 3: .*zero"),
        ("VERTEX_SE2 4 0 0 0", "VERTEX_SE2 4 0 0", "line 3: an unexpected VERTEX_SE2 record of 4 words"),
        ("VERTEX_SE2 4 0", "VERTEX_SE2 10 0", "line 3: an unexpected VERTEX_SE2"),
        ("VERTEX_SE2 4 0", "VERTEX_SE3:QUAT 4 0", "line 3: an unexpected VERTEX_SE3:QUAT"),
        ("VERTEX_SE2 4 0", "VERTEX_SE2 4 nan", "line 3: .*not finite"),
        ("EDGE_SE2 4 10 1", "EDGE_SE2 4 10 inf", "line 5: .*not finite"),
        ("EDGE_SE2 4 10", "EDGE_SE2 4 11", "vertex 11, which is not there"),
        ("0.5 1 0 0 1 0 1", "0.5 1 0 0 -1 0 1", "positive definite"),
        ("0.5 1 0 0 1 0 1", "0.5 1 0 0 1 0", "line 5: an unexpected EDGE_SE2 record of 11 words"),
        ("VERTEX_SE2 10 1 2 0.5\nVERTEX_SE2 4 0 0 0\n\nEDGE_SE2 4 10 1 2 0.5 1 0 0 1 0 1\n", "", "shapes"),
    ],
)
def test_damaged_graph_is_refused_with_its_line(old, new, words, tmp_path):
    assert old in LOG
    path = tmp_path / "a.g2o"
    path.write_text(LOG.replace(old, new))
    with pytest.raises(ValueError, match=words) as told:
        read_g2o(path)
    assert str(path) in str(told.value)


def trajectory():
    generator = np.random.default_rng(22)
    stamps = 1.0317e9 + np.cumsum(generator.uniform(0.1, 2, 30))
    return stamps, generator.uniform(-3, 3, (30, 3))


def test_trajectory_is_read_as_it_was_written(tmp_path):
    stamps, poses = trajectory()
    write_tum(tmp_path / "a.tum", stamps, poses)
    read_stamps, read_poses = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(read_stamps, stamps)
    np.testing.assert_array_equal(read_poses[:, :2], poses[:, :2])
    np.testing.assert_allclose(read_poses[:, 2], poses[:, 2], atol=1e-14)


def test_trajectory_of_many_turns_comes_back_within_one(tmp_path):
    write_tum(tmp_path / "a.tum", np.array([0.0]), np.array([[0.0, 0.0, 9.0]]))
    assert read_tum(tmp_path / "a.tum")[1][0, 2] == pytest.approx(9.0 - 4 * np.pi + 2 * np.pi)


def test_trajectory_has_eight_numbers_a_line_and_a_unit_quaternion(tmp_path):
    write_tum(tmp_path / "a.tum", *trajectory())
    table = np.loadtxt(tmp_path / "a.tum")
    assert table.shape == (30, 8) and not table[:, 3:6].any()
    np.testing.assert_allclose(np.linalg.norm(table[:, 4:], axis=1), 1, atol=1e-12)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3 0 0 0 0", "line 2: expected 8 numbers, got 7"),
        ("1 2 3 0 0 0 0 x", "line 2: .*'x'"),
        ("1 nan 3 0 0 0 0 1", "line 2: .*not finite"),
        ("1 2 3 0 0 0 0 2", "line 2: expected a unit quaternion"),
        ("1 2 3 0 0.5 0 0 1", "line 2: expected a unit quaternion about the vertical"),
        ("1 2 3 0 0.6 0 0 0.8", "line 2: expected a unit quaternion about the vertical"),
    ],
)
def test_damaged_trajectory_is_refused_with_its_line(line, words, tmp_path):
    path = tmp_path / "a.tum"
    path.write_text(f"# stamp x y z qx qy qz qw\n{line}\n")
    with pytest.raises(ValueError, match=words):
        read_tum(path)


def test_trajectory_without_poses_is_empty(tmp_path):
    (tmp_path / "a.tum").write_text("# nothing\n")
    stamps, poses = read_tum(tmp_path / "a.tum")
    assert stamps.shape == (0,) and poses.shape == (0, 3)


def test_trajectory_of_other_shapes_or_numbers_is_not_written(tmp_path):
    path = tmp_path / "a.tum"
    with pytest.raises(ValueError, match="stamps and"):
        write_tum(path, np.zeros(3), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="stamps and"):
        write_tum(path, np.zeros(3), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="finite"):
        write_tum(path, np.zeros(1), np.full((1, 3), np.nan))
    assert not path.exists()
