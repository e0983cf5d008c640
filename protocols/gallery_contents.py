"""What a gallery holds, read from its session or, without the peer, from what is stored."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from protocols.catalog import GalleryPurpose
from protocols.reconnecting import Reconnecting
from spdz.foundations.errors import TapeExhausted
from spdz.foundations.types import IntArray
from spdz.gallery import GalleryTape
from spdz.gallery.format import GalleryHeader
from spdz.readings.gallery import Terms
from spdz.session import Block, GallerySession
from spdz.session.admission import quantised
from spdz.session.stored import Stored


class GalleryContents(Reconnecting[GallerySession]):
    """The part of :class:`protocols.gallery.Gallery` that needs no connection.

    Args:
        tape: This robot's gallery tape for the peer.
        threshold: As of a gallery.
        terms: As of a gallery.
        state_dir: As of a gallery.
        on_event: As of a gallery.

    Raises:
        ValueError: for a threshold that does not suit the tape.
        TapeError: if the tape cannot be used.
    """

    def __init__(
        self,
        tape: str | Path,
        threshold: float | None,
        terms: Terms | None,
        state_dir: str | Path | None,
        on_event: Callable[[str], None],
    ) -> None:
        self._tape, self._threshold = Path(tape), threshold
        self._state = None if state_dir is None else Path(state_dir)
        with GalleryTape.open(self._tape, state_dir=self._state) as opened:
            self._header = opened.header
        super().__init__(self._header.peer, on_event)
        self._purpose = None if terms is not None else GalleryPurpose.from_json(self._header.program)
        if terms is None:
            terms = GalleryPurpose.from_json(self._header.program).terms(threshold, self._header.security)
        self._terms = terms
        self._added: list[IntArray] = []  # by any thread; a step takes them when it begins
        self._waiting: list[IntArray] = []  # what the sessions of a step bring

    @property
    def header(self) -> GalleryHeader:
        """The tape's header."""
        return self._header

    @property
    def rule(self) -> str:
        """What is decided, for people: ``S10 >= 0.8, to 2^-16``."""
        return self._terms.rule if self._purpose is None else self._purpose.rule(self._threshold)

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

    @contextmanager
    def _holding(self) -> Iterator[GallerySession | Stored]:
        """The open session, or what is stored."""
        if self._session is not None:
            yield self._session
            return
        with Stored(self._tape, self._terms, self._state) as stored:
            yield stored
