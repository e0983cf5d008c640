"""A 2-D laser submap as a payload: the points that a robot saw around a keyframe, in the keyframe's frame.

Layout, little-endian: the 8 bytes ``SUBMAP2D``, the version (uint32, 1), the number n of points (uint32), the
direction of the walls (float64, radians), then n times x and y (float32, metres). Nothing else: a robot that
thins its points first (:func:`thin`) sends them in the order of the squares that hold them, so that neither
the order in which it saw them nor where it stood for each is told.

Who reads a payload trusts nothing in it: its length is bounded and exact, its numbers are finite and within
the range of a submap.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import FloatArray

MAGIC = b"SUBMAP2D"
VERSION = 1
HEADER = struct.Struct("<8sIId")

SQUARE = 0.05
"""Side in metres of the squares of which one point each is kept."""
FARTHEST = 100.0
"""Metres from the keyframe beyond which a submap has no points."""
MOST_POINTS = 50_000
MOST_BYTES = HEADER.size + 8 * MOST_POINTS


@dataclass(frozen=True, slots=True, eq=False)
class Submap:
    """What a robot saw around a keyframe.

    Attributes:
        points: ``(n, 2)``, metres, in the keyframe's frame: x ahead, y to the left.
        walls: Direction of the walls in that frame, in radians. It is a hint from which an alignment starts,
            and what a descriptor that is turned to the walls needs; without walls, 0.
    """

    points: FloatArray = field(repr=False)
    walls: float = 0.0

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 2:
            raise ValueError(f"a submap's points have shape (n, 2), got {self.points.shape}")
        if len(self.points) > MOST_POINTS:
            raise ValueError(f"a submap has at most {MOST_POINTS:,} points, got {len(self.points):,}")
        if not (np.abs(self.points) <= FARTHEST).all():
            raise ValueError(
                f"a submap's points lie within {FARTHEST:.0f} m of the keyframe, each a finite number"
            )
        if not abs(self.walls) <= 2 * np.pi:
            raise ValueError(f"a submap's walls have a direction within 2 pi, got {self.walls}")

    def to_bytes(self) -> bytes:
        """The payload; points are rounded to float32 (a micrometre at 20 m)."""
        points = np.ascontiguousarray(self.points, dtype="<f4")
        return HEADER.pack(MAGIC, VERSION, len(points), self.walls) + points.tobytes()

    @staticmethod
    def from_bytes(payload: bytes) -> Submap:
        """Read a payload.

        Raises:
            ValueError: it is not a whole submap of this version, or a number in it is not one of a submap.
        """
        if len(payload) > MOST_BYTES:
            raise ValueError(f"a submap takes at most {MOST_BYTES:,} bytes, got {len(payload):,}")
        if len(payload) < HEADER.size or payload[: len(MAGIC)] != MAGIC:
            raise ValueError(f"these {len(payload):,} bytes are not a 2-D submap: they do not start like one")
        _, version, count, walls = HEADER.unpack_from(payload)
        if version != VERSION:
            raise ValueError(f"a submap of version {version} came, and {VERSION} is read here")
        if len(payload) != HEADER.size + 8 * count:
            raise ValueError(
                f"a submap of {count:,} points takes {HEADER.size + 8 * count:,} bytes, got {len(payload):,}"
            )
        points = np.frombuffer(payload, dtype="<f4", offset=HEADER.size).reshape(-1, 2)
        with np.errstate(
            invalid="ignore"
        ):  # a signalling NaN warns when it is cast; it is refused as any other
            return Submap(points.astype(np.float64), walls)


def thin(points: npt.NDArray[np.float64], square: float = SQUARE) -> FloatArray:
    """One point of each occupied square, in the order of the squares.

    Args:
        points: ``(n, 2)``, metres, finite.
        square: Side of the squares in metres.
    """
    if len(points) == 0:
        return points
    index = np.floor(points / square).astype(np.int64)
    index -= index.min(axis=0)
    _, first = np.unique(index[:, 0] * (index[:, 1].max() + 1) + index[:, 1], return_index=True)
    return np.asarray(points[first])
