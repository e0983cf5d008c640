"""Galleries that outlive their connections: streams of keyframes, each compared with all that the peer has.

Both robots make a :class:`Gallery` and call :meth:`Gallery.step` equally often, each time with what is new,
or with nothing. Steps are numbered. When a connection breaks in the middle of a step one robot may be through
with it and the other not; then the one that is through serves it once more, before its next step or when it
ends. What was compared is never compared again, and a robot that was restarted goes on with the peer's
number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from protocols.catalog import GalleryPurpose
from protocols.reconnecting import FAREWELL, Reconnecting
from spdz.foundations.errors import ChannelError, OutOfStep, ProtocolViolation, SpdzError, TapeExhausted
from spdz.foundations.types import IntArray
from spdz.gallery import GalleryTape
from spdz.gallery.format import GalleryHeader
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession, Step, open_gallery
from spdz.session.admission import quantised
from spdz.session.connect import check_where
from spdz.session.stored import Stored
from spdz.session.turn import Turn

Self = TypeVar("Self", bound="Gallery")

_MOST_STEPS = 1 << 53


class Gallery(Reconnecting[GallerySession]):
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
        with GalleryTape.open(tape, state_dir=None if state_dir is None else Path(state_dir)) as opened:
            self._header = opened.header
        super().__init__(self._header.peer, on_event)
        self._purpose = None if terms is not None else GalleryPurpose.from_json(self._header.program)
        if terms is None:
            terms = GalleryPurpose.from_json(self._header.program).terms(threshold, self._header.security)
        self._tape, self._wait, self._threshold, self._terms = tape, wait, threshold, terms
        self._on_block = on_block
        self._added: list[IntArray] = []  # by any thread; a step takes them when it begins
        self._waiting: list[IntArray] = []  # what the sessions of a step bring
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
    def header(self) -> GalleryHeader:
        """The tape's header."""
        return self._header

    @property
    def rule(self) -> str:
        """What is decided, for people: ``S10 >= 0.8, to 2^-16``."""
        return "a program of your own" if self._purpose is None else self._purpose.rule(self._threshold)

    @property
    def partial(self) -> Step | None:
        """What no :meth:`step` has returned yet, as far as it was decided, checked and durable.

        That is a step under way or broken off, or what the peer got of its own when it was served.
        """
        return self._step

    @property
    def room(self) -> int:
        """Own slots that are neither used nor waited for."""
        with self._holding() as holder:
            waiting = len(self._waiting) if isinstance(holder, Stored) else 0
            return max(0, holder.room - waiting - len(self._added))

    @property
    def unfinished(self) -> bool:
        """Whether pairs wait that an earlier step was to compare."""
        with self._holding() as holder:
            return holder.unfinished

    def check(self, descriptors: npt.ArrayLike) -> None:
        """Refuse descriptors, or a rule, that do not suit the gallery, before the peer is looked for.

        Raises:
            ValueError: for descriptors that do not suit.
            TapeMismatch: if the gallery has answered another threshold or program.
        """
        quantised(self._terms, descriptors)
        with self._holding():
            pass

    def require_room(self, more: int) -> None:
        """Raise :class:`TapeExhausted` unless there are slots for so many more descriptors."""
        if more > self.room:
            raise TapeExhausted(
                f"this gallery has {self.room} slots left for {self._header.name} and {more} are needed. "
                f"Nothing was used. Deal more: {self._header.dealer_command}"
            )

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

    def results(self) -> Iterator[Block]:
        """All results so far, of earlier runs too, strip by strip."""
        with self._holding() as holder:
            yield from holder.results()

    @property
    def filled(self) -> list[int]:
        """Own slots that hold a descriptor, of earlier runs too."""
        with self._holding() as holder:
            return holder.filled

    def holds(self, descriptors: npt.ArrayLike) -> int:
        """How many descriptors this side has brought or will, if they are the first of these, in order.

        Descriptors count whose slots were lost half prepared: the next step brings them once more.

        Raises:
            ValueError: if they are not.
        """
        raw = quantised(self._terms, descriptors)
        with self._holding() as holder:
            held = [*holder.plain(holder.filled), *self._waiting, *self._added]
        if len(raw) < len(held) or not np.array_equal(raw[: len(held)], np.reshape(held, (-1, raw.shape[1]))):
            raise ValueError(
                f"the gallery holds {len(held)} descriptors already, and they are not the first {len(held)} "
                "of these: give the whole map again, with what is new at its end"
            )
        return len(held)

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

    @contextmanager
    def _holding(self) -> Iterator[GallerySession | Stored]:
        """The open session, or what is stored."""
        if self._session is not None:
            yield self._session
            return
        state = self._where["state_dir"]
        with Stored(Path(self._tape), self._terms, None if state is None else Path(state)) as stored:
            yield stored

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
