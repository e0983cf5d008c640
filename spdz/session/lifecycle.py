"""A session's life: alive, then dead for one reason. After any error it is closed, and nothing goes on."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

from spdz.channels import Channel
from spdz.channels.frames import abort_reason
from spdz.foundations.errors import ChannelClosed, MacCheckFailed, PeerAborted, TapeInUse
from spdz.session.turn import Turn

Self = TypeVar("Self", bound="Lifecycle")


class Lifecycle(ABC):
    """What sessions of every kind have in common.

    Args:
        channel: A connected channel; the session closes it.
        what: What users call the session.
    """

    def __init__(self, channel: Channel, what: str) -> None:
        self._channel, self._what = channel, what
        self._dead: str | None = None
        self._process = os.getpid()
        self._turn = Turn(what)

    @abstractmethod
    def _note_end(self) -> None:
        """Remember what can be told of a session that has ended."""

    @abstractmethod
    def _destroy(self) -> None:
        """Destroy what a peer that cheated must not be met with again."""

    @abstractmethod
    def _release(self) -> None:
        """Close everything but the channel."""

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.abandon(error)
        self.close()

    def abandon(self, error: BaseException) -> None:
        """End the session because of an error of this side's own; the peer is told that this side stopped."""
        if self._dead is None:
            self._die(error)

    def close(self) -> None:
        """Close connection and tape; safe to call twice. In a fork nothing is written anywhere."""
        if self._dead is None:
            self._dead = "closed"
            self._note_end()
        try:
            self._channel.close()
        finally:
            self._release()

    def _require_alive(self) -> None:
        if os.getpid() != self._process:
            raise TapeInUse(
                f"this {self._what} belongs to the process that opened it: open one after the fork"
            )
        if self._dead is not None:
            raise ChannelClosed(f"this {self._what} has ended ({self._dead}); open a new one")

    @property
    def _guard(self) -> Guard:
        return Guard(self, self._turn)  # kept, it would be a cycle: an abandoned session is to go at once

    def _die(self, error: BaseException) -> None:
        """Tell the peer why, close everything, and destroy the tape if the peer cheated.

        In a fork only the descriptors are closed: tape, connection and TLS keys are the parent's.
        """
        if os.getpid() != self._process:
            self.close()
            return
        if self._dead is None:
            self._dead = type(error).__name__
            self._note_end()
        try:
            if isinstance(error, MacCheckFailed):
                self._destroy()
        finally:
            if not isinstance(error, PeerAborted):
                self._channel.abort(abort_reason(error))
            self.close()


class Guard:
    """A turn, of a session that is alive, in which whatever goes wrong kills it."""

    def __init__(self, session: Lifecycle, turn: Turn) -> None:
        self._session, self._turn = session, turn

    def __enter__(self) -> None:
        self._session._require_alive()
        self._turn.take()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is not None:
                self._session._die(error)
        finally:
            self._turn.leave()
