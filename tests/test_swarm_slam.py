"""Swarm-SLAM's private front end: what it refuses, and what it publishes of an agent's matches."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stack_helpers import BOBS, ROLE, FakeAgent, News, descriptors, unit

from protocols.stacks.closure import as_transform, inverse
from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    InterRobotLoopClosure,
    InterRobotMatch,
    InterRobotMatches,
    Quaternion,
    Transform,
    Vector3,
)
from protocols.stacks.pairing import MOST_WAITING, PATIENCE
from protocols.stacks.swarm_slam import SwarmSlam
from spdz.foundations.errors import TapeExhausted


def adapter(**how):
    said = []
    made = SwarmSlam(FakeAgent(), how.pop("role", ROLE), on_event=said.append, **how)
    return made, made.front, said


def one(keyframe, vector, robot=0):
    return GlobalDescriptors((GlobalDescriptor(keyframe, robot, np.asarray(vector, dtype=float)),))


def test_own_descriptors_reach_the_agent_with_their_stamp():
    slam, agent, said = adapter()
    slam.take(descriptors(3, 4), stamp=1.5)
    assert sorted(agent.added) == [3, 4]
    np.testing.assert_array_equal(agent.added[4][0], unit(4))
    assert agent.added[4][1:] == (b"", 1.5)
    assert slam.counts == {"received": 2, "added": 2} and said == []


BAD = {
    "a wrong dimension": (unit(1, 9), "9 numbers, the plan says 8"),
    "no numbers": ([], "0 numbers, the plan says 8"),
    "NaN": ([math.nan] * 8, "not finite"),
    "infinity": ([1, 2, 3, 4, 5, 6, 7, math.inf], "not finite"),
    "a norm that the agent refuses": (2 * unit(1), "its norm is above 1"),
}


@pytest.mark.parametrize(("vector", "why"), BAD.values(), ids=BAD)
def test_a_bad_descriptor_is_refused_by_name_and_the_next_one_is_taken(vector, why):
    slam, agent, said = adapter()
    slam.take(
        GlobalDescriptors(
            (GlobalDescriptor(7, 0, np.asarray(vector, dtype=float)), *descriptors(8).descriptors)
        )
    )
    assert list(agent.added) == [8]
    assert len(said) == 1 and "keyframe 7" in said[0] and why in said[0]


@pytest.mark.parametrize(
    ("norms", "length", "says"),
    [
        (
            (0.99, 1.0),
            3.0,
            "norm of 3, the plan says 0.99 to 1 (--normalise divides every descriptor by its norm",
        ),
        ((0.99, 1.0), 0.5, "norm of 0.5, the plan says 0.99 to 1 (--normalise"),
        ((2.0, 4.5), 9.0, "norm of 9, the plan says 2 to 4.5 (deal for other norms)"),
    ],
)
def test_a_norm_that_the_plan_is_not_for_is_refused_with_what_to_do(norms, length, says):
    slam, agent, said = adapter(role=replace(ROLE, norms=norms))
    slam.take(one(3, length * unit(3)))
    assert agent.added == {} and len(said) == 1 and says in said[0]


def test_what_the_agent_says_of_a_keyframe_names_it_once():
    slam, _, said = adapter()
    slam.take(one(3, 2 * unit(3)))
    assert said == ["keyframe 3: lidar: its norm is above 1; refused"]


def test_refusals_that_were_not_told_are_counted():
    slam, _, said = adapter()
    for number in range(10):
        slam.take(one(number, unit(3, 5)))
        assert slam.untold == [0, 0, 0, 0, 0, 1, 2, 0, 1, 2][number]
    assert len(said) == 6 and said[-1].endswith("(8 times by now)")


def test_a_refused_keyframe_can_come_again_in_good_order():
    slam, agent, _ = adapter()
    slam.take(one(7, 2 * unit(7)))
    slam.take(one(7, unit(7)))
    assert list(agent.added) == [7]


def test_a_descriptor_of_another_robot_is_refused_and_what_it_means_is_said():
    slam, agent, said = adapter()
    slam.take(descriptors(3, robot=1))
    assert not agent.added
    assert "robot 1" in said[0] and "broadcast in the clear" in said[0]


def test_descriptors_of_a_team_s_bag_are_passed_over_without_a_word():
    slam, agent, said = adapter(team=True)
    slam.take(descriptors(3, robot=1))
    assert not agent.added and not said and slam.counts["of other robots"] == 1


def test_a_keyframe_that_comes_again_changes_nothing():
    slam, _, said = adapter()
    slam.take(descriptors(3))
    slam.take(descriptors(3))
    assert slam.counts["repeated"] == 1 and slam.counts["added"] == 1 and not said


def test_a_keyframe_that_comes_twice_with_two_descriptors_is_refused_by_name():
    slam, agent, said = adapter()
    slam.take(descriptors(3))
    slam.take(one(3, unit(99)))
    np.testing.assert_array_equal(agent.added[3][0], unit(3))
    assert "keyframe 3 came twice" in said[0]


def test_an_agent_that_cannot_keep_a_keyframe_ends_nothing():
    slam, agent, said = adapter()
    agent.add = lambda *_, **__: (_ for _ in ()).throw(TapeExhausted("the disk is full"))
    slam.take(descriptors(3, 4))
    assert len(said) == 2 and "the disk is full" in said[0]


def test_a_flood_of_bad_messages_is_told_ever_more_rarely():
    slam, _, said = adapter()
    for _ in range(1000):
        slam.take(descriptors(1, robot=9))
    assert slam.counts["refused: foreign robot"] == 1000
    assert len(said) == 5 + 7  # one by one, then at 8, 16, ..., 512


def test_an_empty_message_is_nothing():
    slam, agent, said = adapter()
    slam.take(GlobalDescriptors(()))
    assert not agent.added and not said


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e200])
def test_descriptors_of_any_norm_are_normalised_where_that_is_asked_for(scale):
    slam, agent, said = adapter(normalise=True)
    slam.take(one(3, scale * unit(3)))
    np.testing.assert_allclose(agent.added[3][0], unit(3), rtol=1e-12)
    slam.take(one(4, np.zeros(8)))
    assert list(agent.added) == [3] and "zero" in said[0]


# -- what was seen at a keyframe --------------------------------------------------------------------


@pytest.mark.parametrize("first", ["descriptor", "payload"])
def test_a_descriptor_and_what_was_seen_there_are_brought_together_in_either_order(first):
    slam, agent, _ = adapter(payloads=True)
    steps = [lambda: slam.take(descriptors(3), stamp=2.0), lambda: slam.saw(3, b"scan")]
    for step in steps if first == "descriptor" else steps[::-1]:
        assert not agent.added
        step()
    assert agent.added[3][1:] == (b"scan", 2.0)


def test_a_descriptor_without_its_payload_is_refused_by_name_after_a_while_and_may_come_again():
    now = [0.0]
    slam, agent, said = adapter(payloads=True, clock=lambda: now[0])
    slam.take(descriptors(3))
    slam.late()
    assert not said
    now[0] = PATIENCE + 1
    slam.late()
    assert "keyframe 3 came without what was seen there" in said[0]
    slam.saw(3, b"scan")
    assert not agent.added
    slam.take(descriptors(3))
    assert agent.added[3][1] == b"scan"


def test_what_waits_is_bounded():
    slam, agent, _ = adapter(payloads=True)
    for keyframe in range(3 * MOST_WAITING):
        slam.saw(keyframe, b"scan")
        slam.take(descriptors(10_000 + keyframe))
        slam.late()
    report = slam.report(agent.status())
    assert report["counts"]["waiting for keyframe data"] == MOST_WAITING
    slam.take(descriptors(0, 3 * MOST_WAITING - 1))
    assert list(agent.added) == [3 * MOST_WAITING - 1]


# -- what is published ------------------------------------------------------------------------------


def matches_of(messages):
    return [match for one in messages if isinstance(one, InterRobotMatches) for match in one.matches]


def closures_of(messages):
    return [one for one in messages if isinstance(one, InterRobotLoopClosure)]


def test_a_verified_match_is_published_with_the_plan_s_ids_and_the_threshold_as_its_weight():
    slam, _, _ = adapter()
    (message,) = slam.found(News(1, 1))
    assert message == InterRobotMatches(0, (InterRobotMatch(0, 3, 1, 5, 0.8),))


def test_both_robots_publish_one_match_alike():
    hers, his = adapter()[0], adapter(role=BOBS)[0]
    mine = matches_of(hers.found(News(1, 1, "bob", 3, 5, weight=0.9)))
    assert mine == matches_of(his.found(News(1, 1, "alice", 5, 3, weight=0.9)))


def test_the_verification_s_weight_is_taken_where_it_gave_one_and_fits_a_float32():
    slam, _, _ = adapter()
    assert matches_of(slam.found(News(1, 1, weight=0.97)))[0].weight == 0.97
    assert math.isfinite(np.float32(matches_of(slam.found(News(2, 2, keyframe=4, weight=1e300)))[0].weight))


def test_each_keyframe_has_one_match_with_each_peer():
    slam, _, _ = adapter()
    assert matches_of(slam.found(News(1, 1, "bob", 3, 5)))
    assert not matches_of(slam.found(News(2, 2, "bob", 3, 6)))
    assert matches_of(slam.found(News(3, 3, "carol", 3, 6)))
    assert matches_of(slam.found(News(4, 4, "bob", 2, 6)))
    assert slam.counts["published"] == 3 and slam.counts["further"] == 1


def test_a_candidate_is_published_only_where_that_is_asked_for_and_once_both_keyframes_are_known():
    states = [News(1, 1, peer_keyframe=None, state="candidate"), News(2, 1, state="rejected")]
    careful, eager = adapter()[0], adapter(announce="candidate")[0]
    assert [matches_of(careful.found(news)) for news in states] == [[], []]
    assert [len(matches_of(eager.found(news))) for news in states] == [0, 1]


def test_news_that_was_read_before_is_not_published_again():
    slam, _, _ = adapter()
    assert len(slam.found(News(1, 1, transform=(0, 0, 0)))) == 2
    assert not slam.found(News(1, 1, transform=(0, 0, 0)))


def test_a_withheld_match_is_counted_and_not_published():
    slam, _, _ = adapter()
    assert slam.found(News(1, 1, state="withheld")) == []
    assert slam.counts["withheld"] == 1


@pytest.mark.parametrize("peer", ["alice", "mallory"])
def test_a_keyframe_never_matches_one_of_its_own_robot_or_of_a_stranger(peer):
    slam, _, said = adapter()
    assert slam.found(News(1, 1, peer)) == []
    assert repr(peer) in said[0]


def test_a_peer_s_keyframe_that_no_message_can_hold_ends_nothing():
    slam, _, said = adapter()
    assert slam.found(News(1, 1, peer_keyframe=1 << 40)) == []
    assert "is not published" in said[0]
    assert slam.found(News(2, 2))


QUARTER = Quaternion(z=math.sqrt(0.5), w=math.sqrt(0.5))


def test_a_verified_transform_becomes_a_loop_closure():
    slam, _, _ = adapter()
    (closure,) = closures_of(slam.found(News(1, 1, transform=(1.0, 2.0, math.pi / 2))))
    assert (closure.robot0_id, closure.robot0_keyframe_id) == (0, 3)
    assert (closure.robot1_id, closure.robot1_keyframe_id) == (1, 5)
    assert closure.success
    assert closure.transform.translation == Vector3(1.0, 2.0, 0.0)
    assert closure.transform.rotation.z == pytest.approx(QUARTER.z)


def test_the_robot_of_the_larger_id_turns_the_transform_round():
    his, _, _ = adapter(role=BOBS)
    (closure,) = closures_of(his.found(News(1, 1, "alice", 5, 3, transform=(1.0, 2.0, math.pi / 2))))
    assert (closure.robot0_id, closure.robot0_keyframe_id) == (0, 3)
    assert (closure.robot1_id, closure.robot1_keyframe_id) == (1, 5)
    moved = closure.transform.translation
    assert (moved.x, moved.y) == pytest.approx((-2.0, 1.0))  # -R^T t
    assert closure.transform.rotation.z == pytest.approx(-QUARTER.z)


def test_a_rejected_match_is_a_loop_closure_that_failed():
    slam, _, _ = adapter()
    (closure,) = closures_of(slam.found(News(1, 1, state="rejected", transform=None)))
    assert not closure.success and closure.transform == Transform()


def test_on_a_shared_graph_one_of_the_two_robots_publishes_the_closure():
    hers, his = adapter(shared=True)[0], adapter(role=BOBS, shared=True)[0]
    assert closures_of(hers.found(News(1, 1, "bob", 3, 5, transform=(0, 0, 0))))
    assert not closures_of(his.found(News(1, 1, "alice", 5, 3, transform=(0, 0, 0))))


BAD_TRANSFORMS = {
    "a length": ((1.0, 2.0), "3 or 7 numbers, not 2"),
    "a quaternion": ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5), "has norm 0.5"),
    "a number": ((0.0, math.nan, 0.0), "not finite"),
}


@pytest.mark.parametrize(("transform", "why"), BAD_TRANSFORMS.values(), ids=BAD_TRANSFORMS)
def test_a_transform_that_is_none_is_refused_and_the_match_is_published_all_the_same(transform, why):
    slam, _, said = adapter()
    messages = slam.found(News(1, 1, transform=transform))
    assert matches_of(messages) and not closures_of(messages)
    assert why in said[0]


def test_a_transform_turned_round_twice_is_itself():
    pose = (1.0, -2.0, 0.5, *(np.array([1.0, 2.0, 3.0, 4.0]) / math.sqrt(30)))
    there = as_transform(pose)
    back = inverse(inverse(there))
    assert back.translation.x == pytest.approx(there.translation.x)
    assert back.translation.z == pytest.approx(there.translation.z)
    assert back.rotation.y == pytest.approx(there.rotation.y)
    alone = inverse(replace(there, rotation=Quaternion())).translation
    assert (alone.x, alone.y, alone.z) == (-1.0, 2.0, -0.5)


def test_the_report_says_what_came_and_for_each_peer_why_nothing_matched():
    slam, agent, _ = adapter()
    agent.why = {"bob": "peer-absent", "carol": "below-threshold"}
    slam.take(descriptors(3))
    slam.take(descriptors(4, robot=1))
    report = slam.report(agent.status())
    assert report["counts"] == {"received": 2, "added": 1, "refused: foreign robot": 1}
    assert report["why"]["carol"]["code"] == "below-threshold"
    assert report["matches"] == {"bob": {"verified": 2}, "carol": {"verified": 2}}
