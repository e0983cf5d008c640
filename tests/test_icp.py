"""Alignment of two submaps: known transforms are found, what may be a mistake is refused with its reason."""

import numpy as np
import pytest
from geometry_helpers import corridor, hall, seen_from, square_room, walls

from protocols.geometry.icp import align
from protocols.geometry.poses import between, compose
from protocols.geometry.submap import Submap
from protocols.geometry.verification import verify_submaps

pytest.importorskip("scipy")


def payload(points, walls=0.0):
    return Submap(points, walls).to_bytes()


@pytest.mark.parametrize(
    "pose",
    [(0.0, 0.0, 0.0), (1.3, -0.7, 0.05), (-3.0, 0.4, -0.08), (0.2, 2.9, 0.1), (4.2, -1.0, 0.0)],
)
def test_known_transform_is_recovered(pose):
    found = align(hall(1), seen_from(hall(2), pose))
    assert found.accepted and found.share > 0.95 and found.residual < 0.03
    x, y, theta = between(pose, found.transform)
    assert np.hypot(x, y) < 0.02 and abs(theta) < 0.003


@pytest.mark.parametrize("turn", [0.7, 1.6, 3.0, -2.4])
def test_any_heading_is_found_without_a_compass(turn):
    pose = (0.8, -0.5, turn)
    found = align(hall(1), seen_from(hall(2), pose), heading=None)
    assert found.accepted
    assert np.abs(between(pose, found.transform)).max() < 0.02


def test_heading_beyond_the_spread_is_not_found():
    assert not align(hall(1), seen_from(hall(2), (0.0, 0.0, 0.7))).accepted


def test_heading_that_is_known_is_enough():
    pose = (0.5, 1.0, 2.2)
    assert align(hall(1), seen_from(hall(2), pose), heading=2.25).accepted


def test_places_farther_apart_than_the_search_are_refused():
    assert not align(hall(1), seen_from(hall(2), (7.5, 0.0, 0.0))).accepted


def test_another_place_is_rejected_by_its_share():
    other = walls((-9, 5, 9, 5), (-9, 2, 1, 2), (1, 2, 1, -7), (4, 2, 9, 2), (4, 2, 4, -7), (1, -7, 4, -7))
    found = align(hall(), other)
    assert not found.accepted and found.share < 0.8 and "agree" in found.why


def test_place_that_is_a_part_of_the_other_is_rejected():
    # All of the bare corridor lies on walls of the furnished one; the share the other way tells them apart.
    furnished = np.concatenate(
        [corridor(), walls(*((x, -1.2, x, -0.4) for x in np.arange(-8.0, 8.0, 0.8)), (3, 1.2, 3, 4))]
    )
    bare = np.concatenate([corridor(2), walls((3, 1.2, 3, 4), seed=3)])
    for own, other in ((furnished, bare), (bare, furnished)):
        found = align(own, other)
        assert not found.accepted and "agree" in found.why


def test_parallel_walls_alone_are_refused_since_they_slide():
    found = align(corridor(1), seen_from(corridor(2), (1.7, 0.1, 0.02)))
    assert not found.accepted and "slides" in found.why and found.share > 0.9


def test_clutter_does_not_hold_a_corridor_that_slides():
    def cluttered(seed):
        clutter = np.random.default_rng(seed).uniform((-8, -1.1), (8, 1.1), (160, 2))
        return np.concatenate([corridor(seed), clutter])

    found = align(cluttered(1), seen_from(cluttered(2), (1.7, 0.1, 0.02)), share=0.7)
    assert not found.accepted and "slides" in found.why


def test_corridor_with_one_door_is_accepted():
    doors = walls((2.0, 1.2, 2.0, 3.4), (3.0, 1.2, 3.0, 3.4))
    own = np.concatenate([corridor(1), doors])
    found = align(own, seen_from(np.concatenate([corridor(2), doors]), (1.7, 0.1, 0.02)))
    assert found.accepted and np.abs(between((1.7, 0.1, 0.02), found.transform)).max() < 0.05


def test_corridor_of_equal_doors_is_refused_since_it_fits_twice():
    doors = walls(*((float(x), 1.2, float(x), 3.0) for x in range(-18, 19, 3)))
    own = np.concatenate([corridor(1), doors])
    found = align(own, seen_from(np.concatenate([corridor(2), doors]), (0.3, 0.0, 0.0)))
    assert not found.accepted and "two different" in found.why


def test_room_that_looks_the_same_from_four_sides_needs_a_compass():
    own, other = square_room(1), seen_from(square_room(2), (0.4, 0.2, 0.03))
    assert align(own, other).accepted
    found = align(own, other, heading=None)
    assert not found.accepted and "two different" in found.why


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 2)),
        np.zeros((1, 2)),
        np.full((5000, 2), 1.5),
        np.array([[float(i % 3), 0.0] for i in range(3000)]),
        np.array([[50.0 + 0.1 * i, 0.0] for i in range(300)]),
    ],
    ids=["none", "one", "one place", "three places", "all far away"],
)
def test_degenerate_submaps_are_refused_not_guessed(points):
    for own, other in ((hall(), points), (points, hall()), (points, points)):
        found = align(own, other)
        assert not found.accepted and found.transform is None and "fewer than" in found.why


def test_scattered_points_have_no_lines():
    cloud = np.random.default_rng(3).uniform(-8, 8, (3000, 2))
    assert not align(cloud, hall()).accepted
    assert not align(hall(), cloud).accepted


@pytest.mark.parametrize("points", [np.full((200, 2), np.nan), np.full((200, 2), np.inf), np.zeros((9, 3))])
def test_points_that_are_no_points_are_errors(points):
    with pytest.raises(ValueError, match="finite points of shape"):
        align(hall(), points)


# --- payloads --------------------------------------------------------------------------------------------


def test_both_robots_come_to_one_verdict_and_inverse_transforms():
    mine, theirs = payload(hall(1)), payload(seen_from(hall(2), (1.1, -0.4, 0.06)))
    here, there = verify_submaps(mine, theirs), verify_submaps(theirs, mine)
    assert here.accepted and there.accepted and here.weight == there.weight
    np.testing.assert_allclose(compose(here.transform, there.transform), 0, atol=1e-12)
    np.testing.assert_allclose(here.transform, (1.1, -0.4, 0.06), atol=0.02)


@pytest.mark.parametrize("turn", [1.2, -2.8])
def test_walls_of_the_payloads_tell_the_heading(turn):
    pose = (0.6, 0.3, turn)
    found = verify_submaps(payload(hall(1), 0.3), payload(seen_from(hall(2), pose), 0.3 - turn))
    assert found.accepted
    np.testing.assert_allclose(found.transform, pose, atol=0.02)


def test_without_a_compass_the_walls_are_not_asked():
    pose = (0.6, 0.3, 2.0)
    theirs = payload(seen_from(hall(2), pose))
    assert not verify_submaps(payload(hall(1)), theirs).accepted
    assert verify_submaps(payload(hall(1)), theirs, compass=False).accepted


def test_damaged_payload_of_the_peer_is_a_verdict_and_ones_own_an_error():
    good = payload(hall())
    found = verify_submaps(good, good[:-1])
    assert not found.accepted and "cannot be read" in found.why and found.transform is None
    with pytest.raises(ValueError, match="takes"):
        verify_submaps(good[:-1], good)


def test_least_share_is_what_one_asks_for():
    moved = seen_from(hall(2), (0.5, 0.0, 0.0))
    clutter = np.random.default_rng(4).uniform(-6, 6, (200, 2))
    mine, theirs = payload(hall(1)), payload(np.concatenate([moved, clutter]))
    share = verify_submaps(mine, theirs).weight
    assert 0.5 < share < 0.95
    assert verify_submaps(mine, theirs, share=share).accepted
    assert not verify_submaps(mine, theirs, share=share + 0.01).accepted
