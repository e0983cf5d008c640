"""An agent fed from a bag, at the pace at which it was recorded or another."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from protocols.stacks.bag import Recorded
from protocols.stacks.bridge import give
from protocols.stacks.front import Found, Running
from protocols.stacks.swarm_slam import SwarmSlam

_SLICE = 0.1


@dataclass(slots=True)
class Replay:
    """Feeds an agent and shows what it finds.

    Attributes:
        agent: The robot's agent.
        adapter: What refuses what is no descriptor of this robot.
        speed: Seconds of the recording a second; infinite for as fast as it goes.
        show: Called with every news of a match.
        clock: Seconds.
    """

    agent: Running
    adapter: SwarmSlam
    speed: float = 1.0
    show: Callable[[Found], None] = lambda match: None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        if not self.speed > 0:
            raise ValueError(
                f"the speed is a positive number, 1 for that of the recording, not {self.speed:g}"
            )

    def feed(self, recorded: Iterable[Recorded], ended: threading.Event) -> None:
        """Give the agent a recording from its first message to its last, or until told to end.

        Raises:
            ValueError: if the recording is damaged.
        """
        started, first = self.clock(), None
        for one in recorded:
            first = one.stamp if first is None else first
            due = started + max(0.0, one.stamp - first) / self.speed
            while (left := due - self.clock()) > 0 and not ended.is_set():
                self.look(min(left, _SLICE))
            if ended.is_set():
                return
            give(self.adapter, one.message, one.stamp)
        self.adapter.late()

    def look(self, seconds: float) -> None:
        """Show what is found, for so long."""
        deadline = self.clock() + seconds
        for match in self.agent.matches(0.0):
            self.show(match)
        time.sleep(max(0.0, deadline - self.clock()))

    def linger(self, quiet_seconds: float, ended: threading.Event) -> None:
        """Go on until nothing has changed for so many seconds, with every peer settled or not connected."""
        state: object = None
        since = self.clock()
        while not ended.is_set() and self.clock() - since < quiet_seconds:
            self.look(_SLICE)
            galleries = self.agent.status()["galleries"]
            now = [(one["held"], one["peer_held"], one["settled"], one["state"]) for one in galleries]
            if now != state or any(one["state"] == "connected" and not one["settled"] for one in galleries):
                state, since = now, self.clock()
        self.look(0.0)
