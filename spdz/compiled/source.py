"""From what was written down to Python functions.

``ahead(stream, alpha)`` computes what depends on the tape alone and returns it. What follows is written
twice, with the same lines: ``online(early, alpha, mac_check, data)`` is a generator that yields the
protocol's requests, so that several can run in the same rounds; ``direct``, of the same and ``rounds``, calls
:class:`~spdz.compiled.straight.Rounds` instead, which is quicker for a single one. The source holds names,
numbers that are public, and nothing of a tape.
"""

from __future__ import annotations

import re
import types
from typing import Any

from spdz.arithmetic.field import P, to_list
from spdz.compiled.order import line, lines, needed
from spdz.compiled.slots import Slot
from spdz.compiled.straight import Code
from spdz.compiled.trace import Trace
from spdz.rounds.coroutine import TAKE, Check, Exchange, Post

_PLACE = re.compile(r"<(pad|stored) (\d+) (\d+)>")
_REQUESTS = {"Check": Check, "Exchange": Exchange, "Post": Post, "TAKE": TAKE}
_CALLS = {
    "yield Exchange(": "rounds.exchange(",
    "yield Post(": "rounds.post(",
    "yield TAKE": "rounds.take()",
    "yield Check()": "rounds.check()",
}
_GAP = 8
"""Elements between two draws that are converted along with them: cheaper than another call."""


def written(trace: Trace, result: Slot) -> Code:
    """Compile what was written down."""
    kept = needed(trace.operations, result)
    early = [one for one in kept if one.target is not None and one.target.early]
    later = [one for one in kept if one.target is None or not one.target.early]
    made = [one.target.name for one in early if one.target is not None]
    read = {slot.name for one in later for slot in one.operands}
    handed = f"({''.join(f'{name}, ' for name in made if name in read)})"
    body = _indented(f"{handed} = early", *lines(later, [*made, "alpha"]), f"return {result.name}")
    functions = [
        "def ahead(stream, alpha):",
        *_indented("pad, stored = stream.elements"),
        *_indented(*_reads([line(one) for one in early]), f"return {handed}"),
        "",
        "def online(early, alpha, mac_check, data):",
        *body,
        "",
        "def direct(early, alpha, mac_check, data, rounds):",
        *map(_called, body),
    ]
    source = "\n".join(functions) + "\n"
    space: dict[str, Any] = {**trace.names, "P": P, "to_list": to_list, **_REQUESTS}
    exec(compile(source, "<compiled program>", "exec"), space)
    return Code(source, space["ahead"], types.coroutine(space["online"]), space["direct"])


def _called(line: str) -> str:
    """A line that calls where it yielded."""
    for request, call in _CALLS.items():
        line = line.replace(request, call)
    return line


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
