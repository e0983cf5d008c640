"""Matches as an agent keeps them: found, shown, verified; and what is held against a peer."""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from protocols.agent.events import Match
from protocols.agent.keyframe import Keyframe, Verdict
from protocols.agent.records import Records

Pair = tuple[int, int]
"""Own slot, the peer's slot."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one side's verification said of a pair of slots."""

    pair: Pair
    state: str


class Matches:
    """The part of an agent's records that is about matches with its peers.

    Args:
        records: The open records.
    """

    def __init__(self, records: Records) -> None:
        self._records = records

    # -- finding -------------------------------------------------------------------------------------

    def found(self, peer: str, gallery: str, pairs: Iterable[Pair]) -> list[Match]:
        """Keep pairs whose bit is True; returns the news of those that were not known."""
        records, news = self._records, []
        with records.transaction():
            for slot, peer_slot in pairs:
                new = records.run(
                    "INSERT OR IGNORE INTO matches (peer, gallery, slot, peer_slot, keyframe, state) "
                    "VALUES (?1, ?2, ?3, ?4, (SELECT keyframe FROM slots "
                    "WHERE peer = ?1 AND gallery = ?2 AND slot = ?3), 'candidate')", peer, gallery, slot, peer_slot,
                )  # fmt: skip
                if new:
                    news.append(self._tell(self._number(peer, gallery, (slot, peer_slot)), "candidate"))
        return news

    def pairs(self, peer: str, gallery: str) -> set[Pair]:
        """All pairs whose bit was True."""
        query = "SELECT slot, peer_slot FROM matches WHERE peer = ? AND gallery = ?"
        return set(self._records.all(query, peer, gallery))

    # -- showing -------------------------------------------------------------------------------------

    def unshown(self, peer: str, gallery: str) -> list[Pair]:
        """Pairs of which the peer has not shown its half, oldest first."""
        return self._records.all(
            "SELECT m.slot, m.peer_slot FROM matches m LEFT JOIN opened o ON o.peer = m.peer AND "
            "o.gallery = m.gallery AND o.slot = m.peer_slot WHERE m.peer = ? AND m.gallery = ? "
            "AND m.state IN ('candidate', 'withheld') AND o.slot IS NULL ORDER BY m.match", peer, gallery,
        )  # fmt: skip

    def shown(self, peer: str, gallery: str, slots: Collection[int]) -> set[int]:
        """Those of the peer's slots that it has shown."""
        rows = self._records.all("SELECT slot FROM opened WHERE peer = ? AND gallery = ?", peer, gallery)
        return {slot for (slot,) in rows} & set(slots)

    def show(self, peer: str, gallery: str, shown: Iterable[tuple[int, Keyframe]]) -> None:
        """Keep what the peer has shown of its slots."""
        with self._records.transaction():
            for slot, keyframe in shown:
                if keyframe.vector is None:
                    raise ValueError("what a peer shows has a vector")
                vector = np.asarray(keyframe.vector, dtype="<f8").tobytes()
                self._records.run(
                    "INSERT OR IGNORE INTO opened VALUES (?, ?, ?, ?, ?, ?, ?)",
                    peer, gallery, slot, keyframe.id, keyframe.stamp, vector, keyframe.payload,
                )  # fmt: skip

    def theirs(self, peer: str, gallery: str, slot: int) -> Keyframe | None:
        """What the peer has shown of a slot."""
        rows = self._records.all(
            "SELECT keyframe, vector, payload, stamp FROM opened WHERE peer = ? AND gallery = ? AND slot = ?",
            peer, gallery, slot,
        )  # fmt: skip
        if not rows:
            return None
        number, vector, payload, stamp = rows[0]
        return Keyframe(number, np.frombuffer(vector, dtype="<f8"), payload, stamp)

    # -- verifying -----------------------------------------------------------------------------------

    def unverified(self, peer: str, gallery: str) -> list[tuple[int, Pair, int | None]]:
        """Matches that both robots have shown and no verdict is given of: number, slots, own keyframe."""
        rows = self._records.all(
            "SELECT m.match, m.slot, m.peer_slot, m.keyframe FROM matches m JOIN opened o "
            "ON o.peer = m.peer AND o.gallery = m.gallery AND o.slot = m.peer_slot WHERE m.peer = ? AND m.gallery = ? "
            "AND m.state IN ('candidate', 'withheld') ORDER BY m.match", peer, gallery,
        )  # fmt: skip
        return [(match, (slot, peer_slot), keyframe) for match, slot, peer_slot, keyframe in rows]

    def settle(self, match: int, verdict: Verdict) -> Match:
        """Keep what the verification said; returns the news of it."""
        state = "verified" if verdict.accepted else "rejected"
        transform = None if verdict.transform is None else json.dumps(list(verdict.transform))
        with self._records.transaction():
            self._records.run(
                "UPDATE matches SET state = ?, why = ?, transform = ?, weight = ?, told = 0 WHERE match = ?",
                state, verdict.why[:200], transform, verdict.weight, match,
            )  # fmt: skip
            if verdict.accepted:
                self._records.run("DELETE FROM strikes WHERE match = ?", match)  # it came late
            else:
                self._strike(match, f"not verified: {verdict.why}" if verdict.why else "not verified")
            return self._tell(match, state)

    def withhold(self, peer: str, gallery: str, pair: Pair, why: str) -> Match | None:
        """Keep that the peer does not show its half; None if that is known already."""
        match = self._number(peer, gallery, pair)
        with self._records.transaction():
            changed = self._records.run(
                "UPDATE matches SET state = 'withheld', why = ? WHERE match = ? AND state = 'candidate'",
                why,
                match,
            )
            if not changed:
                return None
            self._strike(match, why)
            return self._tell(match, "withheld")

    def untold(self, peer: str, gallery: str, most: int) -> list[Outcome]:
        """Verdicts that the peer has perhaps not heard, in the own side's slots."""
        rows = self._records.all(
            "SELECT slot, peer_slot, state FROM matches WHERE peer = ? AND gallery = ? AND told = 0 "
            "AND state IN ('verified', 'rejected') ORDER BY match LIMIT ?", peer, gallery, most,
        )  # fmt: skip
        return [Outcome((slot, peer_slot), state) for slot, peer_slot, state in rows]

    def told(self, peer: str, gallery: str, outcomes: Sequence[Outcome]) -> None:
        """The peer has heard these verdicts."""
        with self._records.transaction():
            for one in outcomes:
                self._records.run(
                    "UPDATE matches SET told = 1 WHERE peer = ? AND gallery = ? AND slot = ? "
                    "AND peer_slot = ? AND state = ?", peer, gallery, *one.pair, one.state,
                )  # fmt: skip

    def hear(self, peer: str, gallery: str, outcomes: Iterable[Outcome]) -> None:
        """Keep the peer's verdicts."""
        with self._records.transaction():
            for one in outcomes:
                self._records.run(
                    "UPDATE matches SET peer_state = ? WHERE peer = ? AND gallery = ? AND slot = ? "
                    "AND peer_slot = ?",
                    one.state, peer, gallery, *one.pair,
                )  # fmt: skip

    # -- what is held against a peer -----------------------------------------------------------------

    def outstanding(self, peer: str, gallery: str | None = None) -> int:
        """Matches with a peer, in a gallery or in all, that are neither verified nor a strike yet."""
        query = (
            "SELECT count(*) FROM matches WHERE peer = ?1 AND state = 'candidate' "
            "AND (?2 IS NULL OR gallery = ?2)"
        )
        return int(self._records.all(query, peer, gallery)[0][0])

    def strikes(self, peer: str) -> list[str]:
        """Why a peer has strikes, oldest first."""
        return [
            why
            for (why,) in self._records.all("SELECT why FROM strikes WHERE peer = ? ORDER BY number", peer)
        ]

    def strike(self, peer: str, why: str) -> None:
        """Hold something against a peer that is about no match."""
        self._records.run(
            "INSERT INTO strikes (peer, why, at) VALUES (?, ?, ?)", peer, why[:200], time.time()
        )

    def forgive(self, peer: str) -> int:
        """Forget a peer's strikes; returns how many there were. What was seen is kept."""
        return self._records.run("DELETE FROM strikes WHERE peer = ?", peer)

    def _strike(self, match: int, why: str) -> None:
        self._records.run(
            "INSERT OR IGNORE INTO strikes (peer, match, why, at) "
            "SELECT peer, match, ?, ? FROM matches WHERE match = ?", why[:200], time.time(), match,
        )  # fmt: skip

    # -- news ----------------------------------------------------------------------------------------

    def news(self, after: int, most: int = 1000) -> list[Match]:
        """News with numbers above ``after``, as the matches stand now but for their state."""
        return [
            _match(row)
            for row in self._records.all(f"{_NEWS} WHERE n.number > ? ORDER BY n.number LIMIT ?", after, most)
        ]

    @property
    def read_to(self) -> int:
        """Number of the last news that was read."""
        rows = self._records.all("SELECT value FROM about WHERE name = 'read'")
        return int(rows[0][0]) if rows else 0

    def read(self, number: int) -> None:
        """Remember that news were read as far as a number."""
        self._records.run("INSERT OR REPLACE INTO about VALUES ('read', ?)", str(number))

    def counts(self, peer: str, gallery: str) -> dict[str, int]:
        """How many matches with a peer are in which state."""
        query = "SELECT state, count(*) FROM matches WHERE peer = ? AND gallery = ? GROUP BY state"
        return dict(self._records.all(query, peer, gallery))

    def _number(self, peer: str, gallery: str, pair: Pair) -> int:
        query = "SELECT match FROM matches WHERE peer = ? AND gallery = ? AND slot = ? AND peer_slot = ?"
        return int(self._records.all(query, peer, gallery, *pair)[0][0])

    def _tell(self, match: int, state: str) -> Match:
        self._records.run("INSERT OR IGNORE INTO news (match, state) VALUES (?, ?)", match, state)
        return _match(self._records.all(f"{_NEWS} WHERE n.match = ? AND n.state = ?", match, state)[0])


_NEWS = (
    "SELECT n.number, n.match, m.peer, m.gallery, m.keyframe, o.keyframe, n.state, m.why, m.transform, "
    "m.weight, m.peer_state FROM news n JOIN matches m ON m.match = n.match LEFT JOIN opened o ON o.peer = m.peer AND "
    "o.gallery = m.gallery AND o.slot = m.peer_slot"
)


def _match(row: tuple[object, ...]) -> Match:
    *head, transform, weight, peer_state = row
    number, match, peer, gallery, keyframe, peer_keyframe, state, why = head
    return Match(
        number, match, peer, gallery, keyframe, peer_keyframe, state,  # type: ignore[arg-type]
        why if state != "candidate" else "",  # type: ignore[arg-type]
        None if transform is None or state != "verified" else tuple(json.loads(str(transform))),
        weight if state == "verified" else None,  # type: ignore[arg-type]
        peer_state,  # type: ignore[arg-type]
    )  # fmt: skip
