"""What a gallery will cost, before anything is dealt.

Bytes on the disk and on the line are exact: those of the tapes' files, and of what belongs to a descriptor or
a pair, without frames, agreements and checks, which are a few hundred bytes a step whatever its size. Times
are those of a small gallery that is dealt and compared here, in memory; memory is an estimate.
"""

from __future__ import annotations

import secrets
import time
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dealer.gallery import BandKeys, GalleryDealing, gallery_headers
from dealer.gallery_limits import gallery_memory, pairs_together
from dealer.gallery_mission import headers_for
from dealer.gallery_trial import Couple
from dealer.randomness import random_mac_key
from protocols.place_purpose import AnyPurpose
from spdz.foundations.errors import Unsent
from spdz.foundations.types import IntArray, Security
from spdz.gallery.format import TAG, GalleryHeader, gallery_bytes
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import GalleryPlan, measure_gallery
from spdz.readings.sections import cuts, encode_sections
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.values.input_mask import element_bytes

_TRIAL_BYTES = 16 << 20
"""Most stored bytes of the pairs that are dealt for timing, unless one tile has more."""
_TRIAL_BANDS = 8
_TRIAL_SECONDS = 0.5


@dataclass(frozen=True, slots=True)
class Seconds:
    """Times on this machine, of one core.

    Attributes:
        deal_descriptor: To deal a slot.
        deal_pair: To deal a pair.
        fill: One robot's for a slot: to prepare a descriptor and prove its norm.
        compare: One robot's for a pair.
    """

    deal_descriptor: float
    deal_pair: float
    fill: float
    compare: float


@dataclass(frozen=True, slots=True)
class GalleryCost:
    """What one pair of robots needs. Pairs of numbers are (party 0, party 1), the order of the names.

    Attributes:
        slots: Descriptors of either robot.
        capacity: Slots that are dealt: whole bands.
        tape_bytes: Sizes of the tape files.
        descriptor_tape_bytes: What the larger tape stores for a descriptor of party 0, and of party 1.
        pair_tape_bytes: What the larger tape stores for a pair.
        descriptor_bytes: What a robot sends for a descriptor of its own.
        descriptor_bytes_peer: What it sends for one of the other's.
        pair_bytes: What the robot that sends more sends for a pair.
        bytes_sent: What either robot sends until all slots are filled and compared.
        rounds: Rounds of a step: to prepare descriptors, and to compare.
        slots_lost: Whether descriptors whose preparation an interruption hits take other slots.
        pairs_lost: Whether pairs whose comparison it hits are not compared again.
        pairs_together: Most pairs that are compared at a time.
        dealing_memory: Bytes of memory to deal, an estimate.
        matching_memory: Bytes of memory that a robot needs with all slots filled, an estimate.
        seconds: Times of one descriptor or pair; None where they were not asked for.
    """

    slots: tuple[int, int]
    capacity: tuple[int, int]
    tape_bytes: tuple[int, int]
    descriptor_tape_bytes: tuple[int, int]
    pair_tape_bytes: int
    descriptor_bytes: tuple[float, float]
    descriptor_bytes_peer: tuple[float, float]
    pair_bytes: float
    bytes_sent: tuple[float, float]
    rounds: tuple[int, int]
    slots_lost: bool
    pairs_lost: bool
    pairs_together: int
    dealing_memory: int
    matching_memory: int
    seconds: Seconds | None

    @property
    def pairs(self) -> int:
        """Pairs of descriptors."""
        return self.slots[0] * self.slots[1]

    @property
    def dealing_seconds(self) -> float | None:
        """To deal all slots, the disk not counted."""
        if self.seconds is None:
            return None
        rows, columns = self.capacity
        return (rows + columns) * self.seconds.deal_descriptor + rows * columns * self.seconds.deal_pair

    @property
    def matching_seconds(self) -> float | None:
        """One robot's computing until all is compared, the line not counted."""
        if self.seconds is None:
            return None
        return sum(self.slots) * self.seconds.fill + self.pairs * self.seconds.compare

    def one_more(self, owner: int) -> tuple[float, float | None]:
        """What a further descriptor of a robot costs against all of the other's: bytes and seconds."""
        peers = self.slots[1 - owner]
        sent = self.descriptor_bytes[owner] + peers * self.pair_bytes
        return sent, None if self.seconds is None else self.seconds.fill + peers * self.seconds.compare


def gallery_cost(
    agents: tuple[str, str],
    purpose: AnyPurpose,
    slots: tuple[int, int],
    security: Security,
    *,
    timed: bool = True,
) -> GalleryCost:
    """Foresee a gallery; arguments as for :func:`dealer.gallery_mission.deal_galleries`.

    Raises:
        ValueError: if the gallery cannot be dealt.
    """
    terms = purpose.dealt_terms(security)
    plan = measure_gallery(terms)
    headers = headers_for(agents, purpose, slots, security)
    own, peer, stored = [], [], []
    for owner, slot in enumerate(plan.slots):
        words = purpose.dim * element_bytes(terms.word_bits)
        bits = slot.bits_sent / 8
        own.append(words + ELEMENT_BYTES * slot.elements_sent[owner] + bits)
        peer.append(ELEMENT_BYTES * slot.elements_sent[1 - owner] + bits)
        stored.append(max(slot.correction_bytes) + TAG)
    pair = tuple(ELEMENT_BYTES * sent + plan.pair.bits_sent / 8 for sent in plan.pair.elements_sent)
    first, second = (
        slots[i] * own[i] + slots[1 - i] * peer[1 - i] + slots[0] * slots[1] * pair[i] for i in (0, 1)
    )
    dealing, matching = gallery_memory(terms, headers[0])
    return GalleryCost(
        slots=slots,
        capacity=headers[0].capacity,
        tape_bytes=(gallery_bytes(headers[0]), gallery_bytes(headers[1])),
        descriptor_tape_bytes=(stored[0], stored[1]),
        pair_tape_bytes=max(plan.pair.correction_bytes),
        descriptor_bytes=(own[0], own[1]),
        descriptor_bytes_peer=(peer[0], peer[1]),
        pair_bytes=max(pair),
        bytes_sent=(first, second),
        rounds=(max(slot.rounds for slot in plan.slots), plan.pair.rounds),
        slots_lost=not all(slot.repeatable for slot in plan.slots),
        pairs_lost=not plan.pair.repeatable,
        pairs_together=pairs_together(headers[0]),
        dealing_memory=dealing,
        matching_memory=matching,
        seconds=measure_seconds(terms, plan, slots) if timed else None,
    )


def measure_seconds(terms: Terms, plan: GalleryPlan, slots: tuple[int, int]) -> Seconds:
    """Deal one row band and some column bands, fill and compare them, and divide by their numbers.

    The quickest of a few trials counts: the others were disturbed. A trial with a mask that does not suit its
    vector, which happens once in 2^16 slots, is left out.
    """
    trials: list[Seconds] = []
    started = time.perf_counter()
    while not trials or time.perf_counter() - started < _TRIAL_SECONDS:
        with suppress(Unsent):
            trials.append(_trial(terms, plan, slots))
    return Seconds(*(min(getattr(trial, one.name) for trial in trials) for one in fields(Seconds)))


def _trial(terms: Terms, plan: GalleryPlan, slots: tuple[int, int]) -> Seconds:
    headers = _trial_headers(terms, plan, slots)
    (rows, columns), (_, bands) = headers[0].capacity, headers[0].bands.counts
    mac_key = random_mac_key() if terms.security == "malicious" else None
    dealing = GalleryDealing(terms, headers, BandKeys.fresh(headers[0].bands.counts).of, mac_key)
    started = time.perf_counter()
    dealt = [[corrections for _, corrections in dealing.slots(owner)] for owner in (0, 1)]
    slots_dealt = time.perf_counter()
    tiles = [tiles for _, _, tiles in dealing.tiles()]
    all_dealt = time.perf_counter()
    couple = Couple(terms, None if mac_key is None else mac_key.shares)
    sides = []
    filling = 0.0
    for owner, count in enumerate((rows, columns)):
        first, second = (
            dealing.slot_stream(party, owner, range(count), np.stack([both[party] for both in dealt[owner]]))
            for party in (0, 1)
        )
        vectors = _vectors(terms, count)
        before = time.perf_counter()
        sides.append(couple.fill(owner, vectors, (first, second))[0])
        filling += time.perf_counter() - before
    first, second = (
        dealing.pair_stream(party, 0, range(bands), np.concatenate([both[party] for both in tiles], axis=1))
        for party in (0, 1)
    )
    before = time.perf_counter()
    couple.compare(sides[0], sides[1], (first, second))
    comparing = time.perf_counter() - before
    descriptors, pairs = rows + columns, rows * columns
    return Seconds(
        (slots_dealt - started) / descriptors,
        (all_dealt - slots_dealt) / pairs,
        filling / 2 / descriptors,
        comparing / 2 / pairs,
    )


def _trial_headers(
    terms: Terms, plan: GalleryPlan, slots: tuple[int, int]
) -> tuple[GalleryHeader, GalleryHeader]:
    about: dict[str, Any] = {"mission": secrets.token_hex(16), "tape": secrets.token_hex(16)}
    whole = gallery_headers(plan, terms, ("a", "b"), slots, description={}, **about)
    rows, columns = whole[0].bands.sizes
    tile = rows * columns * max(1, *plan.pair.correction_bytes)
    bands = max(1, min(_TRIAL_BANDS, _TRIAL_BYTES // tile))
    size = rows, min(slots[1], bands * columns)
    return gallery_headers(plan, terms, ("a", "b"), size, description={}, **about)


def _vectors(terms: Terms, count: int) -> IntArray:
    """Vectors of the largest norm."""
    vectors = np.random.default_rng(count).standard_normal((count, terms.dim))
    for section, cut in zip(terms.sections, cuts(terms.sections), strict=True):
        norms = np.linalg.norm(vectors[:, cut], axis=1, keepdims=True)
        vectors[:, cut] *= section.max_norm * (1 - 2.0**-30) / norms
    return encode_sections(terms.sections, vectors)
