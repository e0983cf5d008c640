"""Descriptors, and what was seen at their keyframes, come on two topics: the first waits for the other."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field

from spdz.foundations.types import FloatArray

MOST_WAITING = 100
"""Of either kind; as deep as Swarm-SLAM's queues."""

MOST_BYTES = 1 << 27
"""Of payloads that wait."""

PATIENCE = 10.0
"""Seconds that a descriptor waits for its payload."""


@dataclass(frozen=True, slots=True)
class Waiting:
    """A descriptor that waits."""

    vector: FloatArray = field(repr=False)
    stamp: float | None
    since: float


@dataclass(slots=True)
class Pairing:
    """Brings the two together by the keyframe's number."""

    _payloads: OrderedDict[int, bytes] = field(default_factory=OrderedDict)
    _waiting: OrderedDict[int, Waiting] = field(default_factory=OrderedDict)

    def __len__(self) -> int:
        return len(self._waiting)

    def descriptor(self, keyframe: int, vector: FloatArray, stamp: float | None, now: float) -> bytes | None:
        """The payload of a keyframe; None if it is not there yet, and the descriptor waits for it."""
        payload = self._payloads.pop(keyframe, None)
        if payload is None:
            self._waiting[keyframe] = Waiting(vector, stamp, now)
        return payload

    def payload(self, keyframe: int, payload: bytes) -> Waiting | None:
        """The descriptor that waited for a payload; None if none did, and the payload waits."""
        waiting = self._waiting.pop(keyframe, None)
        if waiting is None:
            self._payloads[keyframe] = payload
            while len(self._payloads) > MOST_WAITING or sum(map(len, self._payloads.values())) > MOST_BYTES:
                self._payloads.popitem(last=False)
        return waiting

    def late(self, now: float) -> Iterator[int]:
        """Keyframes whose descriptors have waited too long or are too many; they wait no more."""
        while self._waiting:
            keyframe, oldest = next(iter(self._waiting.items()))
            if now - oldest.since <= PATIENCE and len(self._waiting) <= MOST_WAITING:
                return
            del self._waiting[keyframe]
            yield keyframe
