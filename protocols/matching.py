"""Every descriptor of one robot against every descriptor of the other, over one open session.

Within a tile each descriptor is masked and sent once, and each pair costs one dealt scalar, one opened
element and (for a candidate bit) one DCF key. :class:`protocols.Matcher` does the same over connections that
break.

What the peer learns besides the results: how many descriptors there are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from protocols.batch import Batch, Block, Matches, tiles_together
from protocols.catalog import Purpose
from spdz.arithmetic.public import refuse_masked
from spdz.foundations.errors import OutOfStep, ProtocolViolation, SpdzError
from spdz.readings.program import Program, quantise
from spdz.session import Session
from spdz.tape import TapeHeader

_MOST = 1 << 24
"""Security limit: descriptors that a peer may say it has in one batch."""


def match(
    session: Session,
    descriptors: npt.ArrayLike,
    threshold: float | None = None,
    *,
    on_block: Callable[[Block], None] = lambda block: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Matches:
    """Compare all own descriptors with all of the peer's. Both robots call this at the same time.

    Args:
        session: An open session.
        descriptors: Own descriptors, shape (n, N); none are a legal batch.
        threshold: Public threshold in the score's units, the same on both sides (None where the tapes
            reveal scores).
        on_block: Called with every block of pairs as soon as it is decided.
        progress: Called with jobs done and jobs in all.

    Returns:
        Which pairs match.

    Raises:
        ValueError: for bad descriptors; nothing is consumed.
        TapeExhausted: if the tapes do not hold enough jobs for all pairs; nothing is consumed.
        SpdzError: if anything else goes wrong; the session is dead. ``error.partial`` is what had been
            decided.
    """
    purpose, program, own = check(session.header, descriptors, threshold)
    batch = Batch(0, own, purpose, session.party)
    try:
        note = session.exchange_note({"descriptors": len(own)})
        if set(note) != {"descriptors"}:
            raise OutOfStep(
                "the peer uses a Matcher (as the command does), this side match(): use one of them on both"
            )
        batch.meet("", sensible_count(note["descriptors"]), 0, session.remaining)
        for done in batch.run(
            session, program, tiles_together(purpose, program, session.header.security), on_block
        ):
            progress(done, batch.tiles)
    except SpdzError as error:
        error.partial = batch.matches
        raise
    return batch.matches


def check(
    header: TapeHeader, descriptors: npt.ArrayLike, threshold: float | None
) -> tuple[Purpose, Program, npt.NDArray[Any]]:
    """Whether descriptors and threshold suit a tape, as far as this robot can tell alone.

    Returns:
        The tape's purpose, the program to run, and the descriptors as an array.

    Raises:
        ValueError: naming what does not suit.
    """
    purpose = Purpose.from_json(header.program)
    program = purpose.program(threshold)
    return purpose, program, check_descriptors(purpose, program, descriptors)


def check_descriptors(purpose: Purpose, program: Program, descriptors: npt.ArrayLike) -> npt.NDArray[Any]:
    """The descriptors as an array of shape (n, N), n >= 0; raises ValueError naming what does not suit."""
    refuse_masked(descriptors, "descriptors")
    own = np.asarray(descriptors)
    if own.shape == (0,):
        own = np.empty((0, purpose.dim))
    if own.ndim != 2 or own.shape[1] != purpose.dim:
        raise ValueError(f"expected descriptors of shape (n, {purpose.dim}) for these tapes, got {own.shape}")
    if len(own):
        quantise(program, own, "descriptors")
    return own


def sensible_count(count: object) -> int:
    """A number of descriptors that a peer sent."""
    if type(count) is not int or not 0 <= count <= _MOST:
        raise ProtocolViolation("the peer's number of descriptors is not a sensible number")
    return count
