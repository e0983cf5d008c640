"""Galleries to measure: what they compute, dealing them on one core, and descriptors to fill them with."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.parties import Note, pin, run_processes
from dealer.gallery import deal_gallery
from dealer.pki import MissionAuthority, write_credentials
from protocols.catalog import GalleryPurpose
from spdz.arithmetic.fixed_point import FRACTION_BITS
from spdz.console.progress import Report
from spdz.foundations.types import FloatArray, Security
from spdz.gallery.format import TAG, read_gallery_header
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import measure_gallery
from spdz.session.admission import quantised
from spdz.session.connect import open_gallery
from spdz.session.gallery import GallerySession
from spdz.session.strips import Block

AGENTS = ("zero", "one")
_FRACTION = 2 * FRACTION_BITS
"""Fractional bits of an inner product."""

SPARE = 1
"""Slots of either side beyond what is filled: one in 2^16 is burnt."""

TIMEOUT = 300.0
"""Seconds that a round may take on a busy machine."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What is measured.

    Attributes:
        purpose: What the galleries are for.
        threshold: Of the decisions.
        security: The security model.
        seed: Of the descriptors.
    """

    purpose: GalleryPurpose
    threshold: float
    security: Security
    seed: int

    @property
    def terms(self) -> Terms:
        """What slots and pairs are read with."""
        return self.purpose.terms(self.threshold, self.security)


@dataclass(frozen=True, slots=True)
class Dealing:
    """Galleries to deal, one in each folder, all alike: for so many descriptors, and a spare slot."""

    folders: tuple[Path, ...]
    asked: Asked
    counts: tuple[int, int]

    @property
    def slots(self) -> tuple[int, int]:
        """Slots to deal."""
        return self.counts[0] + SPARE, self.counts[1] + SPARE


def deal(dealing: Dealing, report: Report) -> list[float]:
    """Deal in a process of its own, pinned to one core, and return the pairs a second of each gallery."""
    folders = dealing.folders
    for folder in folders:
        authority = MissionAuthority()
        for agent in AGENTS:
            folder.mkdir(parents=True, exist_ok=True)
            write_credentials(folder / agent, authority.credentials(agent))
    (rates,) = run_processes(_deal, dealing, 1, lambda _, done: report(*done))
    return list(rates)


def _deal(index: int, dealing: Dealing, pipe: Any) -> None:
    pin(index)
    rates: list[float] = []
    for folder in dealing.folders:
        pairs = 0

        def progress(done: int, total: int) -> None:
            nonlocal pairs
            pairs = done
            pipe.send(Note((len(rates) * total + done, len(dealing.folders) * total)))

        started = time.perf_counter()
        paths = tape_path(folder, 0), tape_path(folder, 1)
        deal_gallery(paths, AGENTS, dealing.asked.terms, dealing.slots, progress=progress)
        rates.append(pairs / (time.perf_counter() - started))
    pipe.send(rates)


def tape_path(folder: Path, party: int) -> Path:
    """Where a party's gallery lies."""
    return folder / AGENTS[party] / f"{AGENTS[1 - party]}.gallery"


def open_side(folder: Path, party: int, asked: Asked, port: int) -> GallerySession:
    """One party of a gallery, connected over TLS on loopback: party 0 listens."""
    address = f"127.0.0.1:{port}"
    return open_gallery(
        tape_path(folder, party),
        asked.terms,
        listen=address if party == 0 else None,
        connect=address if party == 1 else None,
        timeout=TIMEOUT,
        state_dir=folder / AGENTS[party],
    )


@dataclass(frozen=True, slots=True)
class Stored:
    """What the larger tape of a gallery stores, seals included.

    Attributes:
        pair: Bytes a pair, from the file's size.
        slot: Bytes a descriptor, the larger of the two owners'.
        unproved: The same without the proof of its norm.
    """

    pair: float
    slot: int
    unproved: int


def stored(folder: Path, asked: Asked) -> Stored:
    """What a gallery's tapes store."""
    headers, pair = [], 0.0
    for party in (0, 1):
        path = tape_path(folder, party)
        with path.open("rb", buffering=0) as file:
            header, layout = read_gallery_header(file.fileno(), path)
        headers.append(header)
        pairs = header.capacity[0] * header.capacity[1]
        pair = max(pair, (path.stat().st_size - layout.tiles) / pairs)
    bare = measure_gallery(replace(asked.terms, proof=False))
    return Stored(
        round(pair, 2),
        max(max(header.slot_correction) for header in headers) + TAG,
        max(max(plan.correction_bytes) for plan in bare.slots) + TAG,
    )


def places(counts: tuple[int, int], asked: Asked) -> tuple[FloatArray, FloatArray]:
    """Unit vectors of both parties; every other one of party 1 has a cosine about the threshold."""
    dim, threshold = asked.purpose.dim, asked.threshold
    generator = np.random.default_rng(asked.seed)
    x, y = (unit(generator.standard_normal((count, dim))) for count in counts)
    near = np.arange(0, counts[1], 2)
    cosine = np.clip(generator.uniform(threshold - 0.1, threshold + 0.1, len(near)), -1, 1)[:, None]
    of = x[near % counts[0]]
    across = unit(y[near] - (y[near] * of).sum(axis=1, keepdims=True) * of)
    y[near] = unit(cosine * of + np.sqrt(1 - cosine**2) * across)
    return x, y


def unit(rows: FloatArray) -> FloatArray:
    """Rows of L2 norm 1; a row of zeros stays."""
    norms = np.linalg.norm(rows, axis=-1, keepdims=True)
    scaled: FloatArray = rows / np.where(norms == 0, 1, norms)
    return scaled


def decided(blocks: Sequence[Block], own: Sequence[int], peer: Sequence[int]) -> npt.NDArray[np.bool_]:
    """The decisions of some own slots with some of the peer's."""
    table = np.zeros((max(own) + 1, max(peer) + 1), dtype=np.bool_)
    for block in blocks:
        table[block.own.start : block.own.stop, block.peer.start : block.peer.stop] = block.results
    return table[np.ix_(own, peer)]


def differing(asked: Asked, decisions: Any, x: FloatArray, y: FloatArray) -> int:
    """Decisions unlike those of the quantised descriptors in the clear, outside the resolution."""
    raw_x, raw_y = (quantised(asked.terms, rows).astype(np.float64) for rows in (x, y))
    # Exact: |x . y| of quantised unit vectors is below 2^33. z >= threshold is z >= its ceiling.
    margin = raw_x @ raw_y.T - math.ceil(Fraction(asked.threshold) * (1 << _FRACTION))
    wrong = np.asarray(decisions, dtype=np.bool_) != (margin >= 0)
    resolution = asked.purpose.resolution
    if resolution is not None and resolution < _FRACTION:
        wrong &= np.abs(margin) > 1 << (_FRACTION - resolution - 1)
    return int(np.count_nonzero(wrong))
