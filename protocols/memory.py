"""How much memory is there, and a refusal in words before a machine runs out of it."""

from __future__ import annotations

import os
import resource
from contextlib import suppress
from pathlib import Path

_PROC, _CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")


def available_memory() -> int:
    """Bytes that this process may still take: of the machine, its control group and its own limit.

    On Linux what the kernel calls available, elsewhere the machine's whole memory. Swap does not count.
    """
    room = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    with suppress(OSError, ValueError, KeyError):
        room.append(1024 * int(_table(_PROC / "meminfo")["MemAvailable:"]))
    with suppress(OSError, ValueError, KeyError):
        room.append(_room_in_group())
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        with suppress(OSError, ValueError, IndexError):
            pages = int((_PROC / "self" / "statm").read_text().split()[0])
            room.append(limit - pages * os.sysconf("SC_PAGE_SIZE"))
    return max(0, min(room))


def require_memory(needed: int, what: str, remedy: str = "choose a smaller tile") -> None:
    """Refuse what would not fit.

    Args:
        needed: Bytes.
        what: What needs them, for the message.
        remedy: What to do where there are not so many, for the message.

    Raises:
        ValueError: naming the need, what is there, and what to do.
    """
    there = available_memory()
    if needed > there:
        raise ValueError(
            f"{what} needs about {in_bytes(needed)} of memory, and {in_bytes(there)} are available: {remedy}"
        )


def in_bytes(size: float) -> str:
    """A size for people: three digits and a decimal unit."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.3g} TB" if size < 999.5 else f"{size:,.0f} TB"


def _room_in_group() -> int:
    """Of this process's control group (version 2) and those above it; caches can be given back."""
    (line,) = (line for line in (_PROC / "self" / "cgroup").read_text().splitlines() if line[:3] == "0::")
    group = _CGROUPS / line[3:].strip("/")
    room = [1 << 62]
    for folder in (group, *group.parents):
        limit = folder / "memory.max"
        if limit.is_file() and (most := limit.read_text().strip()) != "max":
            cached = int(_table(folder / "memory.stat")["inactive_file"])
            room.append(int(most) - int((folder / "memory.current").read_text()) + cached)
    return min(room)


def _table(path: Path) -> dict[str, str]:
    """Name and first value of each line."""
    words = (line.split() for line in path.read_text().splitlines())
    return {word[0]: word[1] for word in words if len(word) > 1}
