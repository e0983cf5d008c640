"""The thread that runs the user's verification, one match at a time, while the galleries go on."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from protocols.agent.desk import Desk
from protocols.agent.events import Event
from protocols.agent.keyframe import Meeting, Verdict


class Verifier:
    """Gives verdicts of matches that both robots have shown each other.

    Args:
        desk: The agent's.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._waiting: queue.SimpleQueue[tuple[int, Meeting, Callable[[], None]] | None] = queue.SimpleQueue()
        self._known: set[int] = set()
        self._thread = threading.Thread(target=self._run, name="spdz verifier", daemon=True)
        self._thread.start()

    def judge(self, match: int, meeting: Meeting, done: Callable[[], None]) -> None:
        """Have a match verified, unless it is being verified already; ``done`` is called when it is."""
        if match not in self._known:
            self._known.add(match)
            self._waiting.put((match, meeting, done))

    def close(self, seconds: float) -> None:
        """End after the verification under way, or leave it behind after some seconds."""
        self._waiting.put(None)
        self._thread.join(seconds)

    def _run(self) -> None:
        while (entry := self._waiting.get()) is not None and not self._desk.stop.is_set():
            match, meeting, done = entry
            try:
                news = self._desk.matches.settle(match, self._verdict(meeting))
            except OSError as error:  # it is judged again after a restart
                self._desk.tell("records", f"a verdict is lost: {error}", meeting.peer, meeting.gallery)
                self._known.discard(match)
                continue
            self._desk.hub.tell(Event.of(news))
            done()

    def _verdict(self, meeting: Meeting) -> Verdict:
        verify = self._desk.verify
        if verify is None:
            return Verdict(True, "not looked at: no verification was given")
        try:
            verdict = verify(meeting)
            if not isinstance(verdict, Verdict):
                raise TypeError(f"it returned {type(verdict).__name__}, not a Verdict")
        except Exception as error:  # the peer's payload can be anything, and the agent goes on
            why = f"the verification failed: {type(error).__name__}: {error}"
            self._desk.tell("verification", why, meeting.peer, meeting.gallery, keyframe=meeting.own.id)
            return Verdict(False, why[:200])
        return verdict


def meeting_of(
    desk: Desk, peer: str, gallery: str, pair: tuple[int, int], keyframe: int | None
) -> Meeting | None:
    """The meeting of a pair of slots; None if one half is not known here."""
    own = None if keyframe is None else desk.keyframes.get(keyframe, gallery)
    other = desk.matches.theirs(peer, gallery, pair[1])
    return None if own is None or other is None else Meeting(peer, gallery, own, other)
