"""Pose graphs: exact where nothing is noisy, right where a loop is wrong, refused where nothing is told."""

import numpy as np
import pytest

from protocols.geometry.merging import Loop, lay_upon, trajectory_error, two_maps
from protocols.geometry.pose_graph import PoseGraph, optimise
from protocols.geometry.poses import apply, between, chain, compose, inverse, wrap

pytest.importorskip("scipy")
STEP, LOOP = np.array([0.05, 0.05, 0.01]), np.array([0.1, 0.1, 0.02])


def rng(seed=11):
    return np.random.default_rng(seed)


def ring(sides=4, side=20):
    """The true poses of a drive along the sides of a square, metre by metre."""
    steps = np.tile([1.0, 0.0, 0.0], (sides * side, 1))
    steps[side - 1 :: side, 2] = np.pi / 2
    return chain((0.0, 0.0, 0.0), steps)


def drift(poses, seed):
    """The same drive as odometry has it, from the origin."""
    steps = between(poses[:-1], poses[1:])
    return chain((0.0, 0.0, 0.0), steps + rng(seed).normal(0, 1, steps.shape) * STEP)


def two_robots(wrong=()):
    """Truth of both, their odometries, and loops every 8 m of which some are wrong."""
    first, second = ring(), compose((0.4, -0.3, 0.1), ring())
    loops = []
    for at in range(0, len(first), 8):
        pose = between(first[at], second[at]) + rng(at).normal(0, 1, 3) * LOOP / 2
        loops.append(Loop(at, at, tuple(pose)))
    loops += [Loop(i, j, (0.1, 0.2, 0.05)) for i, j in wrong]
    return np.concatenate([first, second]), (drift(first, 1), drift(second, 2)), loops


# --- poses -----------------------------------------------------------------------------------------------


def test_composition_is_that_of_matrices():
    def matrix(pose):
        x, y, theta = pose
        return np.array([[np.cos(theta), -np.sin(theta), x], [np.sin(theta), np.cos(theta), y], [0, 0, 1]])

    a, b = rng().normal(0, 2, (2, 3))
    np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(matrix(inverse(a)), np.linalg.inv(matrix(a)), atol=1e-12)
    np.testing.assert_allclose(matrix(between(a, b)), np.linalg.inv(matrix(a)) @ matrix(b), atol=1e-12)
    points = rng().normal(0, 3, (5, 2))
    expected = (matrix(a) @ np.column_stack([points, np.ones(5)]).T).T[:, :2]
    np.testing.assert_allclose(apply(a, points), expected, atol=1e-12)


def test_angles_are_wrapped_to_half_a_turn():
    np.testing.assert_allclose(wrap([0.0, 4.0, -4.0, 7 * np.pi]), [0, 4 - 2 * np.pi, 2 * np.pi - 4, -np.pi])


def test_chain_of_steps_is_their_composition():
    steps = rng().normal(0, 1, (6, 3))
    poses = chain((1.0, 2.0, 0.5), steps)
    for before, step, after in zip(poses, steps, poses[1:], strict=False):
        np.testing.assert_allclose(between(compose(before, step), after), 0, atol=1e-12)


# --- optimising ------------------------------------------------------------------------------------------


def noiseless(n=12):
    """A graph whose measurements are exact, from a start that is not."""
    poses = compose((0.3, 0.2, 0.4), chain((0.0, 0.0, 0.0), rng().normal(0, 1, (n - 1, 3))))
    pairs = np.array([(i, i + 1) for i in range(n - 1)] + [(0, n - 1), (2, n - 3)])
    measured = between(poses[pairs[:, 0]], poses[pairs[:, 1]])
    start = poses + rng(12).normal(0, 0.2, poses.shape)
    start[0] = poses[0]
    information = np.tile(np.diag([100.0, 50.0, 400.0]), (len(pairs), 1, 1))
    return poses, PoseGraph(start, pairs, measured, information, np.arange(len(pairs)) >= n - 1)


def test_exact_measurements_give_the_exact_poses():
    poses, graph = noiseless()
    found = optimise(graph)
    assert found.settled
    np.testing.assert_allclose(found.poses[:, :2], poses[:, :2], atol=1e-7)
    np.testing.assert_allclose(wrap(found.poses[:, 2] - poses[:, 2]), 0, atol=1e-7)
    np.testing.assert_allclose(found.weights, 1.0, atol=1e-9)


def test_slopes_are_those_of_the_errors():
    _, graph = noiseless(6)
    from protocols.geometry.pose_graph import _slopes

    first, second = _slopes(graph, graph.poses)
    whitening, small = graph.whitening(), 1e-6
    for pose in range(6):
        for axis in range(3):
            moved = graph.poses.copy()
            moved[pose, axis] += small
            back = graph.poses.copy()
            back[pose, axis] -= small
            slope = (graph.errors(moved) - graph.errors(back)) / (2 * small)
            expected = np.zeros_like(slope)
            for edge, (i, j) in enumerate(graph.pairs):
                if i == pose:
                    expected[edge] += (whitening[edge] @ first[edge])[:, axis]
                if j == pose:
                    expected[edge] += (whitening[edge] @ second[edge])[:, axis]
            np.testing.assert_allclose(slope, expected, atol=1e-6)


def test_found_poses_are_the_least_squares_ones():
    truth, odometry, loops = two_robots()
    graph = two_maps(*odometry, loops, step=STEP, loop=LOOP)
    found = optimise(graph, robust=False)
    least = (graph.errors(found.poses) ** 2).sum()
    for seed in range(20):
        near = found.poses + rng(seed).normal(0, 1e-3, found.poses.shape)
        assert (graph.errors(near) ** 2).sum() > least
    assert trajectory_error(found.poses, truth) < trajectory_error(graph.poses, truth)


def test_information_weighs_correlated_errors():
    # Two measurements of one pose: the more certain one along x + y wins there, the other across.
    sure, vague = 400.0, 1.0
    along = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]]) / 2
    across = np.diag([1.0, 1.0, 0.0]) - along
    information = np.array([sure * along + vague * across, vague * along + sure * across])
    information[:, 2, 2] = 1.0
    graph = PoseGraph(
        np.zeros((2, 3)),
        np.array([(0, 1), (0, 1)]),
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        information,
        np.zeros(2, dtype=np.bool_),
    )
    x, y, _ = optimise(graph).poses[1]
    assert x + y == pytest.approx(1.0, abs=0.01) and x - y == pytest.approx(0.0, abs=0.01)


WRONG = ((3, 45), (30, 70), (60, 12))


def test_wrong_loops_weigh_nothing_under_the_robust_kernel():
    truth, odometry, loops = two_robots(WRONG)
    graph = two_maps(*odometry, loops, step=STEP, loop=LOOP)
    found = optimise(graph)
    assert found.settled
    weights = found.weights[graph.doubtful]
    assert (weights[-len(WRONG) :] < 0.01).all() and (weights[: -len(WRONG)] > 0.5).all()
    assert (found.weights[~graph.doubtful] == 1).all()
    _, _, right = two_robots()
    clean = optimise(two_maps(*odometry, right, step=STEP, loop=LOOP))
    assert trajectory_error(found.poses, truth) < trajectory_error(clean.poses, truth) + 0.1


def test_wrong_loops_ruin_the_map_without_it():
    truth, odometry, loops = two_robots(WRONG)
    graph = two_maps(*odometry, loops, step=STEP, loop=LOOP)
    robust, careless = (optimise(graph, robust=robust) for robust in (True, False))
    assert trajectory_error(careless.poses, truth) > 4 * trajectory_error(robust.poses, truth)


def test_first_pose_stays_where_it_is():
    _, graph = noiseless()
    np.testing.assert_allclose(optimise(graph).poses[0], graph.poses[0], atol=1e-12)


def test_single_pose_is_its_own_solution():
    nothing = np.zeros((0, 3))
    graph = PoseGraph(
        np.array([[1.0, 2.0, 0.5]]), np.zeros((0, 2), dtype=np.int64), nothing, np.zeros((0, 3, 3)),
        np.zeros(0, dtype=np.bool_),
    )  # fmt: skip
    np.testing.assert_array_equal(optimise(graph).poses, [[1.0, 2.0, 0.5]])


def test_gtsam_finds_the_same_poses():
    pytest.importorskip("gtsam")
    _, odometry, loops = two_robots(WRONG)
    graph = two_maps(*odometry, loops, step=STEP, loop=LOOP)
    ours, theirs = optimise(graph), optimise(graph, solver="gtsam")
    np.testing.assert_allclose(between(ours.poses, theirs.poses), 0, atol=1e-3)
    np.testing.assert_allclose(ours.weights, theirs.weights, atol=1e-3)


def test_missing_gtsam_is_told_with_the_command(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gtsam", None)
    with pytest.raises(ImportError, match="pip install gtsam"):
        optimise(noiseless()[1], solver="gtsam")


# --- what is refused -------------------------------------------------------------------------------------


def graph_with(**changes):
    _, graph = noiseless(4)
    fields = {name: getattr(graph, name) for name in PoseGraph.__slots__}
    return PoseGraph(**(fields | changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"poses": np.zeros((0, 3))}, "has shapes"),
        ({"measured": np.zeros((5, 2))}, "has shapes"),
        ({"doubtful": np.zeros(4, dtype=np.bool_)}, "has shapes"),
        ({"pairs": np.array([(0, 1), (1, 2), (2, 3), (0, 3), (2, 4)])}, "joins two of the 4 poses"),
        ({"pairs": np.array([(0, 1), (1, 2), (2, 3), (0, 3), (-1, 1)])}, "joins two of the 4 poses"),
        ({"pairs": np.array([(0, 1), (1, 2), (2, 3), (0, 3), (1, 1)])}, "joins two of the 4 poses"),
        ({"poses": np.full((4, 3), np.nan)}, "finite numbers"),
        ({"measured": np.full((5, 3), np.inf)}, "finite numbers"),
        ({"information": np.zeros((5, 3, 3))}, "positive definite"),
        ({"information": np.tile(np.diag([1.0, -1.0, 1.0]), (5, 1, 1))}, "positive definite"),
        ({"information": np.tile(np.eye(3) + np.eye(3, k=1), (5, 1, 1))}, "symmetric"),
    ],
)
def test_graph_that_is_none_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        graph_with(**changes)


def test_graph_in_two_pieces_is_refused():
    graph = graph_with(pairs=np.array([(0, 1), (1, 0), (2, 3), (3, 2), (0, 1)]))
    with pytest.raises(ValueError, match="in 2 pieces"):
        optimise(graph)


def test_solver_of_another_name_is_refused():
    with pytest.raises(ValueError, match='"scipy" or "gtsam", not \'ceres\''):
        optimise(noiseless()[1], solver="ceres")


def test_maps_without_a_loop_are_not_merged():
    _, odometry, _ = two_robots()
    with pytest.raises(ValueError, match="no loop joins"):
        two_maps(*odometry, [], step=STEP, loop=LOOP)
    for loop in (Loop(81, 0, (0, 0, 0)), Loop(0, 99, (0, 0, 0)), Loop(-1, 0, (0, 0, 0))):
        with pytest.raises(ValueError, match="outside 81 and 81"):
            two_maps(*odometry, [loop], step=STEP, loop=LOOP)


# --- errors of trajectories ------------------------------------------------------------------------------


def test_error_does_not_depend_on_the_frame_but_on_the_scale():
    truth = ring()
    moved = compose((3.0, -8.0, 2.0), truth)
    assert trajectory_error(moved, truth) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(lay_upon(moved, truth)[:, :2], truth[:, :2], atol=1e-9)
    assert trajectory_error(truth * (1.1, 1.1, 1.0), truth) > 0.5


def test_error_is_the_root_mean_square_after_the_best_fit():
    truth = np.array([[-1.0, 0, 0], [1.0, 0, 0], [0, 0, 0]])
    estimated = np.array([[-1.0, 0.3, 0], [1.0, 0.3, 0], [0, -0.6, 0]])
    assert trajectory_error(estimated, truth) == pytest.approx(np.sqrt((0.09 + 0.09 + 0.36) / 3))


def test_error_of_nothing_is_refused():
    with pytest.raises(ValueError, match="as many poses"):
        trajectory_error(np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="as many poses"):
        trajectory_error(np.zeros((2, 3)), np.zeros((3, 3)))
