"""What people are told: a time in a few digits, and why two robots have not met yet.

Who waits for a peer tries many times a second and is refused, or called by strangers, as often. What is told
is each reason, not each try: nobody who calls a listener can fill its log.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from decimal import Decimal

_SAME_AGAIN = 5.0
_EVER = 1e9  # a wait may be infinite


def ignore(text: str) -> None:
    """The default of ``on_listening`` and ``on_event``."""


def in_seconds(seconds: float) -> str:
    """A time in at most three significant digits and without an exponent, as in ``0.25 s``."""
    return f"{Decimal(f'{seconds:.3g}'):f} s"


def printable(text: str) -> str:
    """A text without anything that a terminal would obey; names may come from the other side."""
    return "".join(character if character.isprintable() else "?" for character in text)


def harmless(on_event: Callable[[str], None]) -> Callable[[str], None]:
    """For a thread that serves others: what goes wrong with whoever is told is not its concern."""

    def tell(sentence: str) -> None:
        with contextlib.suppress(Exception):
            on_event(sentence)

    return tell


class Teller:
    """Tells each reason once until another one takes its place.

    Args:
        on_event: Called with a sentence, without a period.
        again: Seconds before a reason that takes turns with another one is told again.
    """

    def __init__(self, on_event: Callable[[str], None], again: float = _SAME_AGAIN) -> None:
        self._on_event, self._again = on_event, again
        self._last = ""
        self._told: dict[str, float] = {}  # reasons are few: the system's, OpenSSL's, the mission's names

    def tell(self, reason: str, prospect: str = "") -> None:
        """Tell a reason if it is news.

        Args:
            reason: What is compared with what was told before.
            prospect: What is said behind it, and may differ from try to try.
        """
        now = time.monotonic()
        if reason != self._last and now >= self._told.get(reason, -math.inf) + self._again:
            self._last, self._told[reason] = reason, now
            self._on_event(printable(reason + prospect))

    def not_yet(self, reason: str, deadline: float) -> None:
        """Tell why an attempt failed that is made again until ``deadline``, on the monotonic clock."""
        left = math.ceil(min(deadline - time.monotonic(), _EVER))
        self.tell(reason, f"; trying again for up to {in_seconds(left)}")
