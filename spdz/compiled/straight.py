"""A compiled program of one party, and how it is run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.fixed_point import encode_few
from spdz.foundations.errors import TapeDamaged, Wrapped
from spdz.foundations.stats import Stats
from spdz.foundations.types import Buffer, IntArray, Security, Shape
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import Request
from spdz.rounds.mac_check import MacCheck, left_unchecked, unrecorded

_FLOAT64 = np.dtype(np.float64)


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
