"""A gallery on one connection: both sides bring what is new, and all pairs that are new are compared.

::

    gallery.add(descriptors)              # at any time, by either side; also nothing
    for block in gallery.step().blocks:   # both sides call it equally often
        ...

A step (specification, section on galleries): fill new slots (:mod:`spdz.session.filling`); agree on all that
both hold; prepare the new slots and prove their norms; then compare strip by strip. A strip's results are
durable before the caller sees them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy.typing as npt

from spdz.channels import Channel, FrameKind
from spdz.foundations.errors import TapeMismatch
from spdz.foundations.stats import Stats
from spdz.foundations.types import FloatArray, IntArray, Json
from spdz.gallery.ledger import Ledger
from spdz.gallery.slots import Notes
from spdz.gallery.strip import Strip
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.readings.party import Party
from spdz.readings.streams import RecordStream
from spdz.rounds.coroutine import parallel
from spdz.rounds.mac_check import drive
from spdz.session import handshake
from spdz.session.admission import checked_plan, pinned_text, quantised, refuse_unproved
from spdz.session.agreement import Agreement
from spdz.session.comparing import Comparing
from spdz.session.driver import run_channel
from spdz.session.filling import Filling
from spdz.session.holdings import Holdings
from spdz.session.meeting import PREPARED
from spdz.session.returning import meet_again
from spdz.session.revealing import Revealing
from spdz.session.shelf import Shelf, configured
from spdz.session.strips import Block, Step, held_slots


class GallerySession(Holdings):
    """One party of a gallery, connected to the other.

    Args:
        tape: This party's gallery tape, open; the session closes it.
        ledger: The tape's ledger, open; the session closes it.
        channel: A connected channel; the session closes it.
        terms: What the tape was dealt for, with the threshold.
        waiting: Quantised descriptors for the next step. What a step that is broken off has not filled is
            left in this list.

    Raises:
        TapeMismatch: if tape, terms and peer do not belong together, or the ledgers contradict each other.
        ProtocolViolation: if the peer's account is malformed.
    """

    def __init__(
        self,
        tape: GalleryTape,
        ledger: Ledger,
        channel: Channel,
        terms: Terms,
        waiting: list[IntArray] | None = None,
    ) -> None:
        super().__init__(channel, "gallery")
        self._tape, self._ledger, self._terms = tape, ledger, terms
        self._shelves = (Shelf(tape, terms, 0), Shelf(tape, terms, 1))
        self._waiting = [] if waiting is None else waiting
        self._ready = [0, 0]
        with self._guard:
            self._plan = checked_plan(tape, terms)
            text = pinned_text(self._plan, terms)
            self._filling = Filling(tape, terms, ledger, self._shelves, channel, text, self._waiting)
            self._comparing = Comparing(tape, terms, self._plan, ledger, self._shelves)
            self._revealing = Revealing(tape, terms, self._plan, ledger, self._shelves)
            own = handshake.Hello.of_gallery(tape.header)
            message = channel.exchange(FrameKind.CONTROL, [own.encode()], None)
            peer = handshake.Hello.decode(bytes(message))
            handshake.compare(own, peer)
            session = handshake.session_id(own, peer)
            channel.bind(int.from_bytes(session[:4], "little"))
            self._agreement = Agreement(channel, self.party, session, self._alpha)
            self._meet()

    def __repr__(self) -> str:
        header, state = self._tape.header, f": dead ({self._dead})" if self._dead else ""
        return f"<gallery of {header.name} with {header.peer}{state}>"

    def add(self, descriptors: npt.ArrayLike) -> None:
        """Bring descriptors to the next step.

        Args:
            descriptors: Shape (n, N); none are legal.

        Raises:
            ValueError: for bad descriptors; nothing is consumed and the gallery lives on.
            TapeExhausted: if there are not slots enough; nothing is consumed.
        """
        self._require_alive()
        raw = quantised(self._terms, descriptors)
        self.require_room(len(raw))
        self._waiting += list(raw)

    def step(
        self,
        on_block: Callable[[Block], None] = lambda block: None,
        *,
        into: Step | None = None,
        accept: int | None = None,
    ) -> Step:
        """Bring what was added, and compare all new pairs; both sides call it equally often.

        Args:
            on_block: Called with every block as soon as it is checked and durable.
            into: A step that an earlier session has begun, to go on with.
            accept: Most descriptors that the peer may bring; None for as many as there are slots.

        Raises:
            ProtocolViolation: if the peer brings more than that; nothing is compared with them.
            MacCheckFailed: if the peer cheated; nothing more is output, and tape and ledger are destroyed.
            SpdzError: as any session. What was output stays true.
        """
        with self._guard:
            step, more = Step() if into is None else into, True
            mine, theirs = (self._ledger.slots[owner].voids for owner in (self.party, 1 - self.party))
            step.forget(mine, theirs)
            self._filling.accept = accept
            while more:
                with step.filling.timed() as stats:
                    more = self._filling.exchange(self._agreement, step)
                    self._begin()
                    notes = self._prepare(stats)
                with step.comparing.timed():
                    self._comparing.new(self, step, on_block, notes)
            return step

    def reveal(self, own: Sequence[int], expected: Sequence[int]) -> dict[int, FloatArray]:
        """Open descriptors that were found to match, proved to be those that were compared.

        Both sides call it in step. Agree on the slots before (:meth:`exchange_note`): one side may have given
        up a pair. A peer may take what it gets and hang up. In the semi-honest mode nothing is proved.

        Args:
            own: Own slots to open; also none, or such as were opened before.
            expected: The peer's slots that it opens.

        Returns:
            The peer's descriptors, of shape (N,), by slot.

        Raises:
            ValueError: if a slot is in no True pair of :meth:`results` of two slots that hold a descriptor,
                or there are more than 2,048; nothing was sent and the session lives.
            OutOfStep: if the peer opens or expects others; nothing was opened.
            MacCheckFailed: if it opens another vector; nothing is returned, and the tape is destroyed.
            SpdzError: as any session.
        """
        self._require_alive()
        with self._turn:
            opened = self._revealing.checked(own, expected)
        with self._guard:
            return self._revealing.open(self, self._agreement, opened)

    def part(self, steps: int) -> None:
        """Part with the peer after so many steps.

        Raises:
            OutOfStep: if it goes on.
        """
        with self._guard:
            self._agreement.end(steps)

    # -- the parts of a step -------------------------------------------------------------------------

    def _begin(self) -> None:
        """Bind the checks that follow to everything that both sides hold."""
        first, second = self._ledger.slots
        own: dict[str, Json] = {
            "text": self._plan.text,
            "filled": [first.filled, second.filled],
            "heads": [first.head(first.filled).hex(), second.head(second.filled).hex()],
        }
        peer = self._agreement.control(own, *own)
        if peer != own:
            differing = ", ".join(name for name in own if peer[name] != own[name])
            raise TapeMismatch(
                f"the two sides of the gallery differ in what they hold ({differing}): one of them was "
                "restored from another copy. Deal new tapes"
            )

    def _prepare(self, stats: Stats) -> tuple[Notes, Notes]:
        """Prepare and prove the slots that are not ready on both sides; both parties' in the same rounds.

        Returns:
            What the ledger must remember of the last of them before anything more is sent.
        """
        notes: tuple[dict[int, bytes], dict[int, bytes]] = ({}, {})
        while work := [(shelf, slots) for shelf in self._shelves if (slots := self._unready(shelf.owner))]:
            self._ledger.note(notes)
            notes = ({}, {})
            check, alpha = self._agreement.mac_check, self._alpha
            parties = [shelf.party(slots, check, alpha, stats) for shelf, slots in work]
            lanes = [shelf.prepare(party, slots) for (shelf, slots), party in zip(work, parties, strict=True)]
            proved = self.run(parallel(*lanes), stats)
            for (shelf, slots), proofs in zip(work, proved, strict=True):
                self._refuse_unproved(shelf.owner, slots, proofs)
            for (shelf, slots), party in zip(work, parties, strict=True):
                notes[shelf.owner].update(zip(slots, party.notes(len(slots)), strict=True))
                self._ready[shelf.owner] = slots[-1] + 1
        return notes

    def _unready(self, owner: int) -> list[int]:
        return [slot for slot in held_slots(self._ledger, owner) if slot >= self._ready[owner]][:PREPARED]

    def _refuse_unproved(self, owner: int, slots: list[int], proofs: Any) -> None:
        refuse_unproved(self._terms, self._tape.header.agents[owner], slots, proofs)

    def reader(self, stream: RecordStream, stats: Stats) -> Party:
        """A party of this session that draws on some records."""
        check, security = self._agreement.mac_check, self._terms.security
        return configured(Party(self.party, security, stream, check, self._alpha, stats), self._terms)

    def run(self, protocol: Any, stats: Stats) -> Any:
        """Run a protocol on the connection."""
        return run_channel(drive(protocol, self._agreement.mac_check), self._channel, stats)

    def keep_step(self, strip: Strip) -> None:
        """Wait for the peer at a strip of which nothing is compared."""
        self._agreement.control({"void": str(strip)}, "void")

    def _meet(self) -> None:
        agreed = meet_again(self._agreement, self._filling, self._plan)
        self._ready, self._comparing.again = list(agreed.ready), agreed.again
        self._filling.restore(agreed.ready, self._alpha)

    @property
    def _alpha(self) -> int | None:
        malicious = self._terms.security == "malicious"
        return int.from_bytes(self._tape.alpha, "little") if malicious else None

    def _note_end(self) -> None:
        """The ledger remembers."""

    def _destroy(self) -> None:
        try:
            self._tape.destroy()
        finally:
            self._ledger.destroy()

    def _release(self) -> None:
        try:
            self._ledger.close()
        finally:
            self._tape.close()
