"""Galleries that outlive their connections: streams of keyframes, each compared with all that the peer has.

Both robots make a :class:`Gallery` and call :meth:`Gallery.step` equally often, each time with what is new,
or with nothing. Steps are numbered. When a connection breaks in the middle of a step one robot may be through
with it and the other not; then the one that is through serves it once more, before its next step or when it
ends. What was compared is never compared again, and a robot that was restarted goes on with the peer's
number.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt

from protocols.gallery_contents import GalleryContents
from protocols.reconnecting import FAREWELL
from spdz.foundations.errors import ChannelError, OutOfStep, ProtocolViolation, SpdzError, TapeExhausted
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession, Step, open_gallery
from spdz.session.admission import quantised
from spdz.session.connect import check_where
from spdz.session.turn import Turn

Self = TypeVar("Self", bound="Gallery")

_MOST_STEPS = 1 << 53


class Gallery(GalleryContents):
    """One robot's side of a gallery with one peer.

    ::

        with Gallery("mission/alice/bob.tape", threshold=0.8, listen="0.0.0.0:9000") as gallery:
            while driving:
                gallery.add(new_descriptors())          # of shape (n, N); also none
                for own, peer in gallery.step().matches:
                    ...                                 # numbers of slots

    Args:
        tape: This robot's gallery tape for the peer. What it was used for is kept beside it.
        threshold: Public threshold in the score's units (None where the tapes reveal scores). The first one
            that a gallery answers is the only one that it ever answers.
        terms: What the tape was dealt for, where that is a program of your own; with its threshold.
        listen: ``"host:port"`` to accept the peer at; or
        connect: ``"host:port"`` to reach it at. Exactly one of the two.
        credentials: Folder of ca.pem, cert.pem and key.pem; the tape's folder if not given.
        insecure: Plain TCP without encryption or authentication, for closed test networks only.
        wait: Seconds to look for the peer, at the start and whenever it is lost; longer than ``timeout``.
        timeout: Seconds that one round may take.
        state_dir: Where the second record of what was used is kept (default: the user's state folder).
        on_block: Called with every block of results as soon as it is checked and durable.
        on_event: Called with a sentence whenever the connection is lost or made again, and when the reason
            changes why there is none yet.

    Raises:
        ValueError: for bad arguments, or a threshold that does not suit the tape.
        TapeError: if the tape cannot be used.
    """

    def __init__(
        self,
        tape: str | Path,
        threshold: float | None = None,
        *,
        terms: Terms | None = None,
        listen: str | None = None,
        connect: str | None = None,
        credentials: str | Path | None = None,
        insecure: bool = False,
        wait: float = 60.0,
        timeout: float = 30.0,
        state_dir: str | Path | None = None,
        on_block: Callable[[Block], None] = lambda block: None,
        on_event: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        check_where(listen, connect, wait, timeout)
        self._where: dict[str, Any] = {
            "listen": listen,
            "connect": connect,
            "credentials": credentials,
            "insecure": insecure,
            "timeout": timeout,
            "state_dir": state_dir,
            "on_event": on_event,
        }
        super().__init__(tape, threshold, terms, state_dir, on_event)
        self._wait = wait
        self._on_block = on_block
        self._step: Step | None = None
        self._number: int | None = None
        self._fresh = True
        self._turn = Turn("gallery")

    def __repr__(self) -> str:
        return f"<gallery of {self._header.name} with {self._header.peer}>"

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self.finish()
            else:
                self.abandon(error)
        finally:
            self.close()

    def abandon(self, error: BaseException) -> None:
        """End because of an error of this side's own; the peer is told that this side stopped."""
        self._hang_up(error)

    @property
    def partial(self) -> Step | None:
        """What no :meth:`step` has returned yet, as far as it was decided, checked and durable.

        That is a step under way or broken off, or what the peer got of its own when it was served.
        """
        return self._step

    def connect(self) -> None:
        """Reach the peer now, within ``wait`` seconds, instead of with the first step."""
        with self._turn:
            self._see_through(self._wait, self._catch_up)

    def add(self, descriptors: npt.ArrayLike) -> None:
        """Bring descriptors to the next step; any thread may, also while a step is under way.

        Args:
            descriptors: Shape (n, N); none are legal.

        Raises:
            ValueError: for bad descriptors; nothing is consumed.
        """
        self._added.extend(quantised(self._terms, descriptors))

    def step(self) -> Step:
        """Bring what was added and compare all new pairs, however often the connection breaks.

        Returns:
            The slots that the new descriptors are in, and all new results.

        Raises:
            TapeExhausted: if there are not slots enough; what was added and is in no slot yet is forgotten,
                nothing is consumed.
            ChannelError: if the peer was not reached, or nothing went on, for ``wait`` seconds.
            SpdzError: if the peer cheats or will not go on. Of every such error ``error.partial`` is the step
                as far as it was decided, checked and durable; :meth:`step` goes on with it.
        """
        with self._turn:
            step = self._step = self._step or Step()
            try:
                self._see_through(self._wait, self._catch_up)
                self._take_added()
                self._see_through(self._wait, self._go_on)
            except SpdzError as error:
                error.partial = step
                raise
            self._step = None
            return step

    def finish(self) -> None:
        """Part with the peer, and let it have what it has missed of the last step.

        If it cannot be reached for ten seconds it has probably ended too; that and a peer that goes on are
        told as events, since all results are there already.

        Raises:
            SpdzError: if the peer cheats.
        """
        if self._number is None:
            return
        try:
            with self._turn:
                self._see_through(min(self._wait, FAREWELL), self._part)
        except OutOfStep:
            self._on_event(f"{self._header.peer} goes on without this robot")
        except ChannelError as error:
            self._on_event(f"ended without {self._header.peer}: {error}")
        self._number = None

    def _open(self, wait: float) -> GallerySession:
        self._fresh = True
        return open_gallery(self._tape, self._terms, waiting=self._waiting, wait=wait, **self._where)

    def _catch_up(self, session: GallerySession) -> None:
        """On a fresh connection: serve a peer that has missed the end of the last step."""
        if not self._fresh:
            return
        note = session.exchange_note({"step": self._number})
        peer = note.get("step")
        if set(note) != {"step"} or not (peer is None or (type(peer) is int and 0 <= peer < _MOST_STEPS)):
            raise ProtocolViolation("the peer's number of steps is no number")
        if self._number is None or peer is None:
            self._number = max(self._number or 0, peer or 0)
        elif abs(self._number - peer) > 1:
            raise OutOfStep(f"this side is at step {self._number} and the peer at {peer}")
        elif peer < self._number:
            self._step = self._step or Step()  # the next one of this side: it has what the peer still brings
            session.step(self._block, into=self._step)
        self._fresh = False

    def _part(self, session: GallerySession) -> None:
        self._catch_up(session)
        session.part(self._number or 0)

    def _take_added(self) -> None:
        """Bring what was added until now; refuse it where there is no room, while nothing is lost by it."""
        new = self._added[:]
        del self._added[: len(new)]
        try:
            if self._session is not None:
                self._session.require_room(len(new))
        except TapeExhausted:
            self._waiting.clear()
            raise
        self._waiting += new

    def _go_on(self, session: GallerySession) -> None:
        self._catch_up(session)
        session.step(self._block, into=self._step)
        self._number = (self._number or 0) + 1

    def _block(self, block: Block) -> None:
        self._progressed = True
        self._on_block(block)
