"""Topics: names as ROS resolves them, and what DDS and Zenoh make of them."""

import pytest

from protocols.mission import Mission
from protocols.stacks.messages import InterRobotMatches
from protocols.stacks.role import role_of
from protocols.stacks.topics import bridge_key, check_domain, dds_topic, remapped, rmw_key, topics


def test_relative_topics_are_in_the_namespace_and_the_team_s_are_not():
    names = topics("/r0")
    assert names.descriptors == "/r0/cslam/global_descriptors"
    assert names.keyframes == "/r0/cslam/keyframe_data"
    assert names.matches == "/cslam/inter_robot_matches"
    assert names.closures == "/cslam/inter_robot_loop_closure"
    assert topics().descriptors == "/cslam/global_descriptors"


def test_a_topic_can_be_remapped_as_in_ros():
    names = topics("/r0", **remapped(["cslam/global_descriptors:=own", "/cslam/inter_robot_matches:=/m"]))
    assert (names.descriptors, names.matches) == ("/r0/own", "/m")


@pytest.mark.parametrize("rule", ["cslam/global_descriptors", "cslam/pose_graph:=/x", ":=", "a=b"])
def test_a_remapping_of_anything_else_is_refused_by_name(rule):
    with pytest.raises(ValueError, match="NAME:=TOPIC"):
        remapped([rule])


@pytest.mark.parametrize("name", ["", "/", "a b", "1a", "a//b", "a/", "ü", "a-b", "x" * 9 + "\n"])
def test_a_name_that_ros_does_not_allow_is_refused(name):
    with pytest.raises(ValueError, match="a topic is words"):
        topics(descriptors=name)


@pytest.mark.parametrize("namespace", ["r0", "", "/r 0", "//", "/r0/"])
def test_a_namespace_that_ros_does_not_allow_is_refused(namespace):
    with pytest.raises(ValueError, match="a namespace is / or like /r0"):
        topics(namespace)


@pytest.mark.parametrize("domain", [-1, 233])
def test_a_domain_out_of_range_is_refused(domain):
    with pytest.raises(ValueError, match="0 to 232"):
        check_domain(domain)


def test_a_topic_has_its_name_on_dds_under_rmw_zenoh_and_behind_the_bridge():
    name = "/cslam/inter_robot_matches"
    assert dds_topic(name) == "rt/cslam/inter_robot_matches"
    kind = "cslam_common_interfaces::msg::dds_::InterRobotMatches_"
    assert rmw_key(name, InterRobotMatches, 3, "*") == f"3/cslam/inter_robot_matches/{kind}/*"
    assert bridge_key(name) == "cslam/inter_robot_matches"


PLAN = """
[[agents]]
name = "alice"
id = 7
[[agents]]
name = "bob"
[descriptors.lidar]
score = "S10"
dim = 8
threshold = 0.8
keyframes = 16
"""
SECOND = """
[descriptors.camera]
score = "S6"
dim = 4
threshold = 0.5
keyframes = 16
"""


def mission(tmp_path, text):
    file = tmp_path / "mission.toml"
    file.write_text(text)
    return Mission.load(file)


def test_a_role_is_what_the_plan_says_of_the_robot(tmp_path):
    role = role_of(mission(tmp_path, PLAN), "alice")
    assert (role.id, role.descriptor, role.dim, role.weight) == (7, "lidar", 8, 0.8)
    assert role.ids == {"alice": 7, "bob": 1}


def test_of_several_descriptors_one_is_named(tmp_path):
    plan = mission(tmp_path, PLAN + SECOND)
    with pytest.raises(ValueError, match=r"--descriptor which one .* lidar, camera"):
        role_of(plan, "alice")
    role = role_of(plan, "alice", "camera")
    assert (role.dim, role.weight) == (4, 1.0)  # a distance is no weight


def test_what_needs_several_descriptors_at_once_is_refused(tmp_path):
    plan = mission(tmp_path, PLAN + SECOND + '[places.everywhere]\nof = ["lidar", "camera"]\nrule = "any"\n')
    with pytest.raises(ValueError, match="everywhere compares several"):
        role_of(plan, "alice", "camera")
