"""The gallery's mark: what its ledger has promised, kept outside the tape's folder.

A ledger copied back from a backup has forgotten which slots were sent and which pairs were used, and would
mask other descriptors with the same masks. This small file remembers: one a gallery and party, in the user's
state folder. The ledger holds the same record, and every step stores it there first, here second, and only
then is anything sent: a ledger *behind* its mark was therefore restored, and a mark behind its ledger means a
crash between the two, when nothing had been sent yet. It cannot help on another machine, nor where both were
restored together; there the peer's heads do.

As text: one line of ASCII, ``spdz-gallery 1 <JSON> <blake2b-16>``, about 500 bytes, two more for each byte of
the program's text and 16 more for every run of void slots; :mod:`spdz.gallery.mark_file` keeps it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import Any

from spdz.gallery.heads import first_head
from spdz.gallery.runs import Runs, are_runs, joined
from spdz.gallery.strip import Rectangle, Strip, grown

MAX_TEXT = 1 << 16
_WORD = b"spdz-gallery 1"


@dataclass(frozen=True, slots=True)
class Side:
    """The slots of one party.

    Attributes:
        filled: Slots 0 to filled - 1 are used for ever.
        head: The chained hash over them (:mod:`spdz.gallery.heads`), 32 bytes.
        void: Those that hold nothing, or no longer.
        noted: Those with a note.
    """

    filled: int
    head: bytes
    void: Runs = ()
    noted: Runs = ()

    def follows(self, earlier: Side) -> bool:
        """Whether this can have become of ``earlier``: nothing was taken back."""
        still_void = joined(self.void, earlier.void) == self.void
        still_noted = joined(self.noted, earlier.noted) == self.noted
        same = self.head == earlier.head or (self.filled, self.void) != (earlier.filled, earlier.void)
        return self.filled >= earlier.filled and still_void and still_noted and same


@dataclass(frozen=True, slots=True)
class Mark:
    """Everything that must never go back in time, public facts only.

    Attributes:
        tape: The gallery tape's hex id.
        party: Whose ledger it is.
        sequence: Number of durable steps so far.
        sides: The slots of party 0 and of party 1.
        text: What the gallery computes, once it is pinned.
        done: The rectangle of pairs that are used, burnt ones included.
        flight: The strip of which shares may have been sent.
        destroyed: Whether a MAC check failed.
    """

    tape: str
    party: int
    sequence: int
    sides: tuple[Side, Side]
    text: bytes | None = None
    done: Rectangle = (0, 0)
    flight: Strip | None = None
    destroyed: bool = False

    @classmethod
    def first(cls, tape: str, party: int) -> Mark:
        """The mark of a gallery that was never used."""
        return cls(tape, party, 0, (Side(0, first_head(tape, 0)), Side(0, first_head(tape, 1))))

    def with_side(self, owner: int, side: Side) -> Mark:
        """The same with other slots of one party."""
        return replace(self, sides=(side, self.sides[1]) if owner == 0 else (self.sides[0], side))

    def follows(self, earlier: Mark) -> bool:
        """Whether this can have become of ``earlier``: nothing was taken back."""
        return (
            (self.tape, self.party) == (earlier.tape, earlier.party)
            and all(now.follows(then) for now, then in zip(self.sides, earlier.sides, strict=True))
            and earlier.text in (None, self.text)
            and self.done[0] >= earlier.done[0]
            and self.done[1] >= earlier.done[1]
            and self.destroyed >= earlier.destroyed
            and (self.sequence > earlier.sequence or self == earlier)
        )

    def encode(self) -> bytes:
        """One line of ASCII with its checksum."""
        flight = self.flight
        content = {
            "tape": self.tape,
            "party": self.party,
            "sequence": self.sequence,
            "sides": [
                {"filled": side.filled, "head": side.head.hex(), "void": side.void, "noted": side.noted}
                for side in self.sides
            ],
            "text": None if self.text is None else self.text.hex(),
            "done": self.done,
            "flight": flight
            and (flight.rows.start, flight.rows.stop, flight.columns.start, flight.columns.stop),
            "destroyed": self.destroyed,
        }
        line = b"%s %s" % (_WORD, json.dumps(content, separators=(",", ":")).encode())
        return b"%s %s\n" % (line, hashlib.blake2b(line, digest_size=16).hexdigest().encode())

    @classmethod
    def decode(cls, line: bytes) -> Mark:
        """Read what :meth:`encode` wrote.

        Raises:
            ValueError: It is not that, whole and consistent.
        """
        try:
            content = json.loads(line[len(_WORD) : -33])
            mark = cls._of(content)
            consistent = mark.encode() == line and mark._is_consistent()
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError("not a whole mark") from error
        if not consistent:
            raise ValueError("not a consistent mark")
        return mark

    @classmethod
    def _of(cls, content: dict[str, Any]) -> Mark:
        def runs(entries: Any) -> Runs:
            return tuple((int(start), int(stop)) for start, stop in entries)

        one, two = (
            Side(int(side["filled"]), bytes.fromhex(side["head"]), runs(side["void"]), runs(side["noted"]))
            for side in content["sides"]
        )
        rows, columns = content["done"]
        text, flight = content["text"], content["flight"]
        return cls(
            content["tape"],
            content["party"],
            content["sequence"],
            (one, two),
            None if text is None else bytes.fromhex(text),
            (int(rows), int(columns)),
            None if flight is None else Strip(range(*flight[:2]), range(*flight[2:])),
            content["destroyed"],
        )

    def _is_consistent(self) -> bool:
        if self.flight is not None:
            grown(self.done, self.flight)  # raises ValueError where it is not beside the rectangle
        return all(
            are_runs(side.void, side.filled)
            and are_runs(side.noted, side.filled)
            and 0 <= done <= side.filled
            for side, done in zip(self.sides, self.done, strict=True)
        )
