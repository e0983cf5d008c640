"""Where two robots stand in their batches, and which batch both can go on with. No I/O here.

Each side tells its position: the number of its current batch, and what it has of that batch and of the one
before. While neither restarts, the two numbers differ by one at most, since the last frame of a run may reach
one side only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from protocols.batch import Batch
from protocols.matching import sensible_count
from spdz.foundations.errors import OutOfStep, ProtocolViolation
from spdz.foundations.types import Json

_LONGEST_TOKEN = 64


@dataclass(frozen=True, slots=True)
class Offer:
    """What one side says of one of its batches.

    Attributes:
        token: Random name of this batch: a robot that restarts has another one.
        descriptors: How many there are.
        met: Token of the other side's batch that ``done`` is about.
        done: Tiles decided.
    """

    token: str
    descriptors: int
    met: str
    done: int

    @classmethod
    def of(cls, batch: Batch | None) -> Offer | None:
        """Of one's own batch, if there is one."""
        return None if batch is None else cls(batch.token, len(batch), batch.met, batch.done)


@dataclass(frozen=True, slots=True)
class Position:
    """Where one side stands.

    Attributes:
        number: Number of the current batch; None for a robot that goes on where the other one is.
        current: What there is of it; None if there will be no further batch.
        previous: What there is of the one before; None if it is not known any more.
    """

    number: int | None
    current: Offer | None
    previous: Offer | None = None

    def as_json(self) -> dict[str, Json]:
        """For a note to the peer."""
        return asdict(self)

    @classmethod
    def read(cls, note: Mapping[str, Any]) -> Position:
        """The peer's note, which may be anything.

        Raises:
            OutOfStep: if it is the note of :func:`protocols.matching.match`.
            ProtocolViolation: if it is no position.
        """
        if set(note) == {"descriptors"}:
            raise OutOfStep(
                "the peer uses match(), this side a Matcher (as the command does): use one of them on both"
            )
        number = note.get("number", -1)
        if set(note) != {"number", "current", "previous"} or not _is_number(number):
            raise ProtocolViolation("the peer's position among its batches is malformed")
        return cls(number, _read_offer(note["current"]), _read_offer(note["previous"]))

    def offer(self, number: int) -> Offer | None:
        """What there is of a batch."""
        if self.number is None:
            return None
        return {self.number: self.current, self.number - 1: self.previous}.get(number)

    def beside(self, other: Position) -> int:
        """The number, or the other side's where this side has none yet (0 if neither has)."""
        return next((number for number in (self.number, other.number) if number is not None), 0)


def _is_number(number: Any) -> bool:
    return number is None or (type(number) is int and 0 <= number < 1 << 63)


def _read_offer(fields: Any) -> Offer | None:
    if fields is None:
        return None
    if not isinstance(fields, dict) or set(fields) != {"token", "descriptors", "met", "done"}:
        raise ProtocolViolation("what the peer says of a batch is malformed")
    texts = fields["token"], fields["met"]
    if not all(isinstance(text, str) and len(text) <= _LONGEST_TOKEN for text in texts):
        raise ProtocolViolation("what the peer says of a batch is malformed")
    if type(fields["done"]) is not int or fields["done"] < 0:
        raise ProtocolViolation("what the peer says of a batch is malformed")
    return Offer(fields["token"], sensible_count(fields["descriptors"]), fields["met"], fields["done"])


def meeting(own: Position, peer: Position, name: str) -> tuple[int, Offer, int] | None:
    """Which batch both sides go on with; both come to the same answer.

    Args:
        own: This side's position.
        peer: The other side's.
        name: Its name, for the messages.

    Returns:
        Number of the batch, the peer's offer of it, and the tiles that both have decided; None if both sides
        have no further batch.

    Raises:
        OutOfStep: if there is no such batch: one side has stopped, or has been restarted.
    """
    here, there = own.beside(peer), peer.beside(own)
    number = min(here, there)
    mine, theirs = replace(own, number=here).offer(number), replace(peer, number=there).offer(number)
    if mine is not None and theirs is not None:
        both_met = mine.met == theirs.token and theirs.met == mine.token
        return number, theirs, min(mine.done, theirs.done) if both_met else 0
    if here == there:
        if mine is None and theirs is None:
            return None
        stopped, other = (name, "this robot") if theirs is None else ("this robot", name)
        raise OutOfStep(f"{stopped} has ended after {number} batches, and {other} has a batch {number}")
    behind, ahead = ("this robot", name) if here < there else (name, "this robot")
    raise OutOfStep(
        f"{behind} is at batch {number} and {ahead} at batch {max(here, there)}, and what is between is "
        "gone: a robot that was restarted goes on with the other one's number (first=)",
        here=here,
        there=there,
    )
