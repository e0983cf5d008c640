"""The agent for programs on asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt

from protocols.agent.agent import Agent
from protocols.agent.events import Event, Match

T = TypeVar("T")
Self = TypeVar("Self", bound="AsyncAgent")

_SLICE = 0.2
"""Seconds that a reader's thread blocks at a time: so a cancelled reader leaves none behind."""


class AsyncAgent:
    """An :class:`protocols.agent.Agent` whose calls are awaited; arguments as of it.

    ::

        async with AsyncAgent("mission/alice") as agent:
            await agent.add(17, {"lidar": vector})
            async for match in agent.matches():
                ...
    """

    def __init__(self, mission: str | Path, **options: Any) -> None:
        self._mission, self._options = mission, options
        self._agent: Agent | None = None

    async def __aenter__(self: Self) -> Self:
        self._agent = await asyncio.to_thread(lambda: Agent(self._mission, **self._options))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self.agent.close)

    @property
    def agent(self) -> Agent:
        """The agent; RuntimeError outside ``async with``."""
        if self._agent is None:
            raise RuntimeError("use it as `async with AsyncAgent(...) as agent`")
        return self._agent

    async def add(
        self,
        keyframe: int,
        descriptors: Mapping[str, npt.ArrayLike],
        payload: bytes = b"",
        stamp: float | None = None,
    ) -> None:
        """As :meth:`Agent.add`."""
        await asyncio.to_thread(self.agent.add, keyframe, descriptors, payload, stamp)

    async def events(self) -> AsyncIterator[Event]:
        """Events as they come, until the agent stops."""
        async for event in _each(lambda: self.agent.events(_SLICE), self.agent):
            yield event

    async def matches(self) -> AsyncIterator[Match]:
        """News of matches, as :meth:`Agent.matches`, until the agent stops."""
        async for match in _each(lambda: self.agent.matches(_SLICE), self.agent):
            yield match

    def status(self) -> dict[str, Any]:
        """As :meth:`Agent.status`."""
        return self.agent.status()

    async def forgive(self, peer: str) -> int:
        """As :meth:`Agent.forgive`."""
        return await asyncio.to_thread(self.agent.forgive, peer)


async def _each(begin: Any, agent: Agent) -> AsyncIterator[Any]:
    """Read an iterator that ends after a moment of silence, again and again, in threads."""
    while True:
        iterator: Iterator[Any] = begin()
        missing = object()
        while (one := await asyncio.to_thread(next, iterator, missing)) is not missing:
            yield one
        if agent.stopped:
            return
