"""The process that takes the place of Swarm-SLAM's loop-closure detection node: transport, adapter, agent.

One loop: what the robot's graph brings goes to the adapter, what the agent found goes out. News of a match
counts as read when the next is asked for, so each is published before that: a process that is killed loses
none. While nobody reads what is published nothing is asked for, so a back end that starts late misses
nothing.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from protocols.stacks.front import Found, Running
from protocols.stacks.messages import GlobalDescriptors
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.topics import Topics
from protocols.stacks.transport import Incoming, Outgoing, Payload, Transport

PATIENCE = 10.0
"""Seconds without a descriptor, or a reader, after which that is said; the next time after twice as long."""


def give(adapter: SwarmSlam, message: Incoming, stamp: float | None = None) -> None:
    """Give an incoming message to the adapter."""
    if isinstance(message, GlobalDescriptors):
        adapter.take(message, stamp)
    elif isinstance(message, Payload):
        adapter.saw(message.keyframe, message.data)
    else:
        adapter.unreadable(message)


@dataclass(slots=True)
class Bridge:
    """Carries messages between a robot's graph and its agent.

    Attributes:
        agent: The robot's agent.
        adapter: What turns the one into the other.
        transport: The robot's end of its graph.
        names: The topics, for people.
        say: Told what people should know, in one sentence.
        show: Called with every news of a match.
        clock: Seconds.
    """

    agent: Running
    adapter: SwarmSlam
    transport: Transport
    names: Topics
    say: Callable[[str], None] = lambda sentence: None
    show: Callable[[Found], None] = lambda match: None
    clock: Callable[[], float] = time.monotonic
    _pending: deque[Outgoing] = field(default_factory=deque)
    _due: dict[str, tuple[float, float]] = field(default_factory=dict)

    def run(self, ended: threading.Event, slice_seconds: float = 0.1) -> None:
        """Work until told to end."""
        while not ended.is_set():
            self.step(slice_seconds)

    def step(self, seconds: float) -> None:
        """Take what has come within so many seconds, and publish what was found."""
        for message in self.transport.take(seconds):
            give(self.adapter, message)
        self.adapter.late()
        silence = self.transport.silence()
        if not self._told("silence", silence is None):
            self.say(f"{silence} ({self.transport.where})")
        if not self._told("descriptors", self.adapter.counts["received"] > 0):
            writers = self.transport.writers()
            known = {None: "", 0: "; nobody writes there"}.get(writers, f"; {writers} write there")
            self.say(f"no descriptor has come on {self.names.descriptors} ({self.transport.where}){known}")
        has_reader = self.transport.has_reader()
        if not self._told("reader", has_reader):
            self.say(
                f"nobody reads {self.names.matches} or {self.names.closures} ({self.transport.where}): "
                "matches wait until somebody does"
            )
        if has_reader:
            self._publish()

    def _publish(self) -> None:
        if not self._sent():
            return
        for match in self.agent.matches(0.0):
            self._pending += self.adapter.found(match)
            if not self._sent():
                return
            self.show(match)

    def _sent(self) -> bool:
        """Send what is pending; False if the graph does not take it: it stays pending."""
        while self._pending:
            try:
                self.transport.publish(self._pending[0])
            except OSError as error:
                if not self._told("writing", False):
                    self.say(f"{error}; it is tried again")
                return False
            self._pending.popleft()
        self._told("writing", True)
        return True

    def _told(self, what: str, good: bool) -> bool:
        """Whether there is nothing to say now: all is well, or it was said not long ago."""
        now = self.clock()
        since, pause = self._due.get(what, (now, PATIENCE))
        if good:
            self._due[what] = now, PATIENCE
        elif now - since < pause:
            self._due[what] = since, pause
        else:
            self._due[what] = now, 2 * pause
            return False
        return True
