"""What two agents tell each other at the beginning of a turn, and what they take of it.

A turn is one exchange of a note, then perhaps a gallery's step or the showing of matches. Either side begins
one when it has something to say; the other sees that and begins its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from protocols.agent.matches import Outcome, Pair
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import Json

TOGETHER = 256
"""Most descriptors that one side brings in a turn."""
MOST_PAIRS = 8
"""Most matches that are shown in a turn."""
MOST_OUTCOMES = 64
"""Most verdicts that are told in a turn."""

_NUMBERS = ("new", "due", "room")
_FLAGS = ("open", "hold")
_LEAVING = ("", "ended", "struck")
_STATES = ("verified", "rejected")
_KEYS = {"new", "due", "room", "open", "want", "outcomes", "leave", "hold"}


@dataclass(frozen=True, slots=True)
class Saying:
    """One side's note.

    Attributes:
        new: Descriptors that this side brings now, if the peer takes them.
        due: How many of them are in slots already and must be taken first.
        room: How many descriptors of the peer's it takes now: 0 while a budget is spent.
        open: Whether pairs of filled slots wait to be compared on this side.
        want: Matches (own slot, peer's slot) whose other half it has not seen.
        outcomes: Its verdicts that the peer has perhaps not heard.
        leave: Empty, or why it ends now: ``"ended"``, or ``"struck"`` if the peer has too many strikes.
        hold: Whether nothing is to be compared in this turn: the pairs that wait are more than may be now.
    """

    new: int
    due: int
    room: int
    open: bool
    want: Sequence[Pair]
    outcomes: Sequence[Outcome]
    leave: str
    hold: bool

    def as_json(self) -> dict[str, Json]:
        """As it is sent."""
        return {
            "new": self.new,
            "due": self.due,
            "room": self.room,
            "open": self.open,
            "want": [list(pair) for pair in self.want],
            "outcomes": [[*one.pair, one.state] for one in self.outcomes],
            "leave": self.leave,
            "hold": self.hold,
        }

    @classmethod
    def read(cls, note: Mapping[str, Any], capacity: tuple[int, int]) -> Saying:
        """Read the peer's note; its pairs become (own slot, peer's slot) of this side.

        Args:
            note: Anything.
            capacity: Slots of this side and of the peer.

        Raises:
            ProtocolViolation: if it is no such note.
        """
        if set(note) != _KEYS:
            raise ProtocolViolation(_MALFORMED)
        numbers = all(type(note[name]) is int and 0 <= note[name] <= 1 << 32 for name in _NUMBERS)
        if (
            not numbers
            or any(type(note[name]) is not bool for name in _FLAGS)
            or note["leave"] not in _LEAVING
        ):
            raise ProtocolViolation(_MALFORMED)
        outcomes = []
        for entry in _entries(note["outcomes"], MOST_OUTCOMES, 3):
            if entry[2] not in _STATES:
                raise ProtocolViolation(_MALFORMED)
            outcomes.append(Outcome(_pair(entry[:2], capacity), entry[2]))
        want = [_pair(entry, capacity) for entry in _entries(note["want"], MOST_PAIRS, 2)]
        return cls(**{**note, "want": want, "outcomes": outcomes})


def read_slots(slots: object, most: int, capacity: int) -> list[int]:
    """Read ascending slots of a peer's note.

    Raises:
        ProtocolViolation: if they are none.
    """
    if (
        not isinstance(slots, list)
        or len(slots) > most
        or not all(type(slot) is int and 0 <= slot < capacity for slot in slots)
        or sorted(set(slots)) != slots
    ):
        raise ProtocolViolation(_MALFORMED)
    return slots


_MALFORMED = "the peer's agent sent a malformed note: install the same release on both robots"


def _entries(value: object, most: int, length: int) -> list[list[Any]]:
    if not isinstance(value, list) or len(value) > most:
        raise ProtocolViolation(_MALFORMED)
    if not all(isinstance(entry, list) and len(entry) == length for entry in value):
        raise ProtocolViolation(_MALFORMED)
    return value


def _pair(entry: Sequence[Any], capacity: tuple[int, int]) -> Pair:
    theirs, mine = entry
    if not all(type(slot) is int for slot in entry) or not (
        0 <= mine < capacity[0] and 0 <= theirs < capacity[1]
    ):
        raise ProtocolViolation(_MALFORMED)
    return mine, theirs
