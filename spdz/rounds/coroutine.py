"""Sans-I/O protocols: coroutines whose only suspension is a request to whoever drives them.

A protocol is an ``async def``. It never touches a socket; it awaits :func:`exchange` (one round, both
directions at once) or :func:`check` (one MAC check over everything opened so far). No event loop is
involved: a driver steps the coroutine, carries the frames and hands back the peer's. So the same text
runs in lock-step in one thread, over a real channel, and in the dealer's and the meter's readings.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Coroutine, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from spdz.foundations.types import Buffer

T = TypeVar("T")


class Exchange:
    """A request for one round: send ``payload``, receive exactly ``expect`` bytes.

    Attributes:
        payload: Buffers whose concatenation is this party's message.
        expect: Length in bytes of the peer's message, known from the program.
        elements: Field or ring elements in ``payload`` (for the counters).
        is_check: True for the frame of a MAC check, which travels alone.
        is_posted: Whether the payload is on its way already.
    """

    __slots__ = ("elements", "expect", "is_check", "is_posted", "payload")

    def __init__(self, payload: Sequence[Buffer], expect: int, elements: int, is_check: bool = False) -> None:
        self.payload, self.expect, self.elements, self.is_check = payload, expect, elements, is_check
        self.is_posted = False

    def __repr__(self) -> str:
        return f"Exchange(expect={self.expect}, elements={self.elements}, is_check={self.is_check})"


@dataclass(frozen=True, slots=True)
class Check:
    """A request for one MAC check; a barrier over every lane of :func:`parallel`."""


class Post(Exchange):
    """A request to send what an exchange sends; the protocol goes on, and takes the reply by :data:`TAKE`."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Take:
    """A request for the reply of the exchange that was posted last."""


TAKE = Take()

Request: TypeAlias = Exchange | Check | Take
Protocol: TypeAlias = Coroutine[Request, Any, T]


@types.coroutine
def _request(request: Request) -> Generator[Request, Any, Any]:
    return (yield request)


async def exchange(payload: Sequence[Buffer], expect: int, elements: int) -> memoryview:
    """Spend one round: send ``payload`` and return the peer's ``expect`` bytes."""
    reply: memoryview = await _request(Exchange(payload, expect, elements))
    return reply


async def check() -> None:
    """Have everything opened so far checked.

    Raises :class:`~spdz.foundations.errors.MacCheckFailed` if it fails.
    """
    await _request(Check())


class _Lane:
    """One protocol of a :func:`parallel` group: its coroutine, what it waits for, its result."""

    __slots__ = ("coroutine", "posted", "request", "result")

    def __init__(self, coroutine: Protocol[Any]) -> None:
        self.coroutine = coroutine
        self.request: Request | None = None
        self.result: Any = None
        self.step(None)

    def step(self, reply: memoryview | None) -> None:
        try:
            request = self.coroutine.send(reply)
            if isinstance(request, Post):  # the lanes' frames travel as one
                self.posted = request
                request = self.coroutine.send(None)
            self.request = self.posted if isinstance(request, Take) else request
        except StopIteration as done:
            self.request, self.result = None, done.value


async def parallel(*protocols: Protocol[Any]) -> list[Any]:
    """Run independent protocols in the same rounds and return their results in order.

    The frames of all lanes that exchange travel as one frame. A lane that asks for a check waits until
    every other lane asks for one too or has finished: one check at a time, and it travels alone.
    """
    others = [type(one).__name__ for one in protocols if not isinstance(one, (Coroutine, Generator))]
    if others:
        for protocol in protocols:
            if isinstance(protocol, (Coroutine, Generator)):
                protocol.close()
        raise TypeError(f"parallel takes what is not awaited yet, such as nonnegative(x), not {others[0]}")
    lanes: list[_Lane] = []
    try:
        for protocol in protocols:
            lanes.append(_Lane(protocol))
        while waiting := [lane for lane in lanes if lane.request is not None]:
            talking = [(lane, lane.request) for lane in waiting if isinstance(lane.request, Exchange)]
            if not talking:
                await check()
                for lane in waiting:
                    lane.step(None)
                continue
            reply = await exchange(
                [buffer for _, request in talking for buffer in request.payload],
                sum(request.expect for _, request in talking),
                sum(request.elements for _, request in talking),
            )
            start = 0
            for lane, request in talking:
                lane.step(reply[start : start + request.expect])
                start += request.expect
        return [lane.result for lane in lanes]
    finally:
        for protocol in protocols:
            protocol.close()


def run_silently(protocol: Protocol[T], on_request: Callable[[Request], None] | None = None) -> T:
    """Drive a protocol that has nobody to talk to (the dealer's and the meter's readings).

    Every request is answered with an empty message; ``on_request`` sees each of them.
    """
    reply: memoryview | None = None
    try:
        while True:
            request = protocol.send(reply)
            reply = memoryview(b"") if isinstance(request, Exchange) else None
            if on_request is not None:
                on_request(request)
    except StopIteration as done:
        result: T = done.value
        return result
