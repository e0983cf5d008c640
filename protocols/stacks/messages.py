"""The messages of Swarm-SLAM that its private front end needs, described once.

Each is a frozen dataclass; what its fields are on the wire stands beside their Python types. From these come
rosbags' types by way of the ``.msg`` text (:mod:`protocols.stacks.codec`), and Cyclone's types
(:mod:`protocols.stacks.dds`).

Source: the interface package ``cslam_common_interfaces`` of Swarm-SLAM (Lajoie and Beltrame, RA-L 2024), and
ROS 2's ``builtin_interfaces``, ``std_msgs``, ``geometry_msgs`` and ``sensor_msgs``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import FloatArray

UInt8 = Annotated[int, "uint8"]
Int32 = Annotated[int, "int32"]
UInt32 = Annotated[int, "uint32"]
Float32 = Annotated[float, "float32"]
Float64 = Annotated[float, "float64"]
Bool = Annotated[bool, "bool"]
String = Annotated[str, "string"]
Octets = Annotated[npt.NDArray[np.uint8], "uint8[]"]
Float64s = Annotated[FloatArray, "float64[]"]


@dataclass(frozen=True, slots=True, eq=False)
class GlobalDescriptor:
    """The place descriptor of one keyframe: what a robot would broadcast, and here keeps to itself."""

    keyframe_id: UInt32
    robot_id: UInt32
    descriptor: Float64s


@dataclass(frozen=True, slots=True, eq=False)
class GlobalDescriptors:
    """What the descriptors' topic carries: some keyframes at a time."""

    descriptors: tuple[GlobalDescriptor, ...]


@dataclass(frozen=True, slots=True)
class InterRobotMatch:
    """Two keyframes of two robots that show one place."""

    robot0_id: UInt32
    robot0_keyframe_id: UInt32
    robot1_id: UInt32
    robot1_keyframe_id: UInt32
    weight: Float32


@dataclass(frozen=True, slots=True)
class InterRobotMatches:
    """What the matches' topic carries: some matches that one robot has found."""

    robot_id: UInt32
    matches: tuple[InterRobotMatch, ...]


@dataclass(frozen=True, slots=True)
class Vector3:
    """A translation in metres."""

    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass(frozen=True, slots=True)
class Quaternion:
    """A rotation, of norm 1."""

    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0
    w: Float64 = 1.0


@dataclass(frozen=True, slots=True)
class Transform:
    """A pose in another frame."""

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@dataclass(frozen=True, slots=True)
class InterRobotLoopClosure:
    """What a verification gave: the pose of robot 1's keyframe in the frame of robot 0's."""

    robot0_keyframe_id: UInt32
    robot0_id: UInt32
    robot1_keyframe_id: UInt32
    robot1_id: UInt32
    success: Bool
    transform: Transform


@dataclass(frozen=True, slots=True)
class Time:
    """A stamp."""

    sec: Int32 = 0
    nanosec: UInt32 = 0


@dataclass(frozen=True, slots=True)
class Header:
    """When and in which frame."""

    stamp: Time
    frame_id: String


@dataclass(frozen=True, slots=True)
class PointField:
    """Where one number of a point lies."""

    name: String
    offset: UInt32
    datatype: UInt8
    count: UInt32


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud2:
    """A point cloud."""

    header: Header
    height: UInt32
    width: UInt32
    fields: tuple[PointField, ...]
    is_bigendian: Bool
    point_step: UInt32
    row_step: UInt32
    data: Octets
    is_dense: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A picture."""

    header: Header
    height: UInt32
    width: UInt32
    encoding: String
    is_bigendian: UInt8
    step: UInt32
    data: Octets


@dataclass(frozen=True, slots=True, eq=False)
class KeyframePointCloud:
    """What a robot with a LiDAR saw at a keyframe."""

    id: UInt32
    pointcloud: PointCloud2


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRGB:
    """What a robot with a camera saw at a keyframe."""

    id: UInt32
    image: Image


PACKAGES: dict[str, tuple[type, ...]] = {
    "cslam_common_interfaces": (
        GlobalDescriptor,
        GlobalDescriptors,
        InterRobotMatch,
        InterRobotMatches,
        InterRobotLoopClosure,
        KeyframePointCloud,
        KeyframeRGB,
    ),
    "builtin_interfaces": (Time,),
    "std_msgs": (Header,),
    "geometry_msgs": (Vector3, Quaternion, Transform),
    "sensor_msgs": (PointField, PointCloud2, Image),
}
"""The ROS package of every message."""

PUBLISHED = (InterRobotMatches, InterRobotLoopClosure)
"""All that ever goes out over DDS or Zenoh. The rest is read, or goes over the agents' TLS sessions."""

KEYFRAMES: dict[str, type] = {kind.__name__: kind for kind in (KeyframePointCloud, KeyframeRGB)}
"""What a payload may be, by name."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message on the wire.

    Attributes:
        name: Its name.
        base: A primitive type of ROS, such as ``float64``, or a message.
        many: Whether it is a sequence.
    """

    name: str
    base: str | type
    many: bool


def wire_fields(kind: type) -> Iterator[Field]:
    """The fields of a message in the order of the wire."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        hint: Any = hints[field.name]
        if get_origin(hint) is tuple:
            yield Field(field.name, get_args(hint)[0], True)
        elif get_origin(hint) is Annotated:
            name = str(get_args(hint)[1])
            yield Field(field.name, name.removesuffix("[]"), name.endswith("[]"))
        else:
            yield Field(field.name, hint, False)


def package_of(kind: type) -> str:
    """The ROS package of a message."""
    return next(package for package, kinds in PACKAGES.items() if kind in kinds)


def ros_name(kind: type) -> str:
    """As ROS 2 and bags name it: ``package/msg/Type``."""
    return f"{package_of(kind)}/msg/{kind.__name__}"


def dds_name(kind: type) -> str:
    """As ROS 2 names it on DDS and Zenoh: ``package::msg::dds_::Type_``."""
    return f"{package_of(kind)}::msg::dds_::{kind.__name__}_"


def definition(kind: type) -> str:
    """The text of the message's ``.msg`` file."""
    lines = []
    for field in wire_fields(kind):
        base = (
            field.base if isinstance(field.base, str) else f"{package_of(field.base)}/{field.base.__name__}"
        )
        lines.append(f"{base}{'[]' if field.many else ''} {field.name}\n")
    return "".join(lines)
