"""One robot of a mission: it takes keyframes, compares them with all peers', and yields matches."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt

from protocols.agent.budgets import Rate
from protocols.agent.desk import Desk, Peer
from protocols.agent.events import Event, Hub, Match
from protocols.agent.intake import Intake
from protocols.agent.keyframe import Verify
from protocols.agent.keyframes import Keyframes
from protocols.agent.link import Link
from protocols.agent.news import News
from protocols.agent.reaching import Reaching
from protocols.agent.records import Records
from protocols.agent.strikes import Strikes
from protocols.agent.verifier import Verifier
from protocols.mission import Folder, Mission

Self = TypeVar("Self", bound="Agent")

_SLICE = 0.5
"""Seconds after which a reader looks for news anyway."""
FAREWELL = 15.0
"""Seconds that :meth:`Agent.stop` gives turns under way."""


class Agent:
    """A robot's agent; it works from the moment it is made.

    ::

        with Agent("mission/alice", verify=my_verification) as agent:
            agent.add(17, {"lidar": vector}, payload=scan)      # from any thread, returns at once
            for match in agent.matches(timeout=1.0):
                ...

    Everything that it has been given and has found is durable: an agent that is made again on the same folder
    goes on where the last one was. A peer that fails, lies or stays away stops nothing but its own galleries.

    Args:
        mission: The robot's folder, as the dealer wrote it.
        verify: Looks at both keyframes of a match and says whether they show the same place. Without it every
            match counts as verified whose halves were shown.
        listen: ``"host:port"`` for the one port for all peers; the plan's if not given.
        peers: Where peers listen, by name, in place of the plan's addresses.
        on_event: Called with every event by the thread in which it happens; it must return soon.
        strikes: Strikes at which a peer is not compared with any more; the plan's if not given.
        forgive: Peers whose strikes are forgotten before it begins.
        grace: Seconds that a connected peer may take to show its half of a match.
        timeout: Seconds that one round with a peer may take.
        state_dir: Where the galleries keep their second record of what was used.

    Raises:
        ValueError: for a folder that is none, or bad arguments.
        RecordsError: if the agent's records cannot be used, or another agent has them.
        ChannelError: if the port can never be listened on.
    """

    def __init__(
        self,
        mission: str | Path,
        *,
        verify: Verify | None = None,
        listen: str | None = None,
        peers: Mapping[str, str] | None = None,
        on_event: Callable[[Event], None] | None = None,
        strikes: int | None = None,
        forgive: Collection[str] = (),
        grace: float = 30.0,
        timeout: float = 30.0,
        state_dir: str | Path | None = None,
    ) -> None:
        for name, seconds in (("grace", grace), ("timeout", timeout)):
            if not (seconds > 0 and math.isfinite(seconds)):
                raise ValueError(f"{name} is a positive number of seconds, not {seconds!r}")
        self.folder = Folder.open(mission)
        plan = self.folder.mission
        limit = plan.budgets.strikes if strikes is None else strikes
        if limit < 1:
            raise ValueError(
                "strikes are 1 or more: a peer that may have none could not be compared with at all"
            )
        if wrong := set(forgive) - set(self.peers):
            raise ValueError(f"{sorted(wrong)[0]!r:.40} is no peer of {self.robot}: {', '.join(self.peers)}")
        self._intake = Intake(plan)
        self._records = Records(self.folder.path, self.folder.mission_id)
        self._news, self._hub = News(self._records), Hub(on_event)
        self._desk = Desk(
            self.robot,
            self._records,
            Keyframes(self._records),
            self._hub,
            verify,
            limit,
            grace,
            timeout,
            state_dir=None if state_dir is None else Path(state_dir),
        )
        for name in forgive:
            Strikes(self._records, name).forgive()
        self._stopped = threading.Event()
        self._last: dict[str, Any] | None = None  # the status when it was closed
        try:
            self._reaching = Reaching(self.folder, self._desk, listen, peers or {})
        except BaseException:
            self._records.close()
            raise
        self._verifier = Verifier(self._desk)
        self._links = [
            Link(
                self._desk,
                peer,
                gallery,
                self.folder.tape(peer.name, gallery),
                terms,
                self._reaching.of(peer.name, gallery),
                self._verifier,
            )
            for peer in self._peers()
            for gallery, terms in self._intake.terms.items()
        ]
        for warning in _warnings(plan, verify):
            self._desk.tell("warning", warning)
        for link in self._links:
            link.start()

    def __repr__(self) -> str:
        return f"<agent of {self.robot} with {', '.join(plan for plan in self.peers)}>"

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def robot(self) -> str:
        """This robot's name."""
        return self.folder.robot

    @property
    def peers(self) -> list[str]:
        """The robots that it is dealt for."""
        return self.folder.mission.peers(self.robot)

    @property
    def stopped(self) -> bool:
        """Whether it was stopped."""
        return self._stopped.is_set()

    @property
    def addresses(self) -> list[str]:
        """Where it listens; empty if it calls all its peers, or cannot listen yet."""
        return self._reaching.addresses

    def add(
        self,
        keyframe: int,
        descriptors: Mapping[str, npt.ArrayLike],
        payload: bytes = b"",
        stamp: float | None = None,
    ) -> None:
        """Take a keyframe, durably; the same one again changes nothing.

        Args:
            keyframe: Its number, 0 to 2^53 - 1, for ever.
            descriptors: By their names in the plan, each of shape (dim,), or (turns, dim) where the plan says
                turns. A place of several needs all of its descriptors.
            payload: What a peer is shown of it once both have matched it, at most 8 MiB.
            stamp: The robot's own time of it, in seconds.

        Raises:
            ValueError: for what does not suit the plan, naming it; nothing is kept.
            RecordsError: if it cannot be written; nothing is kept.
        """
        taken, described = self._intake.check(keyframe, descriptors, payload, stamp)
        if self._stopped.is_set():
            raise ValueError(f"keyframe {keyframe}: this agent has ended")
        new = self._desk.keyframes.add(taken, described)
        for link in self._links:
            if link.gallery in new:
                link.wake()

    def events(self, timeout: float | None = None) -> Iterator[Event]:
        """Events as they come, until none comes for ``timeout`` seconds (None: for ever) or it is stopped."""
        return self._hub.read(timeout)

    def matches(self, timeout: float | None = None, *, again: bool = False) -> Iterator[Match]:
        """News of matches, each once: what was not read before a restart comes after it.

        News counts as read when the next one is asked for.

        Args:
            timeout: Seconds without news after which the iteration ends; None waits until the agent stops.
            again: Begin with the first news of the mission.
        """
        number = 0 if again else self._news.read_to
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            for news in self._news.after(number):
                yield news
                number = news.number
                self._news.read(number)
                deadline = None if timeout is None else time.monotonic() + timeout
            left = _SLICE if deadline is None else min(_SLICE, deadline - time.monotonic())
            if left <= 0 or self._hub.wait(left):
                return

    def status(self) -> dict[str, Any]:
        """Where it stands, JSON-ready; without secrets."""
        if self._last is not None:
            return self._last
        return {
            "robot": self.robot,
            "listening": self.addresses,
            "galleries": [link.status() for link in self._links],
        }

    def forgive(self, peer: str) -> int:
        """Go on with a peer that was stopped after too many strikes; returns how many there were.

        Raises:
            ValueError: if it is no peer.
        """
        if peer not in self.peers:
            raise ValueError(
                f"{peer!r:.40} is no peer of {self.robot}; its peers are {', '.join(self.peers)}"
            )
        count = Strikes(self._records, peer).forgive()
        for link in self._links:
            link.wake()
        return count

    def stop(self) -> None:
        """End: turns under way are made, peers are told, all is durable. What was found can still be read."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        self._desk.stop.set()
        for link in self._links:
            link.wake()
        deadline = time.monotonic() + FAREWELL
        ended = [link.join(max(0.0, deadline - time.monotonic())) for link in self._links]
        self._reaching.close()
        self._verifier.close(max(0.1, deadline - time.monotonic()))
        self._desk.tell("ended", "ended" if all(ended) else "ended; a turn under way was left behind")
        self._hub.end()

    def close(self) -> None:
        """Stop, and close the records; safe to call twice."""
        self.stop()
        self._last = self._last or self.status()
        self._records.close()

    def _peers(self) -> list[Peer]:
        budgets, records = self.folder.mission.budgets, self._records
        return [
            Peer(
                name,
                Strikes(records, name),
                Rate(budgets.pairs_per_minute),
                Rate(budgets.matches_per_minute),
            )
            for name in self.peers
        ]


def _warnings(plan: Mission, verify: Verify | None) -> Iterator[str]:
    """What weakens an agent's protection, at its start."""
    if plan.security != "malicious":
        yield (
            "this mission is semi-honest: a peer whose program was changed matches whatever it likes, and is "
            "then shown it. If robots may be captured, deal malicious"
        )
    if verify is None:
        yield (
            "there is no verification: every match counts as verified whose half the peer has shown, "
            "whatever that is, and strikes protect little"
        )
