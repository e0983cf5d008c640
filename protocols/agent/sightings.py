"""Where peers were said to be: a few addresses each, in the order in which they are worth a try.

Anybody on the local network can say anything. So what was said is a hint: nothing takes the place of an
address that has not failed, and what has failed falls behind what was not tried.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

MOST = 8
MOST_OF_ONE = 4
"""Security limits: addresses of a peer, and those of one source among them."""


@dataclass
class _Peer:
    """Addresses with who said so: those worth a try, and those that failed or were taken back."""

    fresh: dict[str, str] = field(default_factory=dict)
    stale: dict[str, str] = field(default_factory=dict)

    def demote(self, address: str) -> None:
        for book in (self.fresh, self.stale):
            if address in book:
                self.stale[address] = book.pop(address)
                return

    def add(self, address: str, source: str) -> None:
        if address in self.fresh:
            return
        if self.stale.pop(address, None) is None and len(self.fresh) + len(self.stale) >= MOST:
            if not self.stale:
                return
            del self.stale[next(iter(self.stale))]
        self.fresh[address] = source


class Sightings:
    """Where each peer was seen. Any thread may use it.

    Args:
        peers: Names of the robots to remember anything of.
    """

    def __init__(self, peers: Collection[str]) -> None:
        self._peers = {peer: _Peer() for peer in peers}
        self._lock = threading.Lock()

    def first(self, peer: str) -> str | None:
        """The address to try next, as ``host:port``; None if there is none.

        Raises:
            KeyError: if it is not one of the peers.
        """
        with self._lock:
            book = self._peers[peer]
            return next(iter(book.fresh), None) or next(iter(book.stale), None)

    def seen(self, peer: str, source: str, addresses: Sequence[str]) -> None:
        """Somebody says where a peer is; what the same source said before and says no more falls behind.

        Args:
            peer: One of the peers.
            source: Who says so, as far as anybody can tell.
            addresses: ``host:port``, the best first.
        """
        with self._lock:
            book = self._peers[peer]
            known = [address for address, by in book.fresh.items() if by == source]
            said = list(dict.fromkeys(addresses))[:MOST_OF_ONE]
            if known == said:
                return
            for address in known:
                book.demote(address)
            for address in said:
                book.add(address, source)

    def gone(self, source: str) -> None:
        """A source takes back what it said: its addresses fall behind, and are kept."""
        with self._lock:
            for book in self._peers.values():
                for address in [known for known, by in book.fresh.items() if by == source]:
                    book.demote(address)

    def failed(self, peer: str, address: str) -> None:
        """An address of a peer did not lead to it: the others come first."""
        with self._lock:
            self._peers[peer].demote(address)
