"""Matching that outlives its connections: batch after batch with one peer, whatever the radio does.

Every batch has a number, and batch k of one robot is compared with batch k of the other. At the beginning of
each batch, and after each new connection, both sides tell where they are: number, token, descriptors and
tiles done of the current batch and of the one before it. Then they go on at the tile that one of them misses,
in the older batch if they stand in two. They can differ by no more than that while neither has restarted: the
last frame of a run may reach one side only. A tile that is run again for the peer keeps its first result
here.

Cost: one exchange of a few hundred bytes a batch and connection. A broken connection costs the jobs of at
most two runs (of 64 jobs, or 2 MB of masked descriptors, each): one robot may be a run ahead. What a peer
gains by claiming to be
behind: the runs of one batch, again, at the price of jobs: repetitions in the sense of the threat model,
within the number that was dealt.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy.typing as npt

from protocols.batch import Batch, Block, Matches, tiles_together
from protocols.catalog import Purpose
from protocols.matching import check_descriptors
from protocols.position import Offer, Position, meeting
from protocols.reconnecting import FAREWELL, Reconnecting
from spdz.foundations.errors import ChannelError, OutOfStep, SpdzError, TapeExhausted
from spdz.session import Session, open_session
from spdz.session.connect import check_where
from spdz.session.turn import Turn
from spdz.tape import Tape, TapeHeader

Self = TypeVar("Self", bound="Matcher")


class Matcher(Reconnecting[Session]):
    """One robot's side of a matching with one peer. Both robots make one, and match equally often.

    ::

        with Matcher("mission/alice/bob.tape", threshold=0.8, listen="0.0.0.0:9000") as matcher:
            for batch in batches:
                print(np.argwhere(matcher.match(batch).decisions))

    Args:
        tape: This robot's tape for the peer.
        threshold: Public threshold in the score's units (None where the tapes reveal scores).
        listen: ``"host:port"`` to accept the peer at; or
        connect: ``"host:port"`` to reach it at. Exactly one of the two.
        credentials: Folder of ca.pem, cert.pem and key.pem; the tape's folder if not given.
        insecure: Plain TCP without encryption or authentication, for closed test networks only.
        wait: Seconds to look for the peer, at the start and whenever it is lost; longer than ``timeout``,
            since the peer may notice a broken line only then.
        timeout: Seconds that one round may take.
        state_dir: Where the second record of what was used is kept (default: the user's state folder).
        first: Number of the first batch; None for the one at which the peer is, for a robot that was
            restarted and whose batches are a stream of what is new: its next descriptors are that batch then.
        on_block: Called with every block of pairs as soon as it is decided.
        on_event: Called with a sentence whenever the connection is lost or made again, and when the reason
            changes why there is none yet.
        progress: Called with tiles done and tiles in all of the current batch.

    Raises:
        ValueError: for bad arguments, or a threshold that does not suit the tape.
        TapeError: if the tape cannot be used.
    """

    def __init__(
        self,
        tape: str | Path,
        threshold: float | None = None,
        *,
        listen: str | None = None,
        connect: str | None = None,
        credentials: str | Path | None = None,
        insecure: bool = False,
        wait: float = 60.0,
        timeout: float = 30.0,
        state_dir: str | Path | None = None,
        first: int | None = 0,
        on_block: Callable[[Block], None] = lambda block: None,
        on_event: Callable[[str], None] = lambda sentence: None,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        if first is not None and first < 0:
            raise ValueError(f"the first batch's number must not be negative, not {first}")
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
        self._tape, self._wait, self._threshold = tape, wait, threshold
        with Tape.open(tape, state_dir=None if state_dir is None else Path(state_dir)) as opened:
            self._header, self._remaining = opened.header, opened.remaining
            self.rolled_back = opened.rolled_back
        super().__init__(self._header.peer, on_event)
        self._purpose = Purpose.from_json(self._header.program)
        self._program = self._purpose.program(threshold)
        self._together = tiles_together(self._purpose, self._program, self._header.security)
        self._on_block, self._progress = on_block, progress
        self._number: int | None = first
        self._current: Batch | None = None
        self._previous: Batch | None = None
        self._turn = Turn("matcher")

    def __repr__(self) -> str:
        return f"<matcher of {self._header.name} with {self._header.peer}: batch {self._number}>"

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self.finish()
        finally:
            self.close()

    @property
    def header(self) -> TapeHeader:
        """The tape's header."""
        return self._header

    @property
    def rule(self) -> str:
        """What is decided, for people: ``S10 >= 0.8``."""
        return self._purpose.rule(self._threshold)

    @property
    def remaining(self) -> int:
        """Jobs left on the tape."""
        return self._remaining if self._session is None else self._session.remaining

    @property
    def number(self) -> int | None:
        """Number of the next batch; None until the peer has said it, where it was left to the peer."""
        return self._number

    @property
    def partial(self) -> Matches | None:
        """What has been decided, checked and final, of a batch that is under way or was broken off."""
        return None if self._current is None else self._current.matches

    def check(self, descriptors: npt.ArrayLike) -> None:
        """Raise :class:`ValueError` if these descriptors do not suit the tape."""
        check_descriptors(self._purpose, self._program, descriptors)

    def connect(self) -> None:
        """Reach the peer now, within ``wait`` seconds, instead of with the first batch."""
        with self._turn:
            self._see_through(self._wait, lambda session: None)

    def match(self, descriptors: npt.ArrayLike) -> Matches:
        """Compare the next batch with the peer's of the same number, however often the connection breaks.

        Args:
            descriptors: Own descriptors, shape (n, N); none are a legal batch.

        Returns:
            Which pairs match.

        Raises:
            ValueError: for bad descriptors; nothing is consumed, and the number stays.
            ChannelError: if the peer was not reached, or nothing went on, for ``wait`` seconds.
            OutOfStep: if the peer has no batch of this number, or forgot it.
            TapeExhausted: if the tapes do not hold enough jobs; nothing is consumed.
            SpdzError: if the peer cheats or will not go on. Of every such error ``error.partial`` is what had
                been decided, checked and final.
        """
        own = check_descriptors(self._purpose, self._program, descriptors)
        with self._turn:
            broken = self._current
            if broken is None or not broken.matches.pairs:
                self._current = Batch(self._number or 0, own, self._purpose, self._header.party)
            elif not broken.holds(own):
                raise ValueError(
                    f"batch {broken.number} was broken off with {broken.matches.pairs} pairs decided: go on "
                    "with it, by resume() or with the same descriptors"
                )
            return self._finished()

    def resume(self) -> Matches:
        """Go on with the batch that an error has broken off; as :meth:`match`."""
        with self._turn:
            return self._finished()

    def _finished(self) -> Matches:
        if (batch := self._current) is None:
            raise ValueError("no batch was broken off: call match() with the next one")
        try:
            self._see_through(self._wait, self._go_on)
        except SpdzError as error:
            error.partial = batch.matches
            raise
        self._previous, self._current = batch, None
        self._number = batch.number + 1
        return batch.matches

    def finish(self) -> None:
        """Tell the peer that no further batch comes, and let it have what it has missed.

        If it cannot be reached for ten seconds it has probably ended too; that and a peer with further
        batches are told as events, since all results are there already.

        Raises:
            SpdzError: if the peer cheats.
        """
        with self._turn:
            self._current = None  # what was given up is not run any more
            if self._previous is None:
                return
            try:
                self._see_through(min(self._wait, FAREWELL), self._go_on)
            except (ChannelError, OutOfStep, TapeExhausted) as error:
                self._on_event(f"ended without {self._header.peer}: {error}")
            finally:
                self._previous = None

    def _open(self, wait: float) -> Session:
        return open_session(self._tape, wait=wait, **self._where)

    def _ended(self, session: Session) -> None:
        self._remaining = session.remaining

    def _go_on(self, session: Session) -> None:
        """Until both sides are through with the current batch, or with all if there is none."""
        served = False
        while True:
            own = Position(self._number, Offer.of(self._current), Offer.of(self._previous))
            peer = Position.read(session.exchange_note(own.as_json()))
            agreed = meeting(own, peer, self._header.peer)
            self._number = own.beside(peer)
            if agreed is None:
                return
            number, offer, done = agreed
            batch = self._current if number == self._number else self._previous
            if batch is None or (served and batch is not self._current):
                raise OutOfStep(f"{self._header.peer} stays at batch {number} although it is through with it")
            batch.number, served = number, True
            batch.meet(offer.token, offer.descriptors, done, session.remaining)
            for tiles in batch.run(session, self._program, self._together, self._on_block):
                self._progressed = True
                if batch is self._current:
                    self._progress(tiles, batch.tiles)
            if batch is self._current:
                return
