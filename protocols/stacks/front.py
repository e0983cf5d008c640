"""What the adapters need of an agent (:class:`protocols.agent.Agent` has it)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from spdz.foundations.types import FloatArray


class Found(Protocol):
    """News of a match, as the agent gives it."""

    @property
    def number(self) -> int:
        """Of this news, ascending."""

    @property
    def match(self) -> int:
        """Of the match, which makes news more than once."""

    @property
    def peer(self) -> str:
        """The other robot's name."""

    @property
    def keyframe(self) -> int | None:
        """This robot's keyframe."""

    @property
    def peer_keyframe(self) -> int | None:
        """The other robot's, once it has shown it."""

    @property
    def state(self) -> str:
        """``candidate``, then ``verified``, ``rejected`` or ``withheld``."""

    @property
    def transform(self) -> tuple[float, ...] | None:
        """What the verification gave."""

    @property
    def weight(self) -> float | None:
        """What the verification gave."""


class Front(Protocol):
    """The robot's agent, as the adapter feeds it."""

    def add(
        self,
        keyframe: int,
        descriptors: Mapping[str, FloatArray],
        payload: bytes = b"",
        stamp: float | None = None,
    ) -> object:
        """Take a keyframe; ValueError for bad input, by name."""


class Running(Front, Protocol):
    """The robot's agent, as a process runs it."""

    def matches(self, timeout: float) -> Iterable[Found]:
        """News of matches, until there is none for so many seconds; read when the next is asked for."""

    def status(self) -> dict[str, Any]:
        """How the agent stands."""
