"""A robot whose software was changed, against the real protocol: it brings vectors that no honest one may.

Both sides are real gallery sessions, malicious model, dealt on the spot; they talk over memory in two
threads. The insider's session is the engine's own, but for two changes: it fills slots with raw integers that
nobody checked, and does not refuse itself when its proof of norm fails.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dealer.gallery import deal_gallery
from protocols.catalog import GalleryPurpose
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.channels.memory import MemoryChannel, memory_pair
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.types import FloatArray, IntArray
from spdz.gallery.ledger import Ledger
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.session.admission import quantised
from spdz.session.gallery import GallerySession
from spdz.session.strips import Step

AGENTS = ("alice", "bob")
TIMEOUT = 60.0
"""Seconds that a frame may take."""
_SPARE = 8
"""Slots beyond what is filled: the longer a vector, the fewer masks suit it."""


@dataclass(frozen=True, slots=True)
class RefusalRow:
    """What happened to a probe in the real protocol.

    Attributes:
        probe: What the modified robot brought.
        norm: Its norm.
        score: The score.
        min_norm: Smallest norm that the gallery was dealt for.
        proof: Whether the gallery was dealt with proofs of norm.
        refused: Whether the honest robot refused it.
        error: What the honest robot raised, or nothing.
        names: Whether the error names the robot that brought it.
        bits: Candidate bits that the prober got.
        matches: How many of these were True.
    """

    probe: str
    norm: float
    score: str
    min_norm: float
    proof: bool
    refused: bool
    error: str
    names: bool
    bits: int
    matches: int


class Insider(GallerySession):
    """The engine's session without the refusal of its own proof."""

    def _refuse_unproved(self, *_: Any) -> None:
        pass


def refusals(victim: FloatArray, threshold: float) -> list[RefusalRow]:
    """Bring probes of every length against a victim's vectors.

    Args:
        victim: ``(n, N)``, norm 1: Alice's.
        threshold: Of the inner product.
    """
    dim, one = victim.shape[1], float(1 << FRACTION_BITS)
    unit = victim[0] * one
    product, unproved = (GalleryPurpose("S10", dim=dim, proof=proof) for proof in (True, False))
    # Under a squared distance a zero vector is 1 from every unit vector; 1.01 lets it match all of them.
    loose, strict = (GalleryPurpose("S6", dim=dim, min_norm=least) for least in (0.0, 0.9))
    spike = np.eye(1, dim)[0]
    cases = (
        ("norm 1, as it should be", unit, product, threshold),
        ("norm 1.01", 1.01 * unit, product, threshold),
        ("norm 2", 2 * unit, product, threshold),
        ("huge: one coordinate of 2^14", spike * one * (1 << 14), product, threshold),
        ("the same, where no proofs were dealt", spike * one * (1 << 14), unproved, threshold),
        ("zero, under a distance without a least norm", 0 * unit, loose, 1.01),
        ("zero, under a distance with one", 0 * unit, strict, 1.01),
    )
    return [
        _tried(name, np.rint(raw).astype(np.int64), purpose, least, victim)
        for name, raw, purpose, least in cases
    ]


def _tried(
    name: str, raw: IntArray, purpose: GalleryPurpose, threshold: float, victim: FloatArray
) -> RefusalRow:
    terms = purpose.terms(threshold, "malicious")
    honest, insider = _met(terms, list(quantised(terms, victim)), [raw])
    if not isinstance(honest, (Step, ProtocolViolation)):
        raise RuntimeError(f"the honest side ended otherwise than a probe can make it: {honest!r}")
    bits = [np.asarray(block.results) for block in insider.blocks] if isinstance(insider, Step) else []
    error = "" if isinstance(honest, Step) else f"{type(honest).__name__}: {honest}"
    return RefusalRow(
        probe=name,
        norm=round(float(np.linalg.norm(raw.astype(np.float64))) / (1 << FRACTION_BITS), 4),
        score=purpose.score,
        min_norm=purpose.min_norm,
        proof=purpose.proof,
        refused=bool(error),
        error=error,
        names=f"of {AGENTS[1]} " in error,
        bits=sum(one.size for one in bits),
        matches=int(sum(one.sum() for one in bits)),
    )


def _met(terms: Terms, honest: Sequence[IntArray], probes: Sequence[IntArray]) -> list[Any]:
    """One step of both; what each side got, or what it raised."""
    with tempfile.TemporaryDirectory(prefix="spdz-attacks-") as temporary:
        folder = Path(temporary)
        paths = (folder / "alice.tape", folder / "bob.tape")
        deal_gallery(paths, AGENTS, terms, (len(honest) + _SPARE, len(probes) + _SPARE))
        outcomes: list[Any] = [None, None]

        def side(
            party: int, kind: type[GallerySession], channel: MemoryChannel, brought: list[IntArray]
        ) -> None:
            try:
                state = folder / f"state-{party}"
                tape = GalleryTape.open(paths[party], state_dir=state)
                ledger = Ledger.open(
                    folder / f"{party}.ledger", tape.header.tape, tape.header.party, state_dir=state
                )
                with kind(tape, ledger, channel, terms, brought) as session:
                    outcomes[party] = session.step()
            except Exception as error:  # handed to the caller, which knows what should have happened
                outcomes[party] = error
            finally:
                channel.close()

        ends = memory_pair(TIMEOUT)
        work = (
            (0, GallerySession, ends[0], list(honest)),
            (1, Insider, ends[1], list(probes)),
        )
        threads = [threading.Thread(target=side, args=one, daemon=True) for one in work]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(3 * TIMEOUT)
        return outcomes
