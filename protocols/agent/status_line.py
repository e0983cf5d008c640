"""One line at the bottom of a terminal that says where an agent stands."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from typing import Any


class StatusLine:
    """The line; nothing where the error output is no terminal.

    Args:
        quiet: Show nothing.
    """

    def __init__(self, *, quiet: bool) -> None:
        self._on = not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._shown = False

    def show(self, status: Mapping[str, Any]) -> None:
        """Put a status there."""
        if self._on:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\x1b[K{line(status)[:width]}", end="", file=sys.stderr, flush=True)
            self._shown = True

    def clear(self) -> None:
        """Take it away before something else is printed."""
        if self._shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
            self._shown = False


def line(status: Mapping[str, Any]) -> str:
    """A status in one line."""
    parts = []
    for one in status["galleries"]:
        found = one["matches"]
        verified, others = found.get("verified", 0), sum(found.values()) - found.get("verified", 0)
        news = f", {verified} verified" if verified else ""
        news += f", {others} other matches" if others else ""
        parts.append(
            f"{one['peer']}/{one['gallery']} {one['state']}: {one['keyframes']} x {one['peer_held']}{news}"
        )
    return " | ".join(parts)
