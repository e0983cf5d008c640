"""Opening descriptors that were found to match, under MAC: the very vectors that were compared.

Both ways in the same rounds (specification, section 26): which slots (26.1), agreeing on them (26.2), the
vectors x (26.3), r = x - eps recorded by the owner from its mask and by the receiver from what came and the
words that it keeps (26.4), a MAC check (26.5). x is a function of ledger and tape, so that opening a slot
again, after a break too, shows the same bytes.

Cost: a vector takes N numbers of 3 bytes (at norm 1), all together one round and a check for every
``_TOGETHER`` coordinates. Security: another vector than the one that was compared passes if the cheater
guesses alpha_i e, one in p. There is no fairness. In the semi-honest mode nothing is proved.
"""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

import numpy as np

from spdz.arithmetic import field as elements
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.foundations.errors import MacCheckFailed, OutOfStep, ProtocolViolation, TapeMismatch
from spdz.foundations.stats import Stats
from spdz.foundations.types import FloatArray, IntArray, Json
from spdz.gallery.ledger import Ledger
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import GalleryPlan
from spdz.rounds.coroutine import Protocol, check, exchange
from spdz.rounds.mac_check import MacCheck
from spdz.rounds.wire import to_bytes
from spdz.session.agreement import Agreement
from spdz.session.handshake import shown
from spdz.session.shelf import Shelf
from spdz.session.strips import decode_results
from spdz.values.input_mask import pack, read_packed
from spdz.values.standing import Standing

MOST = 2048
"""Slots of one party that are opened in one call; their numbers fit one control message."""
_TOGETHER = 1 << 18
"""Coordinates of one party that are opened at a time: 4 MB of elements an array."""

Opened = tuple[list[int], list[int]]
"""Slots of party 0 and of party 1, ascending."""


class Connection(Interface):
    """What opening needs of a session."""

    def run(self, protocol: Protocol[Any], stats: Stats) -> Any:
        """Run a protocol on the connection."""


@dataclass(slots=True)
class Revealing:
    """The side of a gallery session that opens descriptors.

    Attributes:
        tape: The gallery's tape.
        terms: What it is for.
        plan: What the meter saw of the terms.
        ledger: What was found.
        shelves: The slots of party 0 and of party 1.
    """

    tape: GalleryTape
    terms: Terms
    plan: GalleryPlan
    ledger: Ledger
    shelves: tuple[Shelf, Shelf]
    _matched: tuple[set[int], set[int]] = field(default_factory=lambda: (set(), set()), repr=False)
    _strips: int = 0

    @property
    def party(self) -> int:
        """0 or 1."""
        return int(self.tape.header.party)

    def checked(self, own: Sequence[int], expected: Sequence[int]) -> Opened:
        """What is to be opened, of party 0 and of party 1 (26.1).

        Raises:
            ValueError: if the gallery opens no bits, or a slot is in no pair that matched; nothing was sent.
        """
        if not self.plan.bits:
            raise ValueError("this gallery reveals scores: it finds no matches, and opens no descriptors")
        self._read_on()
        asked = [_numbers(own), _numbers(expected)]
        opened = (asked[self.party], asked[1 - self.party])
        for owner, slots in enumerate(opened):
            matched, name = self._matched[owner], self.tape.header.agents[owner]
            if strange := [slot for slot in slots if slot not in matched]:
                raise ValueError(
                    f"slot {strange[0]} of {name} is in no pair that was found to match here, and no "
                    "other descriptor is opened: nothing was sent"
                )
            if len(slots) > MOST:
                raise ValueError(f"at most {MOST} slots of a robot are opened at a time, not {len(slots)}")
        return opened

    def open(self, connection: Connection, agreement: Agreement, opened: Opened) -> dict[int, FloatArray]:
        """Open slots on both sides, and give the peer's vectors (26.2 to 26.6)."""
        self._agree(agreement, opened)
        together = max(1, _TOGETHER // self.terms.dim)
        result: dict[int, FloatArray] = {}
        for start in range(0, max(map(len, opened)), together):
            first, second = (slots[start : start + together] for slots in opened)
            protocol = self._open((first, second), agreement.mac_check)
            try:
                vectors = connection.run(protocol, Stats())
            except MacCheckFailed:
                raise MacCheckFailed(
                    f"a descriptor that {self.tape.header.peer} opened is not the one that was compared, or "
                    "the connection was tampered with: none is shown, and this gallery must not be used again"
                ) from None
            result.update(zip((first, second)[1 - self.party], vectors / (1 << FRACTION_BITS), strict=True))
        return result

    def _read_on(self) -> None:
        """Take note of the matches of strips that were committed since; void slots have none."""
        void = [slots.voids for slots in self.ledger.slots]
        for strip, stored in self.ledger.results(self._strips):
            found = decode_results(strip, stored, bits=True)
            for owner, slots in enumerate((strip.rows, strip.columns)):
                lost = [slot - slots.start for slot in void[owner] if slot in slots]
                found[lost if owner == 0 else (slice(None), lost)] = False
            for owner, slots in enumerate((strip.rows, strip.columns)):
                matched = np.flatnonzero(found.any(axis=1 - owner)) + slots.start
                self._matched[owner].update(matched.tolist())
            self._strips += 1

    def _agree(self, agreement: Agreement, opened: Opened) -> None:
        """26.2."""
        words = hashlib.sha256()
        for shelf, slots in zip(self.shelves, opened, strict=True):
            for slot in slots:
                words.update(shelf.words(slot))
        own: dict[str, Json] = {"open": [list(slots) for slots in opened], "words": words.hexdigest()}
        peer = agreement.control(own, *own)
        if peer["open"] != own["open"]:
            raise OutOfStep(
                f"the peer opens and expects slots {shown(peer['open'], 100)} (the pair's first robot's, its "
                f"second's), and this side {shown(own['open'], 100)}: none was opened. Agree on them first"
            )
        if peer["words"] != own["words"]:
            raise TapeMismatch(
                "the two sides of the gallery differ in what the slots to be opened hold: one of them was "
                "restored from another copy. Deal new tapes"
            )

    async def _open(self, opened: Opened, mac_check: MacCheck | None) -> IntArray:
        """26.3 to 26.5 for some slots of either party; the peer's vectors, raw."""
        known = [shelf.standing(slots) for shelf, slots in zip(self.shelves, opened, strict=True)]
        own, theirs = known[self.party], known[1 - self.party]
        bits, size = (2 * self.terms.norm).bit_length(), len(opened[1 - self.party]) * self.terms.dim
        vectors = own.words - own.offsets
        sent = to_bytes(pack(vectors + self.terms.norm, bits))
        reply = await exchange([sent], size * -(-bits // 8), 0)
        received = read_packed(reply, theirs.words.shape, bits) - self.terms.norm
        if (received > self.terms.norm).any():
            raise ProtocolViolation("the peer opened a descriptor of numbers that no honest one has")
        if mac_check is not None:
            for standing in known:
                _record(mac_check, standing, received)
            await check()
        return received


def _record(mac_check: MacCheck, standing: Standing, received: IntArray) -> None:
    """26.4 for the slots of one party."""
    if not len(standing):
        return
    if standing.mac is None:
        raise ValueError("there are no MACs in the semi-honest mode")
    r = received - standing.words if standing.s is None else -standing.s
    mac_check.record(elements.from_int64(r), standing.mac)


def _numbers(slots: Sequence[int]) -> list[int]:
    try:
        return sorted({operator.index(slot) for slot in slots})
    except TypeError:
        raise ValueError("slots are given by their numbers") from None
