"""How many descriptors may be compared with a peer now: its strikes, and what it may learn in a minute."""

from __future__ import annotations

import math
from collections.abc import Callable

from protocols.agent.desk import Peer


class Allowance:
    """What one side grants a peer.

    Args:
        peer: The other robot and its budgets.
        strikes: Strikes at which it is not compared with any more.
        tell: Called with a sentence when a budget is spent.
    """

    def __init__(self, peer: Peer, strikes: int, tell: Callable[[str], None]) -> None:
        self._peer, self._limit, self._tell = peer, strikes, tell
        self.spent = False

    @property
    def struck(self) -> bool:
        """Whether the peer has too many strikes."""
        return len(self._peer.strikes.reasons) >= self._limit

    @property
    def pairs(self) -> int:
        """Pairs that may be compared now.

        None, while as many matches as may become strikes are neither verified nor strikes: otherwise a peer
        could ask on while it is not yet known whether it pays for what it has learned.
        """
        peer = self._peer
        unsettled = len(peer.strikes.reasons) + peer.strikes.outstanding
        return 0 if unsettled >= self._limit or not peer.matches.left else peer.pairs.left

    def shares(self, waiting: int, own: int, theirs: int) -> tuple[int, int]:
        """How many descriptors this side brings, and how many it takes.

        Args:
            waiting: Descriptors that it could bring.
            own: Descriptors that the peer has of it.
            theirs: Descriptors that it has of the peer.

        Returns:
            Both, such that the pairs that they make with each other and with what is held are allowed; at
            least one where nothing was spent yet: a budget below one descriptor's pairs would stop all.
        """
        pairs, least = self.pairs, int(self._peer.pairs.untouched)
        # n more on both sides make n (own + theirs) + n^2 pairs.
        both = int((math.sqrt((own + theirs) ** 2 + 4 * pairs) - (own + theirs)) / 2)
        brings = min(waiting, max(least, both)) if pairs else 0
        takes = max(least, (pairs - brings * theirs) // max(1, own + brings)) if pairs else 0
        scarce = waiting and not both and pairs == self._peer.pairs.left
        self._note("matches" if not self._peer.matches.left else "pairs" if scarce else "")
        return brings, takes

    def _note(self, spent: str) -> None:
        """Tell that a budget keeps something waiting, once."""
        peer, was = self._peer, self.spent
        gone = {"matches": peer.matches, "pairs": peer.pairs}.get(spent)
        self.spent = gone is not None and not gone.untouched
        if gone is not None and self.spent and not was:
            self._tell(
                f"the budget of {spent} a minute with {peer.name} is spent: on in {gone.pause:.0f} s or later"
            )
