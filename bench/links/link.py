"""What a link is, those that robots have, and the least time that an exchange over one takes."""

from __future__ import annotations

import random
from dataclasses import dataclass
from math import isfinite

QUEUE = 1000
"""Packets that wait at most before the thin end of a link; more are dropped, as by netem's default."""


@dataclass(frozen=True, slots=True)
class Link:
    """A link, the same in both directions, each with a queue and a rate of its own.

    Attributes:
        name: Its name on the command line.
        mbit: Millions of bits a second in each direction, IP and TCP headers included.
        delay_ms: One way, in milliseconds: the round trip is twice that.
        loss: The share of packets that are lost, each by itself, in each direction.
        what: What robots have it.
    """

    name: str
    mbit: float
    delay_ms: float
    loss: float = 0.0
    what: str = "as given"

    def __post_init__(self) -> None:
        """Refuse what no link is.

        Raises:
            ValueError: for a rate that is not positive, a negative delay, or a loss outside [0, 1).
        """
        if not (0 < self.mbit and isfinite(self.mbit) and 0 <= self.delay_ms < 60_000 and 0 <= self.loss < 1):
            raise ValueError(
                "a link needs a positive rate, a delay below a minute, and a loss from 0 to below 1"
            )

    def least_ms(self, exchanges: float, sent: float) -> float:
        """Exchanges, each after the one before, and the time that one direction's bytes take to leave."""
        return exchanges * self.delay_ms + sent * 8 / (self.mbit * 1e3)


LINKS = {
    link.name: link
    for link in (
        Link("wifi", 20, 5, what="a shared wireless network"),
        Link("radio", 1, 50, what="a long-range radio"),
        Link("satellite", 10, 300, what="a geostationary satellite: 600 ms there and back"),
        Link(
            "lossy",
            20,
            5,
            loss=0.02,
            what="the same wireless network at its edge: 2 % of the packets are lost",
        ),
    )
}
"""The links that are measured if nothing else is asked for."""


class Line:
    """One direction of a link: when does a packet come out at the other end?

    Packets leave one by one at the link's rate and arrive after its delay, in order. A packet is lost by
    chance, or where :data:`QUEUE` others wait. The chances come from ``seed``.
    """

    def __init__(self, link: Link, seed: int) -> None:
        self._seconds_a_byte = 8 / (link.mbit * 1e6)
        self._delay = link.delay_ms / 1e3
        self._loss = link.loss
        self._random = random.Random(seed)
        self._free = 0.0
        self._leaving: list[float] = []

    def arrival(self, now: float, size: int) -> float | None:
        """When a packet of so many bytes that comes now is at the far end; None if it is lost."""
        if self._random.random() < self._loss:
            return None
        self._leaving = [one for one in self._leaving if one > now]
        if len(self._leaving) >= QUEUE:
            return None
        self._free = max(now, self._free) + size * self._seconds_a_byte
        self._leaving.append(self._free)
        return self._free + self._delay
