"""From what was written down to Python functions.

Two functions: ``ahead(stream, alpha)`` computes what depends on the tape alone and returns it, and
``online(early, alpha, mac_check, data)`` is a generator that yields the protocol's requests. The source holds
names, numbers that are public, and nothing of a tape.
"""

from __future__ import annotations

import re
import types
from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any

from spdz.arithmetic.field import P, to_list
from spdz.compiled.order import line, lines, needed
from spdz.compiled.slots import Slot
from spdz.compiled.trace import Trace
from spdz.foundations.errors import TapeDamaged
from spdz.foundations.stats import Stats
from spdz.foundations.types import IntArray, Security
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import TAKE, Check, Exchange, Post, Request
from spdz.rounds.mac_check import MacCheck, unrecorded

_PLACE = re.compile(r"<(pad|stored) (\d+) (\d+)>")
_REQUESTS = {"Check": Check, "Exchange": Exchange, "Post": Post, "TAKE": TAKE}
_GAP = 8
"""Elements between two draws that are converted along with them: cheaper than another call."""


@dataclass(frozen=True, slots=True)
class Code:
    """The two functions, and their source."""

    source: str = field(repr=False)
    ahead: Callable[[JobStream, int | None], tuple[Any, ...]] = field(repr=False)
    online: Callable[..., Generator[Request, Any, Any]] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Straight:
    """A compiled program of one party.

    Attributes:
        code: Its functions.
        security: The security model.
        sizes: Bytes of pad and of correction that it draws.
        correlations: What it uses, by kind.
    """

    code: Code
    security: Security
    sizes: tuple[int, int]
    correlations: Counter[str]

    def ahead(self, stream: JobStream, alpha: int | None) -> tuple[Any, ...]:
        """What can be computed of a job before its inputs are known.

        Raises:
            TapeDamaged: if the job has another size.
        """
        if stream.sizes != self.sizes:
            raise TapeDamaged("the job is not of the size that the program needs")
        return self.code.ahead(stream, alpha)

    def run(
        self,
        early: tuple[Any, ...],
        alpha: int | None,
        mac_check: MacCheck | None,
        data: IntArray,
        stats: Stats,
    ) -> Generator[Request, Any, Any]:
        """The protocol, from the owner's quantised input to the opened result: it can be awaited, too.

        Raises:
            MacCheckFailed: in the malicious mode without a check, before anything is sent.
        """
        if self.security == "malicious" and mac_check is None:
            raise unrecorded()
        for kind, number in self.correlations.items():
            stats.book(kind, number)
        return self.code.online(early, alpha, mac_check, data)


def written(trace: Trace, result: Slot) -> Code:
    """Compile what was written down."""
    kept = needed(trace.operations, result)
    early = [one for one in kept if one.target is not None and one.target.early]
    later = [one for one in kept if one.target is None or not one.target.early]
    made = [one.target.name for one in early if one.target is not None]
    read = {slot.name for one in later for slot in one.operands}
    handed = f"({''.join(f'{name}, ' for name in made if name in read)})"
    functions = [
        "def ahead(stream, alpha):",
        *_indented("pad, stored = stream.elements"),
        *_indented(*_reads([line(one) for one in early]), f"return {handed}"),
        "",
        "def online(early, alpha, mac_check, data):",
        *_indented(f"{handed} = early", *lines(later, [*made, "alpha"]), f"return {result.name}"),
    ]
    source = "\n".join(functions) + "\n"
    space: dict[str, Any] = {**trace.names, "P": P, "to_list": to_list, **_REQUESTS}
    exec(compile(source, "<compiled program>", "exec"), space)
    return Code(source, space["ahead"], types.coroutine(space["online"]))


def _indented(*lines: str) -> list[str]:
    return ["    " + line for line in lines]


def _reads(lines: list[str]) -> list[str]:
    """The lines, behind those that convert all that is read as integers, run by run."""
    wanted = sorted(
        {(w, int(start), int(count)) for line in lines for w, start, count in _PLACE.findall(line)}
    )
    runs: list[tuple[str, int, int]] = []
    for where, start, count in wanted:
        if runs and runs[-1][0] == where and start <= runs[-1][2] + _GAP:
            runs[-1] = (where, runs[-1][1], max(runs[-1][2], start + count))
        else:
            runs.append((where, start, start + count))
    names = {run: f"run{i}" for i, run in enumerate(runs)}

    def place(match: re.Match[str]) -> str:
        where, start, count = match[1], int(match[2]), int(match[3])
        run = next(one for one in runs if one[0] == where and one[1] <= start and start + count <= one[2])
        at = start - run[1]
        return f"{names[run]}[{at}]" if count == 1 else f"{names[run]}[{at}:{at + count}]"

    made = [f"{names[run]} = to_list({run[0]}[{run[1]}:{run[2]}])" for run in runs]
    return [*made, *(_PLACE.sub(place, line) for line in lines)]
