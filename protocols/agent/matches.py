"""The matches of one gallery with one peer, as an agent keeps them: found, shown, verified."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from protocols.agent.events import Match
from protocols.agent.keyframe import Keyframe, Verdict
from protocols.agent.news import News
from protocols.agent.records import Records
from protocols.agent.strikes import Strikes
from spdz.foundations.errors import ProtocolViolation

Pair = tuple[int, int]
"""Own slot, the peer's slot."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one side's verification said of a pair of slots."""

    pair: Pair
    state: str


class Matches:
    """The part of an agent's records that is about one gallery's matches.

    Args:
        records: The open records.
        peer: The other robot.
        gallery: The gallery.
    """

    def __init__(self, records: Records, peer: str, gallery: str) -> None:
        self._records, self._link = records, records.link(peer, gallery)
        self._news, self._strikes = News(records), Strikes(records, peer)

    # -- finding -------------------------------------------------------------------------------------

    def found(self, pairs: Iterable[Pair]) -> list[Match]:
        """Keep pairs whose bit is True; returns the news of those that were not known."""
        records, news = self._records, []
        with records.transaction():
            for pair in pairs:
                new = records.run(
                    "INSERT OR IGNORE INTO matches (link, slot, peer_slot, keyframe, state) "
                    "VALUES (?1, ?2, ?3, "
                    "(SELECT keyframe FROM slots WHERE link = ?1 AND slot = ?2), 'candidate')",
                    self._link,
                    *pair,
                )
                if new:
                    news.append(self._news.tell(self._number(pair), "candidate"))
        return news

    def pairs(self) -> set[Pair]:
        """All pairs whose bit was True."""
        return set(self._records.all("SELECT slot, peer_slot FROM matches WHERE link = ?", self._link))

    def counts(self) -> dict[str, int]:
        """How many matches are in which state."""
        query = "SELECT state, count(*) FROM matches WHERE link = ? GROUP BY state"
        return dict(self._records.all(query, self._link))

    # -- showing -------------------------------------------------------------------------------------

    def unshown(self) -> list[Pair]:
        """Pairs of which the peer has not shown its half, oldest first."""
        return self._records.all(
            "SELECT m.slot, m.peer_slot FROM matches m "
            "LEFT JOIN opened o ON o.link = m.link AND o.slot = m.peer_slot "
            "WHERE m.link = ? AND m.state IN ('candidate', 'withheld') AND o.slot IS NULL ORDER BY m.match",
            self._link,
        )

    def trust(self, pairs: Sequence[Pair], most: int) -> list[Pair]:
        """Choose the pairs that are shown to the peer now, and remember that before they are.

        Args:
            pairs: True pairs, in an order that both sides know.
            most: How many the peer may owe, in all galleries: whoever takes what it is shown and hangs up, or
                pays with rubbish that is still being verified, gets no more than that.

        Returns:
            Those that were shown before, and others as far as there is trust left.
        """
        with self._records.transaction():
            before = self.trusted()
            fresh = [pair for pair in pairs if pair not in before][: max(0, most - self._strikes.owed)]
            self._mark(fresh, 1)
            return [pair for pair in pairs if pair in before or pair in fresh]

    def trusted(self) -> set[Pair]:
        """Pairs whose own half was shown, or is about to be."""
        query = "SELECT slot, peer_slot FROM matches WHERE link = ? AND shown = 1"
        return set(self._records.all(query, self._link))

    def take_back(self, pairs: Iterable[Pair]) -> None:
        """Forget that pairs were to be shown that were not."""
        with self._records.transaction():
            self._mark(pairs, 0)

    def _mark(self, pairs: Iterable[Pair], shown: int) -> None:
        for pair in pairs:
            self._records.run(
                "UPDATE matches SET shown = ? WHERE link = ? AND slot = ? AND peer_slot = ?",
                *(shown, self._link, *pair),
            )

    def promised(self, digests: Mapping[int, str]) -> None:
        """Keep what the peer says it will show of its slots, once for ever.

        Otherwise it could take this side's half, hang up, and show a copy of that with a few points moved.

        Raises:
            ProtocolViolation: if it has said anything else before.
        """
        with self._records.transaction():
            for slot, digest in digests.items():
                where = (self._link, slot)
                self._records.run("INSERT OR IGNORE INTO promised VALUES (?, ?, ?)", *where, digest)
                query = "SELECT digest FROM promised WHERE link = ? AND slot = ?"
                if self._records.all(query, *where) != [(digest,)]:
                    raise ProtocolViolation(
                        f"the peer would show another keyframe of slot {slot} than before it had seen "
                        "this side's half"
                    )

    def shown(self, slots: Collection[int]) -> set[int]:
        """Those of the peer's slots that it has shown."""
        rows = self._records.all("SELECT slot FROM opened WHERE link = ?", self._link)
        return {slot for (slot,) in rows} & set(slots)

    def show(self, shown: Iterable[tuple[int, Keyframe]]) -> None:
        """Keep what the peer has shown of its slots.

        Raises:
            ProtocolViolation: if it has shown another keyframe of the same number; nothing is kept.
        """
        with self._records.transaction():
            for slot, keyframe in shown:
                if keyframe.vector is None:
                    raise ValueError("what a peer shows has a vector")
                self._refuse_another(keyframe)
                vector = np.asarray(keyframe.vector, dtype="<f8").tobytes()
                self._records.run(
                    "INSERT OR IGNORE INTO opened VALUES (?, ?, ?, ?, ?, ?)",
                    *(self._link, slot, keyframe.id, keyframe.stamp, vector, keyframe.payload),
                )

    def _refuse_another(self, keyframe: Keyframe) -> None:
        """Refuse a second keyframe of a peer's number: whoever draws a map goes by it."""
        query = (
            "SELECT count(*) FROM opened JOIN links USING (link) JOIN links own ON own.link = ? "
            "WHERE links.peer = own.peer AND keyframe = ? AND (payload != ? OR stamp IS NOT ?)"
        )
        if self._records.all(query, self._link, keyframe.id, keyframe.payload, keyframe.stamp) != [(0,)]:
            raise ProtocolViolation(f"the peer has shown two keyframes of the number {keyframe.id}")

    def theirs(self, slot: int) -> Keyframe | None:
        """What the peer has shown of a slot."""
        query = "SELECT keyframe, vector, payload, stamp FROM opened WHERE link = ? AND slot = ?"
        for number, vector, payload, stamp in self._records.all(query, self._link, slot):
            return Keyframe(number, np.frombuffer(vector, dtype="<f8"), payload, stamp)
        return None

    # -- verifying -----------------------------------------------------------------------------------

    def unverified(self, most: int) -> list[tuple[int, int, int]]:
        """The oldest matches that both robots have shown and no verdict is on.

        Returns:
            Number, the peer's slot, own keyframe.
        """
        return self._records.all(
            "SELECT m.match, m.peer_slot, m.keyframe FROM matches m "
            "JOIN opened o ON o.link = m.link AND o.slot = m.peer_slot "
            "WHERE m.link = ? AND m.state IN ('candidate', 'withheld') AND m.keyframe IS NOT NULL "
            "ORDER BY m.match LIMIT ?",
            *(self._link, most),
        )

    def settle(self, match: int, verdict: Verdict) -> Match:
        """Keep what the verification said; returns the news of it."""
        state = "verified" if verdict.accepted else "rejected"
        transform = None if verdict.transform is None else json.dumps(list(verdict.transform))
        with self._records.transaction():
            self._records.run(
                "UPDATE matches SET state = ?, why = ?, transform = ?, weight = ?, told = 0 WHERE match = ?",
                *(state, verdict.why[:200], transform, verdict.weight, match),
            )
            if verdict.accepted:
                self._strikes.lift(match)  # it came late
            else:
                self._strikes.add(f"not verified: {verdict.why}" if verdict.why else "not verified", match)
            return self._news.tell(match, state)

    def withhold(self, pair: Pair, why: str) -> Match | None:
        """Keep that the peer does not show its half; None if that is known already."""
        match = self._number(pair)
        with self._records.transaction():
            changed = self._records.run(
                "UPDATE matches SET state = 'withheld', why = ? WHERE match = ? AND state = 'candidate'",
                why,
                match,
            )
            if not changed:
                return None
            self._strikes.add(why, match)
            return self._news.tell(match, "withheld")

    @property
    def outstanding(self) -> int:
        """Matches that are neither verified nor a strike yet."""
        return self.counts().get("candidate", 0)

    # -- telling the peer, and being told ------------------------------------------------------------

    def untold(self, most: int) -> list[Outcome]:
        """Verdicts that the peer has perhaps not heard."""
        rows = self._records.all(
            "SELECT slot, peer_slot, state FROM matches WHERE link = ? AND told = 0 "
            "AND state IN ('verified', 'rejected') ORDER BY match LIMIT ?",
            *(self._link, most),
        )
        return [Outcome((slot, peer_slot), state) for slot, peer_slot, state in rows]

    def told(self, outcomes: Sequence[Outcome]) -> None:
        """The peer has heard these verdicts."""
        with self._records.transaction():
            for one in outcomes:
                self._records.run(
                    "UPDATE matches SET told = 1 WHERE link = ? AND slot = ? AND peer_slot = ? AND state = ?",
                    *(self._link, *one.pair, one.state),
                )

    def hear(self, outcomes: Sequence[Outcome]) -> list[tuple[int, Outcome]]:
        """Keep the peer's verdicts; those of pairs that are no matches here are nothing.

        Returns:
            What is new: the match's number and the verdict.
        """
        new = []
        with self._records.transaction():
            for one in outcomes:
                changed = self._records.run(
                    "UPDATE matches SET peer_state = ?1 WHERE link = ?2 AND slot = ?3 AND peer_slot = ?4 "
                    "AND peer_state IS NOT ?1",
                    *(one.state, self._link, *one.pair),
                )
                if changed:
                    new.append((self._number(one.pair), one))
        return new

    def _number(self, pair: Pair) -> int:
        query = "SELECT match FROM matches WHERE link = ? AND slot = ? AND peer_slot = ?"
        return int(self._records.all(query, self._link, *pair)[0][0])
