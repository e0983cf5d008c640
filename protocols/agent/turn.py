"""The turns of one gallery with one peer: what is brought, what is compared, what is shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from protocols.agent.desk import Desk, Peer
from protocols.agent.events import Event
from protocols.agent.keyframe import Keyframe
from protocols.agent.keyframes import digest_of
from protocols.agent.matches import Pair
from protocols.agent.showing import show
from protocols.agent.turns import MOST_OUTCOMES, MOST_PAIRS, TOGETHER, Saying
from protocols.agent.verifier import Verifier, meeting_of
from spdz.foundations.types import IntArray
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession, Step

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
    """

    def __init__(
        self, desk: Desk, peer: Peer, gallery: str, terms: Terms, verifier: Verifier, wake: Callable[[], None]
    ) -> None:
        self._desk, self._peer, self._gallery, self._terms = desk, peer, gallery, terms
        self._where = (peer.name, gallery)
        self._verifier, self._wake = verifier, wake
        self._waiting: list[IntArray] = []
        self._capacity = (0, 0)
        self._true: set[Pair] = set()
        self._asked: dict[Pair, float] = {}
        self._held = [0, 0]
        self._left = 0
        self._sent = self._rounds = self._compared = 0
        self._idle_until = 0.0
        self._spent = self._full = self._open = False

    def begin(self, session: GallerySession, waiting: list[IntArray]) -> None:
        """Take up what a new connection brings: slots that were filled, results that were missed.

        Args:
            session: The gallery, connected.
            waiting: What the session brings of itself.
        """
        self._waiting, self._idle_until, self._compared = waiting, 0.0, 0
        self._capacity = session.capacity
        self._reconcile(session)
        self._find(list(session.results()))
        self._true = self._desk.matches.pairs(*self._where)
        self._judge()

    def take(self, session: GallerySession) -> bool:
        """One turn; returns False when one of the two has ended."""
        saying = self._saying(session)
        heard = Saying.read(session.exchange_note(saying.as_json()), self._capacity)
        self._desk.matches.told(*self._where, saying.outcomes)
        self._desk.matches.hear(*self._where, heard.outcomes)
        if saying.leave or heard.leave:
            return False
        wanted = list(dict.fromkeys((*saying.want, *heard.want)))
        mine, theirs = min(saying.new, heard.room, TOGETHER), min(heard.new, saying.room, TOGETHER)
        can = (
            saying.due <= heard.room and heard.due <= saying.room
        )  # what is in slots comes first, and all of it
        if wanted:
            self._show(session, sorted(wanted, key=lambda pair: pair[:: 1 - 2 * session.party]))
        elif can and (mine or theirs or saying.open or heard.open):
            self._compare(session, mine, theirs)
        else:
            self._idle_until = time.monotonic() + _AGAIN
        return True

    def pause(self, longest: float) -> float:
        """Seconds that may pass before the next turn, if nothing happens."""
        desk = self._desk
        if desk.matches.untold(*self._where, 1):
            return 0.0
        waits = bool(self._asked) or self._spent or bool(desk.keyframes.waiting(*self._where, most=1))
        return max(0.0, self._idle_until - time.monotonic()) if waits else longest

    def status(self) -> dict[str, Any]:
        """Where the gallery stands, JSON-ready."""
        desk = self._desk
        return {
            "keyframes": desk.keyframes.count(self._gallery),
            "held": self._held[0],
            "peer_held": self._held[1],
            "slots_left": self._left,
            "pairs": self._compared,
            "matches": desk.matches.counts(*self._where),
            "strikes": len(desk.matches.strikes(self._peer.name)),
            "settled": self._settled,
            "budget_spent": self._spent,
            "bytes_sent": self._sent,
            "rounds": self._rounds,
        }

    @property
    def _settled(self) -> bool:
        """Whether all own keyframes are in slots, all filled slots compared, and all matches settled."""
        where, desk = self._where, self._desk
        return not (self._open or desk.keyframes.waiting(*where, most=1) or desk.matches.outstanding(*where))

    # -- a turn --------------------------------------------------------------------------------------

    def _saying(self, session: GallerySession) -> Saying:
        desk, (own, theirs) = self._desk, self._held
        want = self._wanted()
        outcomes = desk.matches.untold(*self._where, MOST_OUTCOMES)
        self._left = session.room
        self._open, allowed = session.unfinished, self._allowed()
        taken_back, due = len(self._waiting), session.due
        fresh = desk.keyframes.waiting(*self._where, map(digest_of, self._waiting), TOGETHER)
        if len(fresh) > self._left and not self._full:
            self._full = True
            self._tell(
                "slots", f"no slots are left for {desk.robot}'s keyframes with {self._peer.name}: deal more"
            )
        new = due + min(taken_back + min(len(fresh), self._left), self._share(allowed, theirs))
        room = self._share(allowed, own)
        return Saying(
            min(new, TOGETHER), due, room, self._open and allowed > 0, want, outcomes, desk.stop.is_set()
        )

    def _share(self, allowed: int, others: int) -> int:
        """Descriptors that may be compared with all of the other side's; one where nothing was spent yet."""
        least = 1 if allowed and self._peer.pairs.untouched else 0
        return min(TOGETHER, max(least, allowed // max(1, others)))

    def _allowed(self) -> int:
        """Pairs that may be compared now."""
        peer, matches = self._peer, self._desk.matches
        strikes, unsettled = len(matches.strikes(peer.name)), matches.outstanding(peer.name)
        spent = not (peer.pairs.left and peer.matches.left)
        if spent != self._spent:
            self._spent = spent
            self._idle_until = time.monotonic() + _AGAIN
            if spent:
                what = "pairs" if not peer.pairs.left else "matches"
                seconds = max(peer.pairs.pause, peer.matches.pause)
                self._tell(
                    "budget",
                    f"the budget of {what} a minute with {peer.name} is spent: on in {seconds:.0f} s",
                )
        if spent or unsettled + strikes >= max(1, self._desk.strikes):
            return 0
        return peer.pairs.left

    def _compare(self, session: GallerySession, mine: int, theirs: int) -> None:
        """One step of the gallery, with so many descriptors of either side."""
        mine -= session.due
        later = self._waiting[mine:]
        del self._waiting[mine:]
        if missing := mine - len(self._waiting):
            besides = map(digest_of, self._waiting)
            fresh = self._desk.keyframes.waiting(*self._where, besides, missing)
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
        self._find([block])

    def _find(self, blocks: Sequence[Block]) -> None:
        """Keep and tell what is True in some results."""
        self._compared += sum(block.results.size for block in blocks)
        pairs = Step(blocks=list(blocks)).matches
        news = self._desk.matches.found(*self._where, pairs) if pairs else []
        self._true.update(pairs)
        self._peer.matches.spend(len(news))
        for one in news:
            self._desk.hub.tell(Event.of(one))

    def _reconcile(self, session: GallerySession) -> None:
        """Find out which keyframes are in which slots, by what the ledger holds."""
        filled = session.filled
        known = self._desk.keyframes.slots(*self._where)
        new = [slot for slot in filled if slot not in known]
        lost = set(known) - set(filled)
        if new or lost:
            digests = [digest_of(raw) for raw in session.plain(new)]
            self._desk.keyframes.place(*self._where, dict(zip(new, digests, strict=True)), lost)
        self._held = [len(filled), len(session.peer_filled)]

    # -- matches -------------------------------------------------------------------------------------

    def _wanted(self) -> list[Pair]:
        """Matches to be shown now; those that the peer has withheld for too long are given up."""
        now, want = time.monotonic(), []
        unshown = self._desk.matches.unshown(*self._where)
        for pair in unshown:
            if now - self._asked.setdefault(pair, now) > self._desk.grace:
                why = f"{self._peer.name} has not shown its keyframe for {self._desk.grace:g} s"
                if (news := self._desk.matches.withhold(*self._where, pair, why)) is not None:
                    self._desk.hub.tell(Event.of(news))
        self._asked = {pair: when for pair, when in self._asked.items() if pair in unshown}
        if now >= self._idle_until:
            want = unshown[:MOST_PAIRS]
        return want

    def _show(self, session: GallerySession, wanted: list[Pair]) -> None:
        matches = self._desk.matches
        self._idle_until = time.monotonic() + _AGAIN  # unless the peer shows all that is wanted
        own = self._desk.keyframes.slots(*self._where)
        true = {pair for pair in self._true if own.get(pair[0]) is not None}
        seen = matches.shown(*self._where, [slot for _, slot in wanted])
        _, shown = show(session, wanted, true, seen, self._own_keyframe, self._capacity)
        matches.show(*self._where, shown.items())
        if shown:
            self._idle_until = 0.0
            self._judge()

    def _own_keyframe(self, slot: int) -> Keyframe:
        number = self._desk.keyframes.slots(*self._where).get(slot)
        keyframe = None if number is None else self._desk.keyframes.get(number, self._gallery)
        if keyframe is None:
            raise ValueError(f"the keyframe in slot {slot} is not known any more")
        return keyframe

    def _judge(self) -> None:
        """Have all matches verified that both sides have shown."""
        for match, pair, keyframe in self._desk.matches.unverified(*self._where):
            meeting = meeting_of(self._desk, *self._where, pair, keyframe)
            if meeting is not None:
                self._verifier.judge(match, meeting, self._wake)

    def _tell(self, name: str, text: str) -> None:
        self._desk.tell(name, text, *self._where)
