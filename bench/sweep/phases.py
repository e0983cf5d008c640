"""Where a comparison's time goes: a profile's own times, grouped by what the module is for.

A function's own time counts for its module. What is not of this project (NumPy, hashing, system calls)
counts for whoever called it, in proportion to how long each caller did. Waiting for the peer is in ``poll``,
which the channel calls, so it counts as network. A profiler slows short functions down more than long ones:
shares are rough.
"""

from __future__ import annotations

import cProfile
import pstats
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import spdz

PHASES = ("mask", "network", "field", "aes", "mac_check", "rest")

RULES: tuple[tuple[str, str], ...] = (
    ("spdz/arithmetic/fixed_point.py", "mask"),
    ("spdz/values/input_mask.py", "mask"),
    ("spdz/gates/inputs.py", "mask"),
    ("spdz/channels/", "network"),
    ("spdz/session/driver.py", "network"),
    ("spdz/rounds/wire.py", "network"),
    ("spdz/rounds/mac_check.py:drive", "rest"),
    ("spdz/rounds/mac_check.py", "mac_check"),
    ("spdz/arithmetic/prf.py", "aes"),
    ("spdz/dcf/", "aes"),
    ("spdz/arithmetic/", "field"),
    ("spdz/gates/", "field"),
    ("spdz/functions/", "field"),
)
"""What modules (or functions, behind a colon) are for; the first that fits counts.

mask: quantising the descriptor and hiding it. network: frames, sending, receiving, waiting. mac_check:
combining and hashing what is checked. aes: keys of comparisons, with what is done to their blocks. field:
arithmetic on shares. rest: reading the program, agreeing, bookkeeping.
"""

_ROOT = Path(spdz.__file__).resolve().parent.parent
_PACKAGES = ("spdz/", "protocols/", "dealer/", "bench/")

Function: TypeAlias = tuple[str, int, str]
"""File, line, and name, as the profiler has them."""


def phases(profile: cProfile.Profile) -> dict[str, float]:
    """Seconds of each of :data:`PHASES` in a profile that has ended."""
    stats: Any = pstats.Stats(profile)
    functions: dict[Function, Any] = stats.stats
    total: Counter[str] = Counter()
    for function, (_, _, own, _, callers) in functions.items():
        phase = phase_of(function)
        if phase is not None:
            total[phase] += own
            continue
        for caller, (_, _, here, _) in callers.items():
            for name, share in _shares(caller, functions, frozenset([function])).items():
                total[name] += here * share
        if not callers:
            total["rest"] += own
    return {phase: total[phase] for phase in PHASES}


def scaled(seconds: Mapping[str, float], whole: float) -> dict[str, float]:
    """The same shares of another whole."""
    measured = sum(seconds.values())
    return {phase: value / measured * whole if measured else 0.0 for phase, value in seconds.items()}


def phase_of(function: Function) -> str | None:
    """What a function's own time counts as; None if it is not of this project."""
    if "cryptography" in function[0] or "cryptography" in function[2]:
        return "aes"
    try:
        path = Path(function[0]).resolve().relative_to(_ROOT).as_posix()
    except ValueError:
        return None
    if not path.startswith(_PACKAGES):
        return None
    place = f"{path}:{function[2]}"
    return next((phase for prefix, phase in RULES if place.startswith(prefix)), "rest")


def _shares(
    function: Function, functions: Mapping[Function, Any], seen: frozenset[Function]
) -> dict[str, float]:
    """Which phases a caller works for: its own, or those of its callers by their time."""
    phase = phase_of(function)
    if phase is not None:
        return {phase: 1.0}
    callers = functions[function][4] if function in functions else {}
    weights = {caller: max(row[3], 0.0) for caller, row in callers.items() if caller not in seen}
    whole = sum(weights.values())
    if not whole:
        return {"rest": 1.0}
    result: Counter[str] = Counter()
    for caller, weight in weights.items():
        for name, share in _shares(caller, functions, seen | {function}).items():
            result[name] += share * weight / whole
    return dict(result)
