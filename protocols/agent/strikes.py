"""Strikes: matches that a peer has not followed with a keyframe that verifies, and what else it has done.

A True bit tells a prober something; an honest robot pays for it with what it saw. So the bits that were not
paid for are counted, over all restarts (docs/threat-model.md, "Probes").
"""

from __future__ import annotations

import time

from protocols.agent.records import Records


class Strikes:
    """What is held against one peer.

    Args:
        records: The open records.
        peer: The robot.
    """

    def __init__(self, records: Records, peer: str) -> None:
        self._records, self._peer = records, peer

    @property
    def reasons(self) -> list[str]:
        """Why it has them, oldest first."""
        rows = self._records.all("SELECT why FROM strikes WHERE peer = ? ORDER BY number", self._peer)
        return [why for (why,) in rows]

    @property
    def outstanding(self) -> int:
        """Matches with it, in all galleries, that may yet become strikes."""
        query = "SELECT count(*) FROM matches JOIN links USING (link) WHERE peer = ? AND state = 'candidate'"
        return int(self._records.all(query, self._peer)[0][0])

    @property
    def owed(self) -> int:
        """Its strikes, and matches in all galleries that it was shown a keyframe for and no verdict is on."""
        query = (
            "SELECT count(*) FROM matches JOIN links USING (link) "
            "WHERE peer = ? AND state = 'candidate' AND shown = 1"
        )
        return len(self.reasons) + int(self._records.all(query, self._peer)[0][0])

    def add(self, why: str, match: int | None = None) -> None:
        """Hold something against it; a match counts once."""
        self._records.run(
            "INSERT OR IGNORE INTO strikes (peer, match, why, at) VALUES (?, ?, ?, ?)",
            *(self._peer, match, why[:200], time.time()),
        )

    def lift(self, match: int) -> None:
        """A match was paid for after all."""
        self._records.run("DELETE FROM strikes WHERE match = ?", match)

    def forgive(self) -> int:
        """Forget all; returns how many there were. What was seen is kept."""
        return self._records.run("DELETE FROM strikes WHERE peer = ?", self._peer)
