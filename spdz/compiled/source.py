"""From what was written down to Python functions.

``ahead(stream, alpha)`` computes what depends on the tape alone and returns it. What follows is written
twice, with the same lines: ``online(early, alpha, mac_check, data)`` is a generator that yields the
protocol's requests, so that several can run in the same rounds; ``direct``, of the same and ``rounds``, calls
:class:`Rounds` instead, which is quicker for a single one. The source holds names,
numbers that are public, and nothing of a tape.
"""

from __future__ import annotations

import re
import types
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.field import P, to_list
from spdz.arithmetic.fixed_point import encode_few
from spdz.compiled.order import line, lines, needed
from spdz.compiled.slots import Slot
from spdz.compiled.trace import Trace
from spdz.foundations.errors import TapeDamaged, Wrapped
from spdz.foundations.stats import Stats
from spdz.foundations.types import Buffer, IntArray, Security, Shape
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import TAKE, Check, Exchange, Post, Request
from spdz.rounds.mac_check import MacCheck, left_unchecked, unrecorded

_FLOAT64 = np.dtype(np.float64)
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


class Rounds(Interface):
    """What runs the rounds of a single job: each does what the request of its name asks for.

    Attributes:
        mac_check: The session's check; None in semi-honest mode.
    """

    mac_check: MacCheck | None

    def exchange(self, payload: Sequence[Buffer], expect: int, elements: int) -> memoryview:
        """One round."""

    def post(self, payload: Sequence[Buffer], expect: int, elements: int) -> None:
        """Its first half."""

    def take(self) -> memoryview:
        """Its second half."""

    def check(self) -> None:
        """One MAC check; nothing in semi-honest mode."""


@dataclass(frozen=True, slots=True)
class Code:
    """The functions, and their source."""

    source: str = field(repr=False)
    ahead: Callable[[JobStream, int | None], tuple[Any, ...]] = field(repr=False)
    online: Callable[..., Generator[Request, Any, Any]] = field(repr=False)
    direct: Callable[..., Any] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Straight:
    """A compiled program of one party.

    Attributes:
        code: Its functions.
        security: The security model.
        sizes: Bytes of pad and of correction that it draws.
        correlations: What it uses, by kind.
        shape: Of its input, if that is a list of integers in C order instead of an array.
        limit: The largest square of such an input's norm that needs no further look.
    """

    code: Code
    security: Security
    sizes: tuple[int, int]
    correlations: Counter[str]
    shape: Shape | None
    limit: int

    def quantised(self, data: npt.ArrayLike) -> list[int] | None:
        """An input of few numbers as it is to be; None if that is an array, or takes a further look."""
        if type(data) is np.ndarray and data.shape == self.shape and data.dtype == _FLOAT64:
            return encode_few(data, self.limit)
        return None

    def taken(self, raw: IntArray) -> IntArray | list[int]:
        """A quantised input as it is to be."""
        return raw if self.shape is None else raw.ravel().tolist()

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
        data: IntArray | list[int],
        stats: Stats,
    ) -> Generator[Request, Any, Any]:
        """The protocol, from the owner's quantised input to the opened result: it can be awaited, too.

        Raises:
            MacCheckFailed: in the malicious mode without a check, before anything is sent.
        """
        self._require(mac_check)
        stats.correlations.update(self.correlations)
        return self.code.online(early, alpha, mac_check, data)

    def run_alone(
        self, early: tuple[Any, ...], alpha: int | None, data: IntArray | list[int], rounds: Rounds
    ) -> Any:
        """The same to its end; returns the opened result.

        Raises:
            MacCheckFailed: if a check fails; in the malicious mode without a check, before anything is sent.
            Wrapped: when an opened number may have wrapped, and carries a valid MAC.
            ChannelError: if the connection fails.
        """
        mac_check = rounds.mac_check
        self._require(mac_check)
        try:
            value = self.code.direct(early, alpha, mac_check, data, rounds)
        except Wrapped:
            if mac_check is not None and mac_check.pending:  # chance, or a lie?
                rounds.check()
            raise
        if mac_check is not None and mac_check.pending:
            raise left_unchecked()
        return value

    def _require(self, mac_check: MacCheck | None) -> None:
        if self.security == "malicious" and mac_check is None:
            raise unrecorded()


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
