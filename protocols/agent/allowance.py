"""How many descriptors may be compared with a peer now: its strikes, and what it may learn in a minute."""

from __future__ import annotations

import math
from collections.abc import Callable

from protocols.agent.desk import Peer

_SMALL = 4096
"""Pairs that a step may always have: smaller ones would cost rounds for nothing."""


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

    def holds(self, open_pairs: int) -> bool:
        """Whether pairs that were allowed once must wait: a step compares all that there are.

        A peer that fills slots and hangs up before they are compared, again and again, saves up nothing.
        """
        pairs = self.pairs
        return open_pairs > 0 and (pairs == 0 or (open_pairs > pairs and not self._peer.pairs.untouched))

    def shares(self, waiting: int, own: int, theirs: int, open_pairs: int = 0) -> tuple[int, int]:
        """How many descriptors this side brings, and how many it takes.

        Args:
            waiting: Descriptors that it could bring.
            own: Descriptors that the peer has of it.
            theirs: Descriptors that it has of the peer.
            open_pairs: Pairs of these that are still to be compared.

        Returns:
            Both, such that the pairs that they make with each other and with what is held are allowed, and no
            more than a second's share of the budget, or one descriptor's: strikes are counted between steps,
            and what matches within one is learned before it can be a strike. At least one where nothing was
            spent yet: a budget below one descriptor's pairs would stop all.
        """
        least = int(self._peer.pairs.untouched and not open_pairs)
        pairs = min(max(0, self.pairs - open_pairs), max(_SMALL, self._peer.pairs.second, own + theirs + 1))
        # n more on both sides make n (own + theirs) + n^2 pairs.
        both = int((math.sqrt((own + theirs) ** 2 + 4 * pairs) - (own + theirs)) / 2)
        brings = min(waiting, max(least, both)) if pairs else 0
        takes = max(least, (pairs - brings * theirs) // max(1, own + brings)) if pairs else 0
        scarce = waiting and not both and pairs + open_pairs >= self._peer.pairs.left
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
