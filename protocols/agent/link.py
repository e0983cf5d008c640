"""One gallery with one peer, while the agent runs: connect, take turns, lose the line, connect again."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any
from typing import Protocol as Interface

from protocols.agent.desk import Desk, Peer, Wake
from protocols.agent.reasons import why_nothing
from protocols.agent.records import RecordsError
from protocols.agent.turns import Turns
from protocols.agent.verifier import Verifier
from spdz.channels import Channel
from spdz.channels.telling import Teller
from spdz.foundations.errors import (
    ChannelClosed,
    ChannelError,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
    TapeDestroyed,
    TapeInUse,
)
from spdz.readings.gallery import Terms
from spdz.session import open_gallery
from spdz.tape.header import Header

_SHORTEST, _LONGEST = 0.1, 5.0
"""Seconds before another try to connect, doubled while tries bring nothing that lasts."""
_SLOW = 10.0
"""Seconds before another try where somebody has to do something first."""
_IDLE = 0.05
"""Seconds between a turn that brought nothing and the next: a peer that has much to say costs little."""
HEARTBEAT = 10.0
"""Seconds without a turn after which one is made anyway: so a dead line is noticed."""

_LOOK = 2.0
"""Seconds between looks whether the peer calls anew while nothing is said."""


class Reach(Interface):
    """The way to one peer for one gallery."""

    def __call__(self, header: Header, credentials: Path) -> Channel:
        """Make a connection, or raise :class:`ChannelTimeout` after a few seconds."""

    def is_called(self) -> bool:
        """Whether the peer waits with another call."""


class Link:
    """A gallery with a peer.

    Args:
        desk: The agent's.
        peer: The other robot and its budgets.
        gallery: The gallery's name.
        tape: This robot's tape of it.
        terms: What it is for.
        reach: Makes connections to the peer.
        verifier: The agent's.
    """

    def __init__(
        self,
        desk: Desk,
        peer: Peer,
        gallery: str,
        tape: Path,
        terms: Terms,
        reach: Reach,
        verifier: Verifier,
    ) -> None:
        self.peer, self.gallery = peer.name, gallery
        self._peer = peer
        self._desk, self._tape, self._terms, self._reach = desk, tape, terms, reach
        self._wake = Wake()
        self._turns = Turns(desk, peer, gallery, terms, verifier, self._wake.set)
        self._teller = Teller(lambda text: self._tell("waiting", text))
        self._state, self._why = "waiting", f"{peer.name} has not been reached yet"
        self._pause = _SHORTEST
        self._thread = threading.Thread(target=self._run, name=f"spdz {peer.name} {gallery}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def wake(self) -> None:
        """Have it look for what is new; any thread may."""
        self._wake.set()

    def join(self, seconds: float) -> bool:
        """Wait for its end; returns whether it has ended."""
        self._thread.join(seconds)
        if not self._thread.is_alive():
            self._wake.close()
        return not self._thread.is_alive()

    def status(self) -> dict[str, Any]:
        """Where it stands, JSON-ready; without secrets."""
        counts = self._turns.status()
        state = self._state
        return {
            "peer": self.peer,
            "gallery": self.gallery,
            "state": state,
            **counts,
            "why": why_nothing(self.peer, state, self._why, counts),
        }

    # -- its thread ----------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._desk.stop.is_set():
            try:
                pause = self._attempt()
            except Exception as error:  # what was to be held against the peer cannot be written, say
                self._note("waiting", "records" if isinstance(error, RecordsError) else "bug", error)
                pause = _SLOW
            if pause is None:
                return
            self._desk.stop.wait(pause)

    def _attempt(self) -> float | None:
        """One connection, if there may be one; returns seconds until the next, None if there will be none."""
        try:
            if self._resting():
                return 0.0
            began = time.monotonic()
            met = self._once()
            # To connect costs work: who is met, and at once lost, again and again, is met less often.
            lasted = met and time.monotonic() - began > _LONGEST
            self._pause = _SHORTEST if lasted else min(2 * self._pause, _LONGEST)
            return self._pause
        except MacCheckFailed as error:
            self._hold_against(error, "destroyed", "cheated")
            return None
        except TapeDestroyed as error:
            self._note("destroyed", "destroyed", error)
            return None
        except (TapeInUse, OSError) as error:
            name = "records" if isinstance(error, RecordsError) else "system"
            self._note("waiting", name, error)
        except ProtocolViolation as error:
            self._hold_against(error, "refused", "violation")
        except (SpdzError, ValueError) as error:
            self._note("refused", "refused", error)
        except Exception as error:
            self._note("refused", "bug", error)
        return _SLOW

    def _once(self) -> bool:
        """One connection; returns whether the peer was met."""
        waiting: list[Any] = []
        met = False
        try:
            with open_gallery(
                self._tape,
                self._terms,
                waiting=waiting,
                reach=self._reach,
                timeout=self._desk.timeout,
                state_dir=self._desk.state_dir,
                on_event=self._teller.tell,
            ) as session:
                met = True
                self._state, self._why = "connected", ""
                self._tell("connected", f"connected to {self.peer}")
                self._turns.begin(session, waiting)
                while self._turns.take(session):
                    self._wait(session)
                self._note_left()
        except OutOfStep as error:
            self._lost(error, met)
        except ChannelError as error:
            if isinstance(error, PeerAborted) and not error.passing and "tape" in str(error):
                raise
            self._lost(error, met)
        return met

    def _wait(self, session: Any) -> None:
        """Idle until there is a reason for a turn."""
        if not self._turns.moved:
            self._desk.stop.wait(_IDLE)
        until = time.monotonic() + self._turns.pause(HEARTBEAT)
        while (left := until - time.monotonic()) > 0 and not self._desk.stop.is_set():
            if self._reach.is_called():
                raise ChannelClosed(f"{self.peer} calls anew: it has lost this connection")
            if session.await_peer(min(left, _LOOK), self._wake.fileno()) or self._wake.clear():
                break

    def _resting(self) -> bool:
        """Whether the peer has too many strikes; then wait until they are forgiven."""
        strikes = self._peer.strikes.reasons
        if len(strikes) < self._desk.strikes:
            return False
        if self._state != "stopped":
            self._state, self._why = "stopped", strikes[-1]
            self._tell(
                "stopped",
                f"{self.peer} has {len(strikes)} strikes and is not compared with any more (the last: "
                f"{strikes[-1]}): start this agent again with --forgive {self.peer}, or call agent.forgive()",
                strikes=len(strikes),
            )
        self._desk.stop.wait(1.0)
        return True

    # -- telling -------------------------------------------------------------------------------------

    def _note_left(self) -> None:
        if self._turns.farewell:
            self._state, self._why = "waiting", self._turns.farewell
            self._tell("left", self._turns.farewell)

    def _lost(self, error: SpdzError, met: bool) -> None:
        if self._desk.stop.is_set():
            return
        self._state, self._why = "waiting", str(error)
        if met:
            self._tell("lost", f"lost {self.peer}: {error}")
        else:
            self._teller.tell(str(error) if self.peer in str(error) else f"{self.peer}: {error}")

    def _hold_against(self, error: SpdzError, state: str, name: str) -> None:
        self._note(state, name, error)
        # A failed MAC check is a cheat, or a damaged tape: the peer is met again when somebody has looked.
        for _ in range(self._desk.strikes if isinstance(error, MacCheckFailed) else 1):
            self._peer.strikes.add(f"{type(error).__name__}: {error}")

    def _note(self, state: str, name: str, error: Exception) -> None:
        """Tell an error, once as long as it is the same."""
        text = f"{type(error).__name__}: {error}"
        if (state, text) != (self._state, self._why):
            self._state, self._why = state, text
            self._tell(name, f"{self.gallery} with {self.peer}: {text}", error=type(error).__name__)

    def _tell(self, name: str, text: str, **fields: object) -> None:
        self._desk.tell(name, text, self.peer, self.gallery, **fields)
