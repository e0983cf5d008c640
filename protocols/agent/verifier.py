"""The thread that runs the user's verification, one match at a time, while the galleries go on."""

from __future__ import annotations

import queue
import threading
import traceback
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from protocols.agent.desk import Desk
from protocols.agent.keyframe import Meeting, Verdict
from spdz.channels.telling import printable

Meet: TypeAlias = Callable[[], "Meeting | None"]
Settle: TypeAlias = Callable[[Verdict], None]
_Case: TypeAlias = tuple[int, Meet, Settle]


class Verifier:
    """Gives verdicts of matches that both robots have shown each other.

    Args:
        desk: The agent's.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._waiting: queue.SimpleQueue[_Case | None] = queue.SimpleQueue()
        self._known: set[int] = set()
        self._thread = threading.Thread(target=self._run, name="spdz verifier", daemon=True)
        self._thread.start()

    def judge(self, match: int, meet: Meet, settle: Settle) -> None:
        """Have a match verified, unless it is being verified already.

        Args:
            match: Its number.
            meet: Gives what the verification sees, when it does: payloads are large, and many may wait.
            settle: Takes the verdict, in this thread.
        """
        if match not in self._known:
            self._known.add(match)
            self._waiting.put((match, meet, settle))

    def close(self, seconds: float) -> None:
        """End after the verification under way, or leave it behind after some seconds."""
        self._waiting.put(None)
        self._thread.join(seconds)

    def _run(self) -> None:
        while (entry := self._waiting.get()) is not None and not self._desk.stop.is_set():
            match, meet, settle = entry
            try:
                if (meeting := meet()) is not None:
                    settle(self._verdict(meeting))
            except Exception as error:  # it is judged again on the next connection, and the others go on
                self._desk.tell("records", f"a verdict on match {match} is lost: {error}")
                self._known.discard(match)

    def _verdict(self, meeting: Meeting) -> Verdict:
        verify = self._desk.verify
        if verify is None:
            return Verdict(True, "unchecked")
        try:
            verdict = verify(meeting)
            if isinstance(verdict, (bool, np.bool_)):
                return Verdict(bool(verdict))
            if not isinstance(verdict, Verdict):
                raise TypeError(
                    f"it returned {type(verdict).__name__}: return protocols.agent.Verdict(accepted, why)"
                )
        except Exception as error:  # the peer's payload can be anything, and the agent goes on
            why = printable(f"{type(error).__name__}: {error}"[:200])
            where = traceback.extract_tb(error.__traceback__)[-1]
            text = f"--verify raised in {where.filename}, line {where.lineno}: {why}; this counts as rejected"
            self._desk.tell("verification", text, meeting.peer, meeting.gallery, keyframe=meeting.own.id)
            return Verdict(False, f"the verification raised {why}")
        return verdict
