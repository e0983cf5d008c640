"""Swarm-SLAM's messages: one description, the same bytes from Cyclone, from rosbags, and over Zenoh."""

import numpy as np
import pytest
from stack_helpers import cloud, descriptors

from protocols.stacks.messages import (
    KEYFRAMES,
    PACKAGES,
    GlobalDescriptor,
    GlobalDescriptors,
    Header,
    Image,
    InterRobotLoopClosure,
    InterRobotMatch,
    InterRobotMatches,
    KeyframeRGB,
    Quaternion,
    Time,
    Transform,
    Vector3,
    dds_name,
    definition,
    ros_name,
)

pytest.importorskip("rosbags", reason="needs rosbags: pip install rosbags")

from protocols.stacks.codec import Codec, from_foreign

SAMPLES = {
    "descriptors": descriptors(3, 4, dim=512),
    "no descriptors": GlobalDescriptors(()),
    "a descriptor of no numbers": GlobalDescriptors((GlobalDescriptor(1, 2, np.zeros(0)),)),
    "matches": InterRobotMatches(2, (InterRobotMatch(0, 1, 2, 3, 0.5), InterRobotMatch(2, 4, 4, 0, 0.25))),
    "a loop closure": InterRobotLoopClosure(
        1, 0, (1 << 32) - 1, 2, True, Transform(Vector3(1.5, -2, 3), Quaternion(0, 0, 0.6, 0.8))
    ),
    "a cloud": cloud(7),
    "a picture": KeyframeRGB(
        9, Image(Header(Time(-5, 7), "camera"), 2, 3, "mono8", 0, 3, np.arange(6, dtype=np.uint8))
    ),
}


@pytest.mark.parametrize("message", SAMPLES.values(), ids=SAMPLES)
def test_cyclone_writes_the_bytes_that_rosbags_writes(message):
    pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for this machine")
    from protocols.stacks.dds import idl_types, to_idl

    made = idl_types(type(message))
    written = to_idl(message, made).serialize(use_version_2=False)
    assert written == Codec().encode(message)


@pytest.mark.parametrize("message", SAMPLES.values(), ids=SAMPLES)
def test_what_was_written_is_read_as_it_was(message):
    codec = Codec()
    read = codec.decode(type(message), codec.encode(message))
    assert codec.encode(read) == codec.encode(message)
    assert type(read) is type(message)


def test_what_cyclone_read_becomes_one_of_our_messages():
    pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for this machine")
    from protocols.stacks.dds import idl_types

    message = SAMPLES["descriptors"]
    made = idl_types(GlobalDescriptors)[GlobalDescriptors]
    read = from_foreign(GlobalDescriptors, made.deserialize(Codec().encode(message)))
    np.testing.assert_array_equal(read.descriptors[1].descriptor, message.descriptors[1].descriptor)
    assert read.descriptors[1].keyframe_id == 4
    assert read.descriptors[1].descriptor.dtype == np.float64


def test_the_descriptor_s_bytes_are_those_of_cdr():
    """Encapsulation, then sequence length, two ids, length, and doubles aligned to eight bytes."""
    message = GlobalDescriptors((GlobalDescriptor(0x01020304, 5, np.array([1.0, -2.0])),))
    expected = "00010000 01000000 04030201 05000000 02000000 000000000000f03f 00000000000000c0"
    written = Codec().encode(message)
    assert written[:20].hex() == expected.replace(" ", "")[:40]
    assert written[20:] == np.array([1.0, -2.0]).tobytes()


def test_a_message_s_text_is_that_of_its_msg_file():
    assert definition(GlobalDescriptor) == "uint32 keyframe_id\nuint32 robot_id\nfloat64[] descriptor\n"
    assert (
        definition(InterRobotMatches)
        == "uint32 robot_id\ncslam_common_interfaces/InterRobotMatch[] matches\n"
    )


def test_messages_are_named_as_ros_2_names_them():
    assert ros_name(GlobalDescriptors) == "cslam_common_interfaces/msg/GlobalDescriptors"
    assert dds_name(GlobalDescriptors) == "cslam_common_interfaces::msg::dds_::GlobalDescriptors_"


def test_ros_s_own_messages_are_described_as_ros_describes_them():
    from rosbags.typesys import Stores, get_typestore

    theirs, ours = get_typestore(Stores.ROS2_HUMBLE), Codec()
    for package, kinds in PACKAGES.items():
        for kind in kinds if package != "cslam_common_interfaces" else ():
            assert ours.type_hash(kind) == theirs.hash_rihs01(ros_name(kind)), kind


def damaged(data, seed):
    """A message cut off, or with some bytes of its beginning changed."""
    generator = np.random.default_rng(seed)
    if seed % 2:
        return data[: generator.integers(len(data))]
    changed = bytearray(data)
    for place in generator.integers(0, min(len(data), 64), 3):
        changed[place] = generator.integers(256)
    return bytes(changed)


@pytest.mark.parametrize("name", ["descriptors", "matches", "a cloud"])
def test_damaged_bytes_are_a_value_error_or_another_message(name):
    codec, message, refused = Codec(), SAMPLES[name], 0
    data = codec.encode(message)
    for seed in range(400):
        try:
            codec.decode(type(message), damaged(data, seed))
        except ValueError as error:
            refused += 1
            assert type(message).__name__ in str(error)
    assert refused > 150


def test_a_promise_of_more_numbers_than_there_are_takes_no_memory():
    data = bytearray(Codec().encode(GlobalDescriptors((GlobalDescriptor(1, 2, np.zeros(4)),))))
    data[16:20] = b"\xff\xff\xff\x7f"
    with pytest.raises(ValueError, match="no GlobalDescriptors"):
        Codec().decode(GlobalDescriptors, bytes(data))


def test_payloads_are_the_messages_of_keyframe_data():
    assert list(KEYFRAMES) == ["KeyframePointCloud", "KeyframeRGB"]
