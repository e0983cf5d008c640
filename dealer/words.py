"""Counts and times in words, for people."""

from __future__ import annotations

_LARGE = 99.5
"""What has two digits at most, as is told."""
_UNITS = (("s", 1), ("min", 60), ("h", 3600))
_DAY = 86_400


def counted(count: int, one: str, many: str | None = None) -> str:
    """``1 pair``, ``190 pairs``.

    Args:
        count: How many.
        one: What one of them is called.
        many: What several are; with an ``s`` at the end if not given.
    """
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def each_pair(count: int) -> str:
    """For whom something is dealt: ``for a pair of robots``, ``for each of 190 pairs of robots``."""
    return "for a pair of robots" if count == 1 else f"for each of {counted(count, 'pair')} of robots"


def in_seconds(estimate: float) -> str:
    """A time in two digits, in seconds, minutes, hours or days."""
    for unit, seconds in _UNITS:
        if estimate / seconds < _LARGE:
            return f"{estimate / seconds:.2g} {unit}"
    days = estimate / _DAY
    return f"{days:.2g} days" if days < _LARGE else f"{days:,.0f} days"
