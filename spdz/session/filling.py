"""New slots of a gallery: masked, made durable, sent, and kept at the other side.

What is sent for a slot is in the ledger first; what comes is checked and in the ledger before anything is
computed with it. A slot whose words would tell something of the vector (:mod:`spdz.values.input_mask`) is
told as void, and the vector takes the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spdz.channels import Channel, FrameKind
from spdz.channels.frames import HEADER_BYTES, MAX_FRAME
from spdz.foundations.errors import OutOfStep, ProtocolViolation, TapeExhausted
from spdz.foundations.types import IntArray, Json
from spdz.gallery.ledger import Ledger
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.session.agreement import Agreement
from spdz.session.handshake import shown
from spdz.session.meeting import MOST, PREPARED
from spdz.session.shelf import Shelf
from spdz.session.strips import Step
from spdz.values.input_mask import element_bytes, inside, pack, unpack

_BYTES = 32 << 20
"""Most bytes of words sent at a time."""

Entry = tuple[int, bytes | None]
"""A slot, and its words; None where it is void."""


@dataclass(slots=True)
class Filling:
    """The side of a gallery session that fills slots.

    Attributes:
        tape: The gallery's tape.
        terms: What it is for.
        ledger: What was filled.
        shelves: The slots of party 0 and of party 1.
        channel: The connection.
        text: What the gallery computes.
        waiting: Quantised descriptors that the next step brings.
        sent: Own slots that the peer has.
        accept: Descriptors that the peer may still bring in this step; None for any number.
    """

    tape: GalleryTape
    terms: Terms
    ledger: Ledger
    shelves: tuple[Shelf, Shelf]
    channel: Channel
    text: bytes
    waiting: list[IntArray] = field(repr=False)
    sent: int = 0
    accept: int | None = None

    @property
    def party(self) -> int:
        """0 or 1."""
        return int(self.tape.header.party)

    @property
    def room(self) -> int:
        """Own slots that are neither used nor waited for."""
        capacity = self.tape.header.capacity[self.party]
        return capacity - self.ledger.slots[self.party].filled - len(self.waiting)

    def refuse_more_than(self, room: int, wanted: int) -> None:
        """Raise :class:`TapeExhausted` where more is wanted than there is room for."""
        if wanted > room:
            header = self.tape.header
            raise TapeExhausted(
                f"this gallery has {header.capacity[self.party]} slots for {header.name}: {max(0, room)} are "
                f"free and {wanted} are needed. Nothing was used. Deal more: {header.dealer_command}"
            )

    def exchange(self, agreement: Agreement, step: Step) -> bool:
        """Tell, fill, send and keep the new slots of both sides.

        Once any slot is filled the text is pinned, for what is opened then may depend on it.

        Returns:
            Whether either side has more to bring.
        """
        own, peer = self.ledger.slots[self.party], self.ledger.slots[1 - self.party]
        unsent = own.filled - self.sent
        entries, taken = self._masked(max(1, min(MOST, _BYTES // self._size)) - unsent)
        own.fill(entries)  # before anything is told: a void slot stays void, whatever the peer does
        self.place(self.party, entries)
        del self.waiting[:taken]
        step.own += [slot for slot, words in entries if words is not None]
        told = list(enumerate(own.eps(self.sent, own.filled), self.sent))
        offer: dict[str, Json] = {
            "from": self.sent,
            "slots": len(told),
            "void": [i for i, (_, words) in enumerate(told) if words is None],
            "more": bool(self.waiting),
        }
        answer = agreement.control(offer, *offer)
        count, void = self._read_offer(answer, peer.filled)
        frames = [words for _, words in told if words is not None]
        reply = self.channel.exchange(FrameKind.DATA, frames, self._size * (count - len(void)))
        step.filling.stats.rounds += 1
        step.filling.stats.bytes_sent += HEADER_BYTES + sum(map(len, frames))
        received = self._received(peer.filled, count, void, reply)
        self.place(1 - self.party, received)  # refuses bad words before they are kept
        peer.fill(received, text=self.text if own.filled or peer.filled or received else None)
        step.peer += [slot for slot, words in received if words is not None]
        self.sent = own.filled
        return bool(self.waiting) or bool(answer["more"])

    def restore(self, ready: tuple[int, int], alpha: int | None) -> None:
        """Read what earlier sessions have filled; what the peer has not prepared is prepared once more.

        Args:
            ready: Slots of either party, from the first on, that both sides have prepared.
            alpha: This party's share of the MAC key; None in semi-honest mode.
        """
        for shelf in self.shelves:
            slots = self.ledger.slots[shelf.owner]
            for start in range(0, slots.filled, PREPARED):
                entries = list(enumerate(slots.eps(start, min(start + PREPARED, slots.filled)), start))
                self.place(shelf.owner, entries)
                known = [slot for slot, words in entries if words is not None and slot < ready[shelf.owner]]
                shelf.restore(known, [slots.noted(slot) or b"" for slot in known], alpha)

    def take_back(self, slots: Sequence[int]) -> None:
        """Bring the descriptors in own slots that become void once more, in other slots."""
        own, shelf, terms = self.ledger.slots[self.party], self.shelves[self.party], self.terms
        held = [(slot, words) for slot in slots if (words := own.eps(slot, slot + 1)[0]) is not None]
        if held:
            raw = b"".join(words for _, words in held)
            masked = unpack(raw, (len(held), terms.dim), terms.word_bits, terms.entry)
            self.waiting[:0] = list(masked - shelf.masks([slot for slot, _ in held]))

    def place(self, owner: int, entries: Sequence[Entry]) -> None:
        """Put words on the shelf.

        Raises:
            ProtocolViolation: if some lie outside the interval of honest words.
        """
        held = [(slot, words) for slot, words in entries if words is not None]
        if held:
            terms = self.terms
            raw = b"".join(words for _, words in held)
            words = unpack(raw, (len(held), terms.dim), terms.word_bits, terms.entry)
            self.shelves[owner].place([slot for slot, _ in held], words)

    @property
    def _size(self) -> int:
        return self.terms.dim * element_bytes(self.terms.word_bits)

    def _masked(self, limit: int) -> tuple[list[Entry], int]:
        """Words for what waits, in the next own slots, and how many descriptors they are."""
        own, shelf, terms = self.ledger.slots[self.party], self.shelves[self.party], self.terms
        entries: list[Entry] = []
        slot, done = own.filled, 0
        while (waiting := len(self.waiting) - done) and len(entries) < limit:
            count = min(waiting, limit - len(entries), shelf.capacity - slot)
            if not count:
                self.refuse_more_than(0, waiting)
            words = np.stack(self.waiting[done : done + count]) + shelf.masks(range(slot, slot + count))
            good = inside(words, terms.word_bits, terms.entry).all(axis=1)
            stop = count if good.all() else int(np.argmin(good))
            packed = pack(words[:stop], terms.word_bits).reshape(stop, self._size)
            entries += [(slot + i, packed[i].tobytes()) for i in range(stop)]
            if stop < count:
                entries.append((slot + stop, None))
            slot, done = own.filled + len(entries), done + stop
        return entries, done

    def _read_offer(self, answer: dict[str, Any], filled: int) -> tuple[int, set[int]]:
        """How many slots come, and which of them are void."""
        count, void = answer["slots"], answer["void"]
        capacity = self.tape.header.capacity[1 - self.party]
        well_formed = (
            type(count) is int
            and type(answer["more"]) is bool
            and bool(count or not answer["more"])  # whoever has more to bring brings some
            and 0 <= count <= min(MOST, capacity - filled)
            and isinstance(void, list)
            and all(type(one) is int and 0 <= one < count for one in void)
            and self._size * (count - len(set(void))) <= MAX_FRAME
        )
        if not well_formed:
            raise ProtocolViolation("the peer's offer of slots is malformed, or more than its gallery holds")
        if answer["from"] != filled:
            raise OutOfStep(f"the peer sends slots from {shown(answer['from'], 8)} on, and {filled} are here")
        if self.accept is not None:
            self.accept -= count - len(set(void))
            if self.accept < 0:
                raise ProtocolViolation("the peer brings more descriptors than were agreed on: refused")
        return count, set(void)

    def _received(self, first: int, count: int, void: set[int], reply: Any) -> list[Entry]:
        received: list[Entry] = []
        start = 0
        for i in range(count):
            words = None
            if i not in void:
                words = bytes(reply[start : start + self._size])
                start += self._size
            received.append((first + i, words))
        return received
