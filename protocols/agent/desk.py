"""What the parts of one agent share."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass, field
from pathlib import Path

from protocols.agent.budgets import Rate
from protocols.agent.events import Event, Hub
from protocols.agent.keyframe import Verify
from protocols.agent.keyframes import Keyframes
from protocols.agent.records import Records
from protocols.agent.strikes import Strikes


class Wake:
    """Wakes a thread that waits for a file descriptor; any thread may."""

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe()
        for end in (self._reading, self._writing):
            os.set_blocking(end, False)

    def fileno(self) -> int:
        """What to wait for."""
        return self._reading

    def set(self) -> None:
        """Wake it."""
        try:
            os.write(self._writing, b"\0")
        except (BlockingIOError, OSError):  # it has enough to wake for, or has ended
            return

    def clear(self) -> bool:
        """Sleep again; returns whether it was woken."""
        woken = False
        try:
            while os.read(self._reading, 4096):
                woken = True
        except BlockingIOError:
            pass
        return woken

    def close(self) -> None:
        """Give both ends back."""
        for end in (self._reading, self._writing):
            os.close(end)


@dataclass(frozen=True, slots=True)
class Peer:
    """What galleries with the same peer share.

    Attributes:
        name: The robot.
        strikes: What is held against it.
        pairs: Pairs that it may still be compared with in this minute.
        matches: Matches that it may still have in this minute.
    """

    name: str
    strikes: Strikes
    pairs: Rate
    matches: Rate


@dataclass(frozen=True, slots=True)
class Desk:
    """What the parts of one agent share.

    Attributes:
        robot: The agent's name.
        records: Its durable records.
        keyframes: Its keyframes.
        hub: Where events go.
        verify: The user's verification; None takes every match for verified whose halves were shown.
        strikes: Strikes at which a peer is not compared with any more.
        grace: Seconds that a connected peer may take to show its half of a match.
        timeout: Seconds that one round may take.
        stop: Set when the agent ends.
        state_dir: Where the galleries keep their second record; None for the user's state folder.
    """

    robot: str
    records: Records
    keyframes: Keyframes
    hub: Hub
    verify: Verify | None
    strikes: int
    grace: float
    timeout: float
    stop: threading.Event = field(default_factory=threading.Event)
    state_dir: Path | None = None

    def tell(self, name: str, text: str, peer: str = "", gallery: str = "", **fields: object) -> None:
        """Hand on an event."""
        self.hub.tell(Event(name, text, peer, gallery, fields))
