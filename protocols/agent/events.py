"""What an agent tells: matches, which are durable and numbered, and all else that happens to it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from spdz.channels.telling import printable
from spdz.foundations.types import Json

MATCH_STATES = ("candidate", "verified", "rejected", "withheld")
"""A True bit; then what became of it."""

_MOST_WAITING = 10_000
"""Events kept for a reader that does not read; older ones are dropped, matches can be read again."""


@dataclass(frozen=True, slots=True)
class Match:
    """A pair of keyframes that the two robots' descriptors say show the same place.

    Attributes:
        number: Of this news, ascending and stable over restarts: a reader can drop what it has seen.
        match: Of the match, which makes news more than once.
        peer: The other robot.
        gallery: What was compared.
        keyframe: This robot's keyframe; None if the agent's own records of it are lost.
        peer_keyframe: The peer's, once it has shown it.
        state: ``"candidate"``, then ``"verified"``, ``"rejected"`` or ``"withheld"``.
        why: Why it was not verified.
        transform: As the verification gave it.
        weight: As the verification gave it.
        peer_state: What the peer's verification said, once it has told.
    """

    number: int
    match: int
    peer: str
    gallery: str
    keyframe: int | None
    peer_keyframe: int | None
    state: str
    why: str = ""
    transform: tuple[float, ...] | None = None
    weight: float | None = None
    peer_state: str | None = None

    def __str__(self) -> str:
        theirs = (
            f"one of {self.peer}'s" if self.peer_keyframe is None else f"{self.peer}'s {self.peer_keyframe}"
        )
        reason = f" ({printable(self.why)})" if self.why else ""
        return f"{self.state}: {self.gallery} keyframe {self.keyframe} and {theirs}{reason}"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes:
        name: Its kind, for machines.
        text: A sentence for people, without a period.
        peer: The robot that it concerns, if one.
        gallery: The gallery that it concerns, if one.
        fields: More, for machines.
    """

    name: str
    text: str
    peer: str = ""
    gallery: str = ""
    fields: Mapping[str, Json] = field(default_factory=dict)

    @classmethod
    def of(cls, match: Match) -> Event:
        """News of a match as an event."""
        fields = {key: value for key, value in asdict(match).items() if key not in ("peer", "gallery")}
        return cls(match.state, str(match), match.peer, match.gallery, fields)

    def as_json(self) -> dict[str, Any]:
        """JSON-ready."""
        where = {key: value for key, value in (("peer", self.peer), ("gallery", self.gallery)) if value}
        return {"event": self.name, "text": self.text, **where, **self.fields}


class Hub:
    """Hands events on: to a callback at once, and to readers in order.

    Args:
        on_event: Called with every event, by whichever thread it happens in. What it raises is not told
            and ends nothing.
    """

    def __init__(self, on_event: Callable[[Event], None] | None = None) -> None:
        self._on_event = on_event
        self._waiting: deque[Event] = deque(maxlen=_MOST_WAITING)
        self._changed = threading.Condition()
        self._ended = False

    def tell(self, event: Event) -> None:
        """Hand on one event."""
        with self._changed:
            self._waiting.append(event)
            self._changed.notify_all()
        if self._on_event is not None:
            with suppress(Exception):
                self._on_event(event)

    def end(self) -> None:
        """Let readers end when they have read what is there."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def read(self, timeout: float | None) -> Iterator[Event]:
        """Events as they come, until there is none for ``timeout`` seconds (None: for ever) or all ended."""
        while (event := self._next(timeout)) is not None:
            yield event

    def _next(self, timeout: float | None) -> Event | None:
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while not self._waiting:
                left = None if deadline is None else deadline - time.monotonic()
                if self._ended or (left is not None and left <= 0):
                    return None
                self._changed.wait(left)
            return self._waiting.popleft()

    def wait(self, seconds: float) -> bool:
        """Wait for anything to happen; returns whether all has ended."""
        with self._changed:
            if not self._ended:
                self._changed.wait(seconds)
            return self._ended
