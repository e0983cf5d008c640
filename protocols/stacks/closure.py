"""Verified transforms as Swarm-SLAM has them.

A verification gives the pose of the peer's keyframe in the frame of the own one, as ``(x, y, yaw)`` or
``(x, y, z, qx, qy, qz, qw)``: metres, radians, a quaternion of norm 1. The back end of Swarm-SLAM reads a
loop closure's transform as the pose of robot 1's keyframe in the frame of robot 0's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from protocols.stacks.messages import Quaternion, Transform, Vector3

_SLACK = 1e-3
"""How far a quaternion's norm may be from 1: it is normalised, not refused, within it."""


def as_transform(pose: Sequence[float]) -> Transform:
    """A pose as a message.

    Args:
        pose: ``(x, y, yaw)`` or ``(x, y, z, qx, qy, qz, qw)``.

    Raises:
        ValueError: for another length, a number that is not finite, or a quaternion that is none.
    """
    if not all(math.isfinite(number) for number in pose):
        raise ValueError("the transform has a number that is not finite")
    if len(pose) == 3:
        x, y, yaw = (float(number) for number in pose)
        return Transform(Vector3(x, y, 0.0), Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2)))
    if len(pose) != 7:
        raise ValueError(
            f"a transform is (x, y, yaw) or (x, y, z, qx, qy, qz, qw): 3 or 7 numbers, not {len(pose)}"
        )
    norm = math.hypot(*pose[3:])
    if abs(norm - 1) > _SLACK:
        raise ValueError(f"the transform's quaternion has norm {norm:g}, not 1")
    x, y, z = (float(number) for number in pose[:3])
    qx, qy, qz, qw = (float(number) / norm for number in pose[3:])
    return Transform(Vector3(x, y, z), Quaternion(qx, qy, qz, qw))


def inverse(transform: Transform) -> Transform:
    """The pose of the one frame in the other, the other way round: R^T and -R^T t."""
    moved, turned = transform.translation, transform.rotation
    back = Quaternion(-turned.x, -turned.y, -turned.z, turned.w)
    x, y, z = _turn(back, (-moved.x, -moved.y, -moved.z))
    return Transform(Vector3(x, y, z), back)


def _turn(by: Quaternion, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion: v + w t + u x t with t = 2 u x v."""
    u = (by.x, by.y, by.z)
    t = tuple(2 * number for number in _cross(u, vector))
    v = _cross(u, (t[0], t[1], t[2]))
    return (
        vector[0] + by.w * t[0] + v[0],
        vector[1] + by.w * t[1] + v[1],
        vector[2] + by.w * t[2] + v[2],
    )


def _cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
