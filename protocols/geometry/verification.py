"""Whether two submaps show the same place: payloads in, a verdict out. Needs SciPy (the extra ``demo``).

Both robots come to the same verdict and to inverse transforms, to the last bit on machines of one kind: the
pair is always aligned in the order of its bytes, whoever asks.
"""

from __future__ import annotations

from typing import NamedTuple

from protocols.geometry.icp import LEAST_SHARE, Alignment, align
from protocols.geometry.poses import Pose, inverse
from protocols.geometry.submap import Submap


class Verified(NamedTuple):
    """What the geometry says.

    Attributes:
        accepted: Whether the submaps show the same place.
        why: Why not, in words for a log; empty if accepted.
        transform: The pose of the other keyframe in the own one's frame: x, y (metres), theta (radians). It
            may be there although the pair is refused, for whoever wants to know what a mistake looks like.
        weight: The share of inliers, from 0 to 1.
    """

    accepted: bool
    why: str
    transform: Pose | None
    weight: float


def verify_submaps(own: bytes, other: bytes, *, compass: bool = True, share: float = LEAST_SHARE) -> Verified:
    """Align two submaps and decide.

    Args:
        own: This robot's payload, from :meth:`~protocols.geometry.submap.Submap.to_bytes`.
        other: The peer's, as it came; nothing in it is trusted.
        compass: Whether both robots' walls are given in one sense, as a compass gives them. Without, every
            heading is tried.
        share: Least share of inliers.

    Raises:
        ValueError: the own payload is not a submap. (A peer's that is not one is refused, not raised.)
        ImportError: SciPy is not installed.
    """
    here = Submap.from_bytes(own)
    try:
        there = Submap.from_bytes(other)
    except ValueError as error:
        return Verified(False, f"the peer's submap cannot be read: {error}", None, 0.0)
    turned = other < own
    first, second = (there, here) if turned else (here, there)
    heading = first.walls - second.walls if compass else None
    found = align(first.points, second.points, heading=heading, share=share)
    return Verified(found.accepted, found.why, _seen_from_own(found, turned), found.share)


def _seen_from_own(found: Alignment, turned: bool) -> Pose | None:
    if found.transform is None or not turned:
        return found.transform
    x, y, theta = inverse(found.transform)
    return float(x), float(y), float(theta)
