"""The turns of one gallery with one peer: what is brought, what is compared, what is shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from protocols.agent.allowance import Allowance
from protocols.agent.desk import Desk, Peer
from protocols.agent.events import Event
from protocols.agent.keyframe import Keyframe, Meeting, Verdict
from protocols.agent.keyframes import Slots, digest_of
from protocols.agent.matches import Matches, Outcome, Pair
from protocols.agent.saying import MOST_OUTCOMES, MOST_PAIRS, TOGETHER, Saying
from protocols.agent.showing import show
from protocols.agent.verifier import Verifier
from spdz.foundations.types import IntArray, Json
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession, Step

_FAREWELLS = {
    "ended": "{peer} has ended",
    "struck": "{peer} has stopped with this robot: too many matches that it could not verify",
}
_AGAIN = 1.0
"""Seconds before what the peer would not do now is asked for again."""


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
        self._matches = Matches(desk.records, *self._where)
        self._slots = Slots(desk.records, *self._where)
        self._allowance = Allowance(peer, desk.strikes, lambda text: self._tell("budget", text))
        self._verifier, self._wake = verifier, wake
        self._waiting: list[IntArray] = []
        self._capacity = (0, 0)
        self._known = self._slots.known()
        self._true: set[Pair] = set()
        self._asked: dict[Pair, float] = {}  # seconds on connections
        self._held = [len(self._known), 0]
        self._left: int | None = None  # known when the peer was met
        self._sent = self._rounds = self._compared = 0
        self._ask_from = self._bring_from = self._looked = 0.0  # not before, and when, on the monotonic clock
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
        self._ask_from = self._bring_from = 0.0
        self._looked = time.monotonic()
        self._capacity, self._known = session.capacity, self._slots.known()
        self._reconcile(session)
        self._find(list(session.results()))
        self._true = self._matches.pairs()
        self._judge()

    def take(self, session: GallerySession) -> bool:
        """One turn; returns False when one of the two has ended."""
        saying = self._saying(session)
        heard = Saying.read(session.exchange_note(saying.as_json()), self._capacity)
        self.moved = False
        self._matches.told(saying.outcomes)
        self._hear(heard.outcomes)
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
            self._show(session, sorted(wanted, key=lambda pair: pair[:: 1 - 2 * session.party]))
        elif can and (mine or theirs or saying.open or heard.open):
            self._compare(session, mine, theirs)
        else:
            self._bring_from = time.monotonic() + _AGAIN
        return True

    def pause(self, longest: float) -> float:
        """Seconds that may pass before the next turn, if nothing happens."""
        if self._matches.untold(1):
            return 0.0
        due = [time.monotonic() + longest]
        if self._matches.unshown():
            due.append(self._ask_from)
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
        want, outcomes = self._wanted(), self._matches.untold(MOST_OUTCOMES)
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
        pairs = Step(blocks=list(blocks)).matches
        news = self._matches.found(pairs) if pairs else []
        self._true.update(pairs)
        self._peer.matches.spend(len(news))
        for one in news:
            self._desk.hub.tell(Event.of(one))
        if news:
            self._judge()  # both halves may have been shown for other matches

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

    # -- matches -------------------------------------------------------------------------------------

    def _wanted(self) -> list[Pair]:
        """Matches to be shown now; those that the peer has withheld for too long are given up."""
        now, want = time.monotonic(), []
        passed, self._looked = now - self._looked, now
        unshown = self._matches.unshown()
        # Time without a connection does not count; nobody is ever the further for that (see `Allowance`).
        self._asked = {pair: self._asked.get(pair, -passed) + passed for pair in unshown}
        for pair, seconds in self._asked.items():
            if seconds > self._desk.grace:
                why = f"{self._peer.name} has not shown its keyframe for {self._desk.grace:g} s"
                if (news := self._matches.withhold(pair, why)) is not None:
                    self._desk.hub.tell(Event.of(news))
        if now >= self._ask_from:
            want = unshown[:MOST_PAIRS]
        return want

    def _show(self, session: GallerySession, wanted: list[Pair]) -> None:
        """Show each other what is wanted and found True here, as far as the peer is trusted with it."""
        matches = self._matches
        self._ask_from = time.monotonic() + _AGAIN  # unless the peer shows something
        true = [pair for pair in wanted if pair in self._true and self._known.get(pair[0]) is not None]
        before = matches.trusted()
        trusted = matches.trust(true, self._desk.strikes)
        seen = matches.shown([slot for _, slot in wanted])
        promised = set(trusted) - before

        def agreed(pairs: Sequence[Pair], later: bool) -> None:
            promised.difference_update(pairs)
            if later:
                self._asked.clear()

        later = len(trusted) < len(true)
        try:
            shown = show(
                session,
                wanted,
                trusted,
                seen,
                self._own_keyframe,
                self._capacity,
                later,
                agreed,
                matches.promised,
            )
        finally:
            matches.take_back(promised)
        if shown:
            self.moved = True
            matches.show(shown.items())
            self._ask_from = 0.0
            self._asked.clear()  # one after the other, and each may take as long as a link makes it
            self._judge()

    def _hear(self, outcomes: Sequence[Outcome]) -> None:
        """Keep and tell the peer's verdicts."""
        for match, one in self._matches.hear(outcomes):
            keyframe = self._known.get(one.pair[0])
            text = f"{self._peer.name} says {one.state}: {self._gallery} keyframe {keyframe}"
            fields: dict[str, Json] = {"match": match, "keyframe": keyframe, "peer_state": one.state}
            self._desk.hub.tell(Event("peer-verdict", text, *self._where, fields))

    def _own_keyframe(self, slot: int) -> Keyframe:
        number = self._known.get(slot)
        keyframe = None if number is None else self._desk.keyframes.get(number, self._gallery)
        if keyframe is None:
            raise ValueError(f"the keyframe in slot {slot} is not known any more")
        return keyframe

    def _judge(self) -> None:
        """Have matches verified that both sides have shown, a few at a time: other peers' wait, too."""
        if self._allowance.struck:
            return
        for match, slot, keyframe in self._matches.unverified(self._desk.strikes):
            self._verifier.judge(match, partial(self._meeting, keyframe, slot), partial(self._settle, match))

    def _meeting(self, keyframe: int, slot: int) -> Meeting | None:
        """What a verification sees; in the verifier's thread."""
        own, other = self._desk.keyframes.get(keyframe, self._gallery), self._matches.theirs(slot)
        return None if own is None or other is None else Meeting(*self._where, own, other)

    def _settle(self, match: int, verdict: Verdict) -> None:
        """Keep and tell a verdict; in the verifier's thread."""
        news = self._matches.settle(match, verdict)
        self._ask_from = 0.0  # there may be trust for the next
        self._wake()
        self._desk.hub.tell(Event.of(news))
        self._judge()

    def _tell(self, name: str, text: str) -> None:
        self._desk.tell(name, text, *self._where)
