"""Matches followed up: asked for, shown, verified, told; or given up and held against the peer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from protocols.agent.desk import Desk, Peer
from protocols.agent.events import Event
from protocols.agent.keyframe import Keyframe, Meeting, Verdict
from protocols.agent.matches import Matches, Outcome, Pair
from protocols.agent.saying import MOST_PAIRS
from protocols.agent.showing import show
from protocols.agent.verifier import Verifier
from spdz.foundations.types import Json
from spdz.session import GallerySession

AGAIN = 1.0
"""Seconds before what the peer would not do now is asked for again."""


class Following:
    """What becomes of one gallery's matches with one peer.

    Args:
        desk: The agent's.
        peer: The other robot and its budgets.
        gallery: The gallery's name.
        verifier: Gives verdicts.
        wake: Has a turn made soon.

    Attributes:
        matches: The records of them.
        ask_from: When the peer may be asked for its halves, on the monotonic clock.
    """

    def __init__(
        self, desk: Desk, peer: Peer, gallery: str, verifier: Verifier, wake: Callable[[], None]
    ) -> None:
        self._desk, self._peer, self._where = desk, peer, (peer.name, gallery)
        self._verifier, self._wake = verifier, wake
        self.matches = Matches(desk.records, *self._where)
        self._true: set[Pair] = set()
        self._asked: dict[Pair, float] = {}  # seconds on connections
        self._looked = self.ask_from = 0.0

    def begin(self) -> None:
        """Take up what earlier connections have left."""
        self.ask_from, self._looked = 0.0, time.monotonic()
        self._true = self.matches.pairs()
        self.judge()

    def found(self, pairs: Iterable[Pair]) -> None:
        """Keep and tell pairs whose bit is True."""
        pairs = list(pairs)
        news = self.matches.found(pairs) if pairs else []
        self._true.update(pairs)
        self._peer.matches.spend(len(news))
        for one in news:
            self._desk.hub.tell(Event.of(one))
        if news:
            self.judge()  # both halves may have been shown for other matches

    def wanted(self) -> list[Pair]:
        """Matches to be shown now; those that the peer has withheld for too long are given up."""
        now, want = time.monotonic(), []
        passed, self._looked = now - self._looked, now
        unshown = self.matches.unshown()
        # Time without a connection does not count; nobody is ever the further for that (see `Allowance`).
        self._asked = {pair: self._asked.get(pair, -passed) + passed for pair in unshown}
        for pair, seconds in self._asked.items():
            if seconds > self._desk.grace:
                why = f"{self._peer.name} has not shown its keyframe for {self._desk.grace:g} s"
                if (news := self.matches.withhold(pair, why)) is not None:
                    self._desk.hub.tell(Event.of(news))
        if now >= self.ask_from:
            want = unshown[:MOST_PAIRS]
        return want

    def show(
        self,
        session: GallerySession,
        wanted: Sequence[Pair],
        keyframes: Mapping[int, int | None],
        capacity: tuple[int, int],
    ) -> bool:
        """Show each other what is wanted and found True here, as far as the peer is trusted with it.

        Args:
            session: The connected gallery.
            wanted: Pairs that either side wants, in an order that both sides know.
            keyframes: Own keyframes by slot.
            capacity: Slots of this side and of the peer.

        Returns:
            Whether the peer has shown anything.
        """
        matches = self.matches
        self.ask_from = time.monotonic() + AGAIN  # unless the peer shows something
        true = [pair for pair in wanted if pair in self._true and keyframes.get(pair[0]) is not None]
        before = matches.trusted()
        trusted = matches.trust(true, self._desk.strikes)
        seen = matches.shown([slot for _, slot in wanted])
        promised, later = set(trusted) - before, len(trusted) < len(true)

        def agreed(pairs: Sequence[Pair], later: bool) -> None:
            promised.difference_update(pairs)
            if later:
                self._asked.clear()

        own = partial(self._own, keyframes)
        try:
            shown = show(session, wanted, trusted, seen, own, capacity, later, agreed, matches.promised)
        finally:
            matches.take_back(promised)
        if shown:
            matches.show(shown.items())
            self.ask_from = 0.0
            self._asked.clear()  # one after the other, and each may take as long as a link makes it
            self.judge()
        return bool(shown)

    def hear(self, outcomes: Sequence[Outcome], keyframes: Mapping[int, int | None]) -> None:
        """Keep and tell the peer's verdicts."""
        for match, one in self.matches.hear(outcomes):
            keyframe = keyframes.get(one.pair[0])
            text = f"{self._peer.name} says {one.state}: {self._where[1]} keyframe {keyframe}"
            fields: dict[str, Json] = {"match": match, "keyframe": keyframe, "peer_state": one.state}
            self._desk.hub.tell(Event("peer-verdict", text, *self._where, fields))

    def _own(self, keyframes: Mapping[int, int | None], slot: int) -> Keyframe:
        number = keyframes.get(slot)
        keyframe = None if number is None else self._desk.keyframes.get(number, self._where[1])
        if keyframe is None:
            raise ValueError(f"the keyframe in slot {slot} is not known any more")
        return keyframe

    def judge(self) -> None:
        """Have matches verified that both sides have shown, a few at a time: other peers' wait, too."""
        if len(self._peer.strikes.reasons) >= self._desk.strikes:
            return
        for match, slot, keyframe in self.matches.unverified(self._desk.strikes):
            self._verifier.judge(match, partial(self._meeting, keyframe, slot), partial(self._settle, match))

    def _meeting(self, keyframe: int, slot: int) -> Meeting | None:
        """What a verification sees; in the verifier's thread."""
        own, other = self._desk.keyframes.get(keyframe, self._where[1]), self.matches.theirs(slot)
        return None if own is None or other is None else Meeting(*self._where, own, other)

    def _settle(self, match: int, verdict: Verdict) -> None:
        """Keep and tell a verdict; in the verifier's thread."""
        news = self.matches.settle(match, verdict)
        self.ask_from = 0.0  # there may be trust for the next
        self._wake()
        self._desk.hub.tell(Event.of(news))
        self.judge()
