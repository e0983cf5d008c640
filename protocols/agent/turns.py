"""The turns of one gallery with one peer: what is brought and compared; matches are followed up beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from protocols.agent.allowance import Allowance
from protocols.agent.desk import Desk, Peer
from protocols.agent.following import AGAIN, Following
from protocols.agent.keyframes import Slots, digest_of
from protocols.agent.saying import MOST_OUTCOMES, TOGETHER, Saying
from protocols.agent.verifier import Verifier
from spdz.foundations.types import IntArray
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession, Step

_FAREWELLS = {
    "ended": "{peer} has ended",
    "struck": "{peer} has stopped with this robot: too many matches that it could not verify",
}


class Turns:
    """One side of all turns with a peer, over as many connections as it takes.

    Args:
        desk: The agent's.
        peer: The other robot and its budgets.
        gallery: The gallery's name.
        terms: What it is for.
        verifier: Gives verdicts.
        wake: Has a turn made soon.

    Attributes:
        farewell: Why the peer has left, for people; empty if this side has.
        moved: Whether anything was compared, or shown by the peer, in the last turn.
    """

    def __init__(
        self, desk: Desk, peer: Peer, gallery: str, terms: Terms, verifier: Verifier, wake: Callable[[], None]
    ) -> None:
        self._desk, self._peer, self._gallery, self._terms = desk, peer, gallery, terms
        self._where = (peer.name, gallery)
        self._following = Following(desk, peer, gallery, verifier, wake)
        self._matches = self._following.matches
        self._slots = Slots(desk.records, *self._where)
        self._allowance = Allowance(peer, desk.strikes, lambda text: self._tell("budget", text))
        self._waiting: list[IntArray] = []
        self._capacity = (0, 0)
        self._known = self._slots.known()
        self._held = [len(self._known), 0]
        self._left: int | None = None  # known when the peer was met
        self._sent = self._rounds = self._compared = 0
        self._bring_from = 0.0  # not before, on the monotonic clock
        self._full = self._open = self._yields = False
        self.farewell = ""
        self.moved = False

    def begin(self, session: GallerySession, waiting: list[IntArray]) -> None:
        """Take up what a new connection brings: slots that were filled, results that were missed.

        Args:
            session: The gallery, connected.
            waiting: What the session brings of itself.
        """
        self._waiting, self._compared = waiting, 0
        self._bring_from = 0.0
        self._capacity, self._known = session.capacity, self._slots.known()
        self._reconcile(session)
        self._find(list(session.results()))
        self._following.begin()

    def take(self, session: GallerySession) -> bool:
        """One turn; returns False when one of the two has ended."""
        saying = self._saying(session)
        heard = Saying.read(session.exchange_note(saying.as_json()), self._capacity)
        self.moved = False
        self._matches.told(saying.outcomes)
        self._following.hear(heard.outcomes, self._known)
        if saying.leave or heard.leave:
            self.farewell = "" if saying.leave else _FAREWELLS[heard.leave].format(peer=self._peer.name)
            return False
        wanted = list(dict.fromkeys((*saying.want, *heard.want)))
        mine, theirs = min(saying.new, heard.room, TOGETHER), min(heard.new, saying.room, TOGETHER)
        # What is in slots already is brought first, and all of it.
        self._yields = heard.due > saying.room
        fits = saying.due <= heard.room and not self._yields
        can = fits and not (saying.hold or heard.hold)
        if wanted:
            wanted.sort(key=lambda pair: pair[:: 1 - 2 * session.party])
            self.moved = self._following.show(session, wanted, self._known, self._capacity)
        elif can and (mine or theirs or saying.open or heard.open):
            self._compare(session, mine, theirs)
        else:
            self._bring_from = time.monotonic() + AGAIN
        return True

    def pause(self, longest: float) -> float:
        """Seconds that may pass before the next turn, if nothing happens."""
        if self._matches.untold(1):
            return 0.0
        due = [time.monotonic() + longest]
        if self._matches.unshown():
            due.append(self._following.ask_from)
        if self._allowance.spent or self._slots.waiting(most=1):
            due.append(self._bring_from)
        return max(0.0, min(due) - time.monotonic())

    def status(self) -> dict[str, Any]:
        """Where the gallery stands, JSON-ready."""
        desk = self._desk
        return {
            "keyframes": desk.keyframes.count(self._gallery),
            "held": self._held[0],
            "peer_held": self._held[1],
            "slots_left": self._left,
            "pairs": self._compared,
            "matches": self._matches.counts(),
            "strikes": len(self._peer.strikes.reasons),
            "settled": self._settled,
            "budget_spent": self._allowance.spent,
            "bytes_sent": self._sent,
            "rounds": self._rounds,
        }

    @property
    def _settled(self) -> bool:
        """Whether all own keyframes are in slots, all filled slots compared, and all matches settled."""
        return not (self._open or self._slots.waiting(most=1) or self._matches.outstanding)

    # -- a turn --------------------------------------------------------------------------------------

    def _saying(self, session: GallerySession) -> Saying:
        # Looked at before the verdicts are: who leaves because of one tells it.
        leaves = "ended" if self._desk.stop.is_set() else "struck" if self._allowance.struck else ""
        want, outcomes = self._following.wanted(), self._matches.untold(MOST_OUTCOMES)
        fresh = len(self._slots.waiting(map(digest_of, self._waiting), TOGETHER))
        self._left, self._open = session.room, session.unfinished
        if fresh > self._left and not self._full:
            self._full = True
            self._tell(
                "slots", f"no slots are left for keyframes to be compared with {self._peer.name}: deal more"
            )
        due, pairs = session.due, session.open_pairs
        # What the peer has in slots already was allowed once: it comes before anything new of either side.
        waiting = 0 if self._yields else len(self._waiting) + min(fresh, self._left)
        held = (self._held[0] - due, self._held[1])
        brings, takes = self._allowance.shares(min(due + waiting, TOGETHER), *held, pairs)
        hold = self._allowance.holds(pairs)
        return Saying(max(due, brings), due, min(takes, TOGETHER), self._open, want, outcomes, leaves, hold)

    def _compare(self, session: GallerySession, mine: int, theirs: int) -> None:
        """One step of the gallery, with so many descriptors of either side."""
        mine -= session.due
        later = self._waiting[mine:]
        del self._waiting[mine:]
        if missing := mine - len(self._waiting):
            besides = map(digest_of, self._waiting)
            fresh = self._slots.waiting(besides, missing)
            session.add(np.array([one.vector for one in fresh]).reshape(len(fresh), self._terms.dim))
        step = Step()
        try:
            session.step(lambda block: self._block(session, block), into=step, accept=theirs)
        finally:
            self._waiting += later
        self._reconcile(session)
        self._sent += step.stats.bytes_sent
        self._rounds += step.stats.rounds

    def _block(self, session: GallerySession, block: Block) -> None:
        self._reconcile(session)
        self._peer.pairs.spend(block.results.size)
        self.moved = True
        self._find([block])

    def _find(self, blocks: Sequence[Block]) -> None:
        """Keep and tell what is True in some results."""
        self._compared += sum(block.results.size for block in blocks)
        self._following.found(Step(blocks=list(blocks)).matches)

    def _reconcile(self, session: GallerySession) -> None:
        """Find out which keyframes are in which slots, by what the ledger holds."""
        filled = session.filled
        new = [slot for slot in filled if slot not in self._known]
        lost = set(self._known) - set(filled)
        if new or lost:
            digests = [digest_of(raw) for raw in session.plain(new)]
            self._slots.place(dict(zip(new, digests, strict=True)), lost)
            self._known = self._slots.known()
        self._held = [len(filled), len(session.peer_filled)]

    def _tell(self, name: str, text: str) -> None:
        self._desk.tell(name, text, *self._where)
