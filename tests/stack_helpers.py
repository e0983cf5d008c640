"""A robot's agent as the adapters see it, without one; and messages to feed it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protocols.stacks.messages import (
    GlobalDescriptor,
    GlobalDescriptors,
    Header,
    KeyframePointCloud,
    PointCloud2,
    PointField,
    Time,
)
from protocols.stacks.role import Role

ROLE = Role("alice", {"alice": 0, "bob": 1, "carol": 4}, "lidar", 8, 0.8)
BOBS = Role("bob", ROLE.ids, "lidar", 8, 0.8)


@dataclass(frozen=True)
class News:
    """What an agent tells of a match."""

    number: int
    match: int
    peer: str = "bob"
    keyframe: int | None = 3
    peer_keyframe: int | None = 5
    state: str = "verified"
    transform: tuple[float, ...] | None = None
    weight: float | None = None


@dataclass
class FakeAgent:
    """Keeps what it is given, refuses norms above 1, and tells what it is told to."""

    added: dict[int, tuple[np.ndarray, bytes, float | None]] = field(default_factory=dict)
    news: list[News] = field(default_factory=list)
    read: int = 0
    why: dict[str, str] = field(default_factory=dict)

    def add(
        self, keyframe: int, descriptors: Mapping[str, Any], payload: bytes = b"", stamp: float | None = None
    ) -> None:
        (vector,) = descriptors.values()
        assert list(descriptors) == ["lidar"]
        if np.linalg.norm(vector) > 1.0001:
            raise ValueError(f"keyframe {keyframe}: lidar: its norm is above 1")
        self.added[keyframe] = np.array(vector), payload, stamp

    def matches(self, timeout: float) -> Iterator[News]:
        for news in list(self.news):
            if news.number > self.read:
                yield news
                self.read = news.number

    def status(self) -> dict[str, Any]:
        why = [{"peer": peer, "why": {"code": text, "text": text}} for peer, text in self.why.items()]
        more = {"gallery": "lidar", "held": 1, "peer_held": 1, "settled": True, "matches": {"verified": 2}}
        more["state"] = "connected"
        return {"galleries": [{**one, **more} for one in why]}


def unit(seed: int, dim: int = 8) -> np.ndarray:
    vector = np.random.default_rng(seed).standard_normal(dim)
    return vector / np.linalg.norm(vector)


def descriptors(*keyframes: int, robot: int = 0, dim: int = 8) -> GlobalDescriptors:
    return GlobalDescriptors(tuple(GlobalDescriptor(one, robot, unit(one, dim)) for one in keyframes))


def cloud(keyframe: int, points: int = 5) -> KeyframePointCloud:
    data = np.random.default_rng(keyframe).integers(0, 256, 12 * points, dtype=np.uint8)
    fields = tuple(PointField(name, 4 * place, 7, 1) for place, name in enumerate("xyz"))
    header = Header(Time(keyframe, 5), "odom")
    return KeyframePointCloud(
        keyframe, PointCloud2(header, 1, points, fields, False, 12, 12 * points, data, True)
    )
