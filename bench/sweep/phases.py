"""Where a comparison's time goes: a profile's own times, grouped by what the module is for.

A function's own time counts for its module. What is not of this project (NumPy, hashing, system calls)
counts for whoever called it, in proportion to how long each caller did. Waiting for the peer is in ``poll``,
which the channel calls, so it counts as network. A profiler slows short functions down more than long ones:
shares are rough.
"""

from __future__ import annotations

import cProfile
import pstats
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import spdz

PHASES = ("mask", "network", "field", "aes", "mac_check", "rest")

COMPILED = "<compiled program>"
"""The file that the profiler names for compiled code (:mod:`spdz.compiled.source`)."""

RULES: tuple[tuple[str, str], ...] = (
    (COMPILED, "field"),
    ("spdz/compiled/kernels.py:hidden_words", "mask"),
    ("spdz/compiled/kernels.py:check_hidden", "mask"),
    ("spdz/compiled/kernels.py:words_of", "mask"),
    ("spdz/compiled/kernels.py:mask_words", "mask"),
    ("spdz/compiled/kernels.py:element_of", "network"),
    ("spdz/compiled/kernels.py:elements_of", "network"),
    ("spdz/compiled/kernels.py", "field"),
    ("spdz/arithmetic/fixed_point.py", "mask"),
    ("spdz/values/input_mask.py", "mask"),
    ("spdz/gates/inputs.py", "mask"),
    ("spdz/channels/", "network"),
    ("spdz/session/driver.py", "network"),
    ("spdz/rounds/wire.py", "network"),
    ("spdz/rounds/mac_check.py:drive", "rest"),
    ("spdz/rounds/mac_check.py:_send", "network"),
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
arithmetic on shares, all straight-line code that a program was compiled to among it (the masking of a few
numbers, too, which is part of that code). rest: reading the program, agreeing, bookkeeping.
"""

_ROOT = Path(spdz.__file__).resolve().parent.parent
_DEPTH = 20  # calls from this project's code down to a foreign function, at most
_LEAST = 1e-9  # seconds: the profiler's clock may say that a call took none
_PACKAGES = ("spdz/", "protocols/", "dealer/", "bench/")

Function: TypeAlias = tuple[str, int, str]
"""File, line, and name, as the profiler has them."""


def phases(profile: cProfile.Profile) -> dict[str, float]:
    """Seconds of each of :data:`PHASES` in a profile that has ended; they sum to all own times in it."""
    stats: Any = pstats.Stats(profile)
    functions: dict[Function, Any] = stats.stats
    shares = _shares(functions)
    total: defaultdict[str, float] = defaultdict(float)
    for function, (_, _, own, _, callers) in functions.items():
        if (
            phase_of(function) is None
        ):  # how its time spreads over its callers is known better than its shares
            here = _mixed({caller: row[2] for caller, row in callers.items()}, shares)
        else:
            here = shares[function]
        for name, share in (here or {"rest": 1.0}).items():
            total[name] += own * share
    return {phase: total[phase] for phase in PHASES}


def scaled(seconds: Mapping[str, float], whole: float) -> dict[str, float]:
    """The same shares of another whole."""
    measured = sum(seconds.values())
    return {phase: value / measured * whole if measured else 0.0 for phase, value in seconds.items()}


def phase_of(function: Function) -> str | None:
    """What a function's own time counts as; None if it is not of this project."""
    if "cryptography" in function[0] or "cryptography" in function[2]:
        return "aes"
    if function[0] == COMPILED:
        return dict(RULES)[COMPILED]
    try:
        path = Path(function[0]).resolve().relative_to(_ROOT).as_posix()
    except ValueError:
        return None
    if not path.startswith(_PACKAGES):
        return None
    place = f"{path}:{function[2]}"
    return next((phase for prefix, phase in RULES if place.startswith(prefix)), "rest")


def _shares(functions: Mapping[Function, Any]) -> dict[Function, dict[str, float]]:
    """For which phases each function works: its own, or what its callers work for, by their time.

    Foreign functions call each other, in circles too: this goes from callers to called until all are reached.
    """
    known: dict[Function, dict[str, float]] = {}
    foreign = []
    for function in functions:
        phase = phase_of(function)
        if phase is None:
            foreign.append(function)
        else:
            known[function] = {phase: 1.0}
    for _ in range(_DEPTH):
        for function in foreign:
            callers = functions[function][4]
            known[function] = _mixed({caller: row[3] for caller, row in callers.items()}, known)
    return known


def _mixed(
    weights: Mapping[Function, float], shares: Mapping[Function, Mapping[str, float]]
) -> dict[str, float]:
    """The weighted mean of those functions' shares that are known; empty if none is."""
    result: defaultdict[str, float] = defaultdict(float)
    for function, weight in weights.items():
        for name, share in shares.get(function, {}).items():
            result[name] += share * max(weight, _LEAST)
    whole = sum(result.values())
    return {name: value / whole for name, value in result.items()}
