"""News of matches: numbered, durable, and read once."""

from __future__ import annotations

import json
from typing import Any

from protocols.agent.events import Match
from protocols.agent.records import Records

_QUERY = """
    SELECT n.number, n.match, l.peer, l.gallery, m.keyframe, o.keyframe, n.state, m.why, m.transform,
        m.weight, m.peer_state
    FROM news n JOIN matches m ON m.match = n.match JOIN links l ON l.link = m.link
    LEFT JOIN opened o ON o.link = m.link AND o.slot = m.peer_slot
"""


class News:
    """The part of an agent's records that says which match reached which state, in order.

    Args:
        records: The open records.
    """

    def __init__(self, records: Records) -> None:
        self._records = records

    def tell(self, match: int, state: str) -> Match:
        """Add a piece of news, once; part of the caller's transaction."""
        self._records.run("INSERT OR IGNORE INTO news (match, state) VALUES (?, ?)", match, state)
        return _match(*self._records.all(f"{_QUERY} WHERE n.match = ? AND n.state = ?", match, state)[0])

    def after(self, number: int, most: int = 1000) -> list[Match]:
        """News with larger numbers; all but the state is as it is known now."""
        rows = self._records.all(f"{_QUERY} WHERE n.number > ? ORDER BY n.number LIMIT ?", number, most)
        return [_match(*row) for row in rows]

    @property
    def read_to(self) -> int:
        """Number of the last that was read."""
        rows = self._records.all("SELECT value FROM about WHERE name = 'read'")
        return int(rows[0][0]) if rows else 0

    def read(self, number: int) -> None:
        """Remember that they were read as far as a number."""
        self._records.run("INSERT OR REPLACE INTO about VALUES ('read', ?)", str(max(number, self.read_to)))


def _match(*row: Any) -> Match:
    number, match, peer, gallery, keyframe, peer_keyframe, state, why, transform, weight, peer_state = row
    verified = state == "verified"
    return Match(
        number,
        match,
        peer,
        gallery,
        keyframe,
        peer_keyframe,
        state,
        "" if state == "candidate" else why,
        tuple(json.loads(transform)) if verified and transform is not None else None,
        weight if verified else None,
        peer_state,
    )
