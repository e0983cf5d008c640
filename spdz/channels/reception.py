"""The callers of a listener, until one of them proves to be a peer.

All of them are served at the same time, a little each, so that whoever connects and sends garbage, or
nothing, neither ends the wait nor delays a peer.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from spdz.channels.addresses import RETRY_SECONDS, NotYet, patiently
from spdz.channels.listening import Listener, accept_one, address_of, addresses_of
from spdz.channels.stream import Stream, describe
from spdz.channels.telling import Teller, in_seconds
from spdz.channels.times import LONGEST_SLEEP
from spdz.foundations.errors import ChannelError, ChannelTimeout

MAX_HANDSHAKES = 32
"""Security limit: callers that a listener has under way; one more, and the oldest of the address that has the
most of them is dropped."""


class Caller(ABC):
    """Somebody who connected and has yet to prove to be a peer.

    Args:
        stream: The connection.

    Attributes:
        farewell: What a caller that is refused is sent, if that can still be done.
    """

    farewell: bytes

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    @abstractmethod
    def proceed(self) -> int:
        """Go on; returns the poll events that it waits for, 0 once the caller proved to be a peer.

        Raises:
            ChannelError: if the caller is refused, with the reason.
        """


AnyCaller = TypeVar("AnyCaller", bound=Caller)


def receive(
    listen: Callable[[], Listener],
    wait: float,
    on_listening: Callable[[str], None],
    teller: Teller,
    admit: Callable[[socket.socket], Caller],
    peer: str,
    rite: str,
) -> Stream:
    """Listen until the peer has come.

    Args:
        listen: Opens the listener.
        wait: Seconds for everything.
        on_listening: Called with the address as soon as the peer can connect.
        teller: Is told where this side listens as soon as it does, why it does not yet, and who is refused.
        admit: Makes a caller of a connection, which it owns then.
        peer: Who is expected, in words.
        rite: What a caller has to get through, for error messages.

    Raises:
        ChannelError: if the address cannot be listened on, or everybody who called was refused.
        ChannelTimeout: if nobody called.
    """
    deadline = time.monotonic() + wait

    def give_up(last: NotYet) -> ChannelError:
        return ChannelError(f"{last} (tried for {in_seconds(wait)})")

    with (
        patiently(listen, deadline, give_up, teller, "cannot listen") as listener,
        contextlib.closing(Reception(listener, admit, teller)) as reception,
    ):
        teller.tell(f"listening on {' and '.join(addresses_of(listener))} for {peer}")
        on_listening(address_of(listener))
        caller = reception.next_peer(deadline)
        if caller is None:
            raise reception.failure(f"{peer} did not connect within {in_seconds(wait)}", rite)
        return caller.stream


@dataclass(frozen=True, slots=True)
class _Visit(Generic[AnyCaller]):
    """A caller that is under way, where it calls from, and when it has to be through."""

    caller: AnyCaller
    host: str
    deadline: float


class Reception(Generic[AnyCaller]):
    """The callers of a listener.

    Args:
        listener: Where they come from.
        admit: Makes a caller of a connection.
        teller: Is told who is refused, and when no connection can be taken.
        patience: Seconds that a caller may take.
        wake: Ends a wait as soon as it can be read.
        most: Callers to have under way.
    """

    def __init__(
        self,
        listener: Listener,
        admit: Callable[[socket.socket], AnyCaller],
        teller: Teller,
        patience: float = math.inf,
        wake: socket.socket | None = None,
        most: int = MAX_HANDSHAKES,
    ) -> None:
        self._doors = {sock.fileno(): sock for sock in listener.sockets}
        self._admit_one = admit
        self._teller = teller
        self._patience, self._most = patience, most
        self._wake = None if wake is None else wake.fileno()
        self._visits: dict[int, _Visit[AnyCaller]] = {}  # by descriptor, the oldest first
        self._poll = select.poll()
        self._refused = 0
        self._last_refusal = ""
        self._no_room = ""
        for descriptor in (*self._doors, *([] if self._wake is None else [self._wake])):
            self._poll.register(descriptor, select.POLLIN)

    def next_peer(self, deadline: float) -> AnyCaller | None:
        """The next caller that proves to be a peer; None if there is none before the deadline."""
        while (left := deadline - time.monotonic()) > 0:
            for descriptor, _ in self._poll.poll(min(left, self._until_late(), LONGEST_SLEEP) * 1000):
                if descriptor in self._doors:
                    self._admit(self._doors[descriptor])
                elif descriptor == self._wake:
                    return None
                elif (visit := self._visits.get(descriptor)) is not None and self._proves(visit.caller):
                    return self._let_go(descriptor)
        return None

    def failure(self, what: str, rite: str) -> ChannelError:
        """Why nobody was taken."""
        if self._refused:
            return ChannelError(
                f"{what}; callers refused: {self._refused}, the last one because: {self._last_refusal}"
            )
        if self._no_room:
            return ChannelTimeout(f"{what}: {self._no_room}")
        if self._visits:
            return ChannelTimeout(f"{what} ({len(self._visits)} connected without {rite})")
        return ChannelTimeout(f"{what}: is it started with connect= (--connect) to this address?")

    def close(self) -> None:
        """Hang up on every caller that is left."""
        for descriptor in list(self._visits):
            self._let_go(descriptor).stream.close()

    def _until_late(self) -> float:
        """Seconds until the next caller is late; refuses those that are."""
        now = time.monotonic()
        while self._visits:
            visit = next(iter(self._visits.values()))
            if visit.deadline > now:
                return visit.deadline - now
            self._refuse(visit.caller, f"it was not through within {in_seconds(self._patience)}")
        return math.inf

    def _admit(self, door: socket.socket) -> None:
        try:
            sock = accept_one(door)
        except OSError as error:
            self._no_room = (
                f"a connection could not be taken ({describe(error)}); close files or raise `ulimit -n`"
            )
            self._teller.tell(self._no_room)
            time.sleep(RETRY_SECONDS)  # the door stays ready, and poll would return at once
            return
        if sock is None:
            return
        self._no_room = ""
        host = _host(sock)
        caller = self._admit_one(sock)
        if len(self._visits) >= self._most:
            self._let_go(self._least_worth_waiting_for()).stream.close()
        self._visits[caller.stream.fileno()] = _Visit(caller, host, time.monotonic() + self._patience)
        self._poll.register(caller.stream, select.POLLIN)

    def _least_worth_waiting_for(self) -> int:
        """The oldest caller of the address that has the most of them; of several such, the oldest of all."""
        counts = Counter(visit.host for visit in self._visits.values())
        return max(self._visits, key=lambda descriptor: counts[self._visits[descriptor].host])

    def _proves(self, caller: Caller) -> bool:
        """Go on with a caller; True once it is known to be the peer."""
        try:
            events = caller.proceed()
        except ChannelError as error:
            self._refuse(caller, str(error))
            return False
        if events:
            self._poll.modify(caller.stream, events)
        return not events

    def _refuse(self, caller: Caller, why: str) -> None:
        self._refused += 1
        self._last_refusal = why
        self._let_go(caller.stream.fileno()).stream.part(caller.farewell)
        self._teller.tell(f"refused a caller: {why}")

    def _let_go(self, descriptor: int) -> AnyCaller:
        self._poll.unregister(descriptor)
        return self._visits.pop(descriptor).caller


def _host(sock: socket.socket) -> str:
    try:
        return str(sock.getpeername()[0])
    except OSError:  # gone again
        return ""
