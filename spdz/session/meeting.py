"""Two sides of a gallery that meet again: what both hold, what is void, and which strip goes on.

Each side tells what it has filled, prepared and compared. Nothing that one side says is believed against what
the other holds, but for what only makes slots or pairs useless: a slot that is void on one side is void on
both, and a strip that cannot be run again is burnt on both. How far the two may differ is bounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from spdz.foundations.errors import ProtocolViolation, TapeMismatch
from spdz.foundations.types import Json
from spdz.gallery.ledger import Ledger
from spdz.gallery.runs import are_runs, runs_of, slots_in
from spdz.gallery.strip import Rectangle, Strip, between, grown
from spdz.readings.gallery_plan import GalleryPlan
from spdz.session.strips import STRIP_PAIRS, within

MOST = 4096
"""Slots by which the two sides may differ, and slots that one may make void: it bounds what a lie costs."""


PREPARED = 128
"""Slots of a party that are prepared at a time."""


@dataclass(frozen=True, slots=True)
class Standpoint:
    """What one side says of itself.

    Attributes:
        filled: Slots used of party 0 and of party 1.
        ready: Slots among them, from the first on, that were prepared.
        void: Slots that hold nothing, of party 0 and of party 1.
        done: The rectangle of pairs that were compared.
        flight: The strip that was begun.
    """

    filled: tuple[int, int]
    ready: tuple[int, int]
    void: tuple[list[int], list[int]]
    done: Rectangle
    flight: Strip | None

    @classmethod
    def of(cls, ledger: Ledger) -> Standpoint:
        """This side's."""
        first, second = ledger.slots
        return cls(
            (first.filled, second.filled),
            (first.ready, second.ready),
            (first.voids, second.voids),
            ledger.done,
            ledger.flight,
        )

    def as_json(self) -> dict[str, Json]:
        """For a control message."""
        flight = self.flight
        return {
            "filled": list(self.filled),
            "ready": list(self.ready),
            "void": [[list(run) for run in runs_of(slots)] for slots in self.void],
            "done": list(self.done),
            "flight": None
            if flight is None
            else [flight.rows.start, flight.rows.stop, flight.columns.start, flight.columns.stop],
        }

    @classmethod
    def read(cls, fields: Mapping[str, Any], capacity: tuple[int, int]) -> Standpoint:
        """The peer's, which may be anything.

        Raises:
            ProtocolViolation: if it is not well-formed.
        """
        try:
            filled, prepared, done = (_pair(fields[name], capacity) for name in ("filled", "ready", "done"))
            first, second = fields["void"]
            void = (_slots(first, filled[0]), _slots(second, filled[1]))
            flight = fields["flight"]
            strip, used = None, done
            if flight is not None:
                a, b, c, d = (_whole(number, max(capacity)) for number in flight)
                strip = Strip(range(a, b), range(c, d))
                used = grown(done, strip)
            if used[0] > filled[0] or used[1] > filled[1] or (0 in done and any(done)):
                raise ValueError("pairs of slots that are not filled, or no rectangle of pairs")
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise ProtocolViolation(f"the peer's account of its gallery is malformed ({error})") from None
        return cls(filled, prepared, void, done, strip)


def _pair(value: Any, most: Sequence[int]) -> tuple[int, int]:
    first, second = value
    return _whole(first, most[0]), _whole(second, most[1])


def _whole(number: Any, most: int) -> int:
    if type(number) is not int or not 0 <= number <= most:
        raise ValueError(f"a number of slots lies between 0 and {most}")
    return number


def _slots(value: Any, filled: int) -> list[int]:
    runs = tuple((_whole(start, filled), _whole(stop, filled)) for start, stop in value)
    if len(runs) > MOST or not are_runs(runs, filled):
        raise ValueError("void slots are told as runs, in order, and not too many")
    return slots_in(runs)


@dataclass(frozen=True, slots=True)
class Agreed:
    """What follows for this side.

    Attributes:
        void: Slots that are void from now on, of party 0 and of party 1, as far as they are filled here.
        lost: Own slots that the peer has and this side has not: they are used and void.
        send: The first own slot that the peer has not.
        ready: Slots, from the first on, that both have prepared, of party 0 and of party 1.
        again: Strips to run first, in order: one side may have finished the first of them.
        burn: Strips that cannot be run again, in order.
    """

    void: tuple[list[int], list[int]]
    lost: int
    send: int
    ready: tuple[int, int]
    again: list[Strip]
    burn: list[Strip]


def meet(own: Standpoint, peer: Standpoint, party: int, plan: GalleryPlan) -> Agreed:
    """Compare both sides' accounts.

    Args:
        own: This side's.
        peer: The peer's.
        party: This side's number.
        plan: The program's. Where everything opened is checked before anything that depends on it is sent,
            every share is the same when it is run again; else what was begun and not finished is given up.

    Raises:
        TapeMismatch: if they differ by more than one step of an honest run.
    """
    for owner in (0, 1):
        unready = peer.filled[owner] - peer.ready[owner]
        told = len(set(peer.void[owner]) - set(own.void[owner]))
        if max(abs(own.filled[owner] - peer.filled[owner]), unready, told) > MOST:
            raise TapeMismatch(
                f"this side knows {own.filled[owner]} slots of party {owner} as filled and the peer "
                f"{peer.filled[owner]}: one of the galleries was restored from an old copy. Deal new tapes"
            )
    missing = peer.filled[party] - own.filled[party]
    # What the peer has forgotten of its own slots is used and void on both sides.
    forgotten = range(peer.filled[1 - party], own.filled[1 - party])
    void = [set(own.void[owner]) | set(peer.void[owner]) for owner in (0, 1)]
    void[1 - party] |= set(forgotten)
    for i in (0, 1):
        if not plan.slots[i].repeatable:
            void[i] |= _half_prepared(own, peer, i, void[i])
    first, second = (sorted(slot for slot in void[i] if slot < own.filled[i]) for i in (0, 1))
    again, burn = _strips(own, peer, plan.pair.repeatable)
    for strip in (*again, *burn):
        rows, columns = (min(own.filled[i], peer.filled[i]) for i in (0, 1))
        if strip.pairs > STRIP_PAIRS and 1 not in (len(strip.rows), len(strip.columns)):
            raise TapeMismatch(f"{strip} are more than any step compares at a time: deal new tapes")
        if not within(strip, (rows, columns)):
            raise TapeMismatch(
                f"{strip} were begun, and one side knows {rows} x {columns} slots only: its gallery was "
                "restored from an old copy. Deal new tapes"
            )
    ready = (min(own.ready[0], peer.ready[0]), min(own.ready[1], peer.ready[1]))
    return Agreed((first, second), max(0, missing), peer.filled[party], ready, again, burn)


def _half_prepared(own: Standpoint, peer: Standpoint, owner: int, void: set[int]) -> set[int]:
    """Slots that one side alone has prepared, and those that either may have begun with."""
    ready, ahead = sorted((own.ready[owner], peer.ready[owner]))
    both = min(own.filled[owner], peer.filled[owner])
    begun = [slot for slot in range(ahead, both) if slot not in void][:PREPARED]
    return {*range(ready, min(ahead, both)), *begun}


def _strips(own: Standpoint, peer: Standpoint, repeatable: bool) -> tuple[list[Strip], list[Strip]]:
    """The strips to run again, and those to burn.

    A side that has finished a strip begins the next before it can know that the other has finished it too. So
    one may be a strip behind, while the other has begun the next.
    """
    if own.done == peer.done:
        flights = {strip for strip in (own.flight, peer.flight) if strip is not None}
        if len(flights) > 1:
            raise TapeMismatch("the two galleries are in different strips: deal new tapes")
        return _told(repeatable, list(flights))
    behind, ahead = (own, peer) if own.done <= peer.done else (peer, own)
    try:
        strips = between(behind.done, ahead.done)
    except ValueError:
        strips = []
    if len(strips) != 1 or behind.flight not in (None, strips[0]):
        raise TapeMismatch(
            f"this side has compared {own.done[0]} x {own.done[1]} slots and the peer "
            f"{peer.done[0]} x {peer.done[1]}: one of the galleries was restored from an old copy. "
            "Deal new tapes"
        )
    given_up = behind.flight is None  # then it stays without results there
    again, burn = _told(repeatable and not given_up, strips)
    next_again, next_burn = _told(repeatable, [] if ahead.flight is None else [ahead.flight])
    return again + next_again, burn + next_burn


def _told(repeatable: bool, strips: list[Strip]) -> tuple[list[Strip], list[Strip]]:
    return (strips, []) if repeatable else ([], strips)
