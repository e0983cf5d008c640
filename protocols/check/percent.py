"""Shares as people read them: percent, in figures, table and advice alike."""

from __future__ import annotations

_SMALL = 1e-4
"""Shares below are only said to be: one pair in 10^4 is what a prober's guess is held against."""


def percent(share: float) -> str:
    """A share between 0 and 1: ``"0%"`` and ``"100%"`` are exact, small ones are ``"below 0.01%"``."""
    if share in (0, 1):
        return f"{share:.0%}"
    if share < _SMALL:
        return "below 0.01%"
    return f"{share:.2%}" if share < 0.1 else f"{min(share, 0.999):.1%}"
