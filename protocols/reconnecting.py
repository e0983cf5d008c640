"""Work with one peer that outlives its connections."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from spdz.foundations.errors import ChannelError, OutOfStep, PeerAborted
from spdz.session.lifecycle import Lifecycle

AnySession = TypeVar("AnySession", bound=Lifecycle)

_FIRST_PAUSE, _LONGEST_PAUSE = 0.05, 1.0
"""Seconds before another try, doubled while tries bring nothing."""

FAREWELL = 10.0
"""Most seconds to look for a peer that has perhaps missed the end."""


class Reconnecting(ABC, Generic[AnySession]):
    """One robot's side of what is done over as many connections as it takes.

    Args:
        peer: The other robot's name.
        on_event: Called with a sentence whenever the connection is lost or made again.
    """

    def __init__(self, peer: str, on_event: Callable[[str], None]) -> None:
        self._peer, self._on_event = peer, on_event
        self._session: AnySession | None = None
        self._progressed = self._met = False

    @abstractmethod
    def _open(self, wait: float) -> AnySession:
        """Reach the peer."""

    def _ended(self, session: AnySession) -> None:
        """A session was closed."""

    def close(self) -> None:
        """Hang up; safe to call twice."""
        session, self._session = self._session, None
        if session is not None:
            session.close()
            self._ended(session)

    def _see_through(self, wait: float, work: Callable[[AnySession], None]) -> None:
        """Do the work, over as many connections as it takes, while something goes on within ``wait``."""
        deadline, pause = time.monotonic() + wait, _FIRST_PAUSE
        while True:
            self._progressed, reached = False, self._session is not None
            try:
                session = self._connected(max(deadline - time.monotonic(), _FIRST_PAUSE))
                reached = True
                work(session)
                return
            except (ChannelError, OutOfStep) as error:
                passing = self._may_pass(error, reached)
                self._hang_up(None if passing else error)
                now = time.monotonic()
                if self._progressed:
                    deadline, pause = now + wait, _FIRST_PAUSE
                # What could not be reached was looked for until the deadline, or nearly.
                rest = pause if reached else max(pause, min(1.0, wait / 2))
                if not passing or now + rest >= deadline:
                    raise
                what = "lost" if reached else "could not reach"
                self._on_event(
                    f"{what} {self._peer} ({error}); trying again for up to {deadline - now:.3g} s"
                )
            except BaseException as error:
                self._hang_up(error)
                raise
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _may_pass(self, error: ChannelError | OutOfStep, reached: bool) -> bool:
        """Whether the peer may be back, or be the one that answers next time."""
        if isinstance(error, OutOfStep):  # one that was restarted has been told where this side is
            return error.here is not None and error.there is not None and error.here > error.there
        somebody_else = self._met and not reached and not isinstance(error, PeerAborted)
        return error.passing or somebody_else

    def _hang_up(self, error: BaseException | None) -> None:
        """Close the session; the peer is told of an error that is for good."""
        if error is not None and self._session is not None:
            self._session.abandon(error)
        self.close()

    def _connected(self, wait: float) -> AnySession:
        if self._session is None:
            self._session = self._open(wait)
            self._met = True
            self._on_event(f"connected to {self._peer}")
        return self._session
