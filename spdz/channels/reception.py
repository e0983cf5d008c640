"""The callers of a listener, until one of them proves to be the peer.

All of them are served at the same time, a little each, so that whoever connects and sends garbage, or
nothing, neither ends the wait nor delays the peer.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from spdz.channels.addresses import RETRY_SECONDS, NotYet, patiently
from spdz.channels.base import LONGEST_SLEEP
from spdz.channels.listening import Listener, accept_one, address_of, addresses_of
from spdz.channels.stream import Stream, describe
from spdz.channels.telling import Teller, in_seconds
from spdz.foundations.errors import ChannelError, ChannelTimeout

MAX_HANDSHAKES = 32
"""Security limit: callers that a listener has under way; one more, and the oldest is dropped."""


class Caller(ABC):
    """Somebody who connected and has yet to prove to be the peer.

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
        """Go on; returns the poll events that it waits for, 0 once the caller proved to be the peer.

        Raises:
            ChannelError: if the caller is refused, with the reason.
        """


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
        stream = reception.wait_for_peer(deadline)
        if stream is None:
            raise reception.failure(f"{peer} did not connect within {in_seconds(wait)}", rite)
        return stream


class Reception:
    """The callers of a listener.

    Args:
        listener: Where they come from.
        admit: Makes a caller of a connection.
        teller: Is told who is refused, and when no connection can be taken.
    """

    def __init__(self, listener: Listener, admit: Callable[[socket.socket], Caller], teller: Teller) -> None:
        self._doors = {sock.fileno(): sock for sock in listener.sockets}
        self._admit_one = admit
        self._teller = teller
        self._callers: dict[int, Caller] = {}  # by descriptor, the oldest first
        self._poll = select.poll()
        self._refused = 0
        self._last_refusal = ""
        self._no_room = ""

    def wait_for_peer(self, deadline: float) -> Stream | None:
        """The peer's connection, or None if it did not come."""
        for door in self._doors.values():
            self._poll.register(door, select.POLLIN)
        while (left := deadline - time.monotonic()) > 0:
            for descriptor, _ in self._poll.poll(min(left, LONGEST_SLEEP) * 1000):
                if descriptor in self._doors:
                    self._admit(self._doors[descriptor])
                elif (caller := self._callers.get(descriptor)) is not None and self._proves(caller):
                    return self._let_go(descriptor).stream
        return None

    def failure(self, what: str, rite: str) -> ChannelError:
        """Why nobody was taken."""
        if self._refused:
            return ChannelError(
                f"{what}; callers refused: {self._refused}, the last one because: {self._last_refusal}"
            )
        if self._no_room:
            return ChannelTimeout(f"{what}: {self._no_room}")
        if self._callers:
            return ChannelTimeout(f"{what} ({len(self._callers)} connected without {rite})")
        return ChannelTimeout(f"{what}: is it started with connect= (--connect) to this address?")

    def close(self) -> None:
        """Hang up on every caller that is left."""
        for descriptor in list(self._callers):
            self._let_go(descriptor).stream.close()

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
        caller = self._admit_one(sock)
        if len(self._callers) >= MAX_HANDSHAKES:
            self._let_go(next(iter(self._callers))).stream.close()
        self._callers[caller.stream.fileno()] = caller
        self._poll.register(caller.stream, select.POLLIN)

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

    def _let_go(self, descriptor: int) -> Caller:
        self._poll.unregister(descriptor)
        return self._callers.pop(descriptor)
