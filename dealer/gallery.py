"""Deal one pair's gallery: a record for every slot of either party and for every pair of slots.

Slots are dealt first, all of them: their masks, and what the program prepares of them, are read again for
every tile. Then the tiles, a row band at a time. Nothing but these masks is kept in memory.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dealer.outlets import RecordOutlet
from dealer.randomness import MacKey, random_mac_key
from dealer.recipe import DealtJob
from spdz.foundations.types import IntArray, Json
from spdz.gallery import keys
from spdz.gallery.format import BAND, GalleryHeader
from spdz.gallery.writer import GalleryWriter
from spdz.readings.gallery import Derived, Filled, Terms, compare, fill
from spdz.readings.gallery_plan import GalleryPlan, measure_gallery
from spdz.readings.records import Octets, TilePart, pair_stream, slot_stream
from spdz.readings.streams import RecordStream
from spdz.rounds.coroutine import run_silently
from spdz.values.engine import Input
from spdz.values.input_mask import field_offsets
from spdz.values.value import Value, concatenate

_DELTA = 16
SLOTS_TOGETHER = 64
"""Slots dealt at a time."""
TILES_BYTES = 8 << 20
"""Stored bytes of tiles dealt at a time, and the most that a tile should have."""


@dataclass(frozen=True, slots=True)
class BandKeys:
    """Both parties' band keys: ``of[party][owner][band]``."""

    of: tuple[tuple[list[bytes], list[bytes]], tuple[list[bytes], list[bytes]]] = field(repr=False)

    @classmethod
    def fresh(cls, counts: tuple[int, int]) -> BandKeys:
        """Random keys for so many row and column bands."""
        first, second = (
            (
                [secrets.token_bytes(keys.KEY_BYTES) for _ in range(counts[0])],
                [secrets.token_bytes(keys.KEY_BYTES) for _ in range(counts[1])],
            )
            for _ in (0, 1)
        )
        return cls((first, second))


def gallery_headers(
    plan: GalleryPlan,
    terms: Terms,
    agents: tuple[str, str],
    slots: tuple[int, int],
    *,
    mission: str,
    tape: str,
    description: Mapping[str, Json],
) -> tuple[GalleryHeader, GalleryHeader]:
    """Both parties' headers."""
    pair = max(plan.pair.correction_bytes)
    band = next((size for size in (16, 8, 4, 2) if size * size * pair <= TILES_BYTES), 1)
    first, second = (
        GalleryHeader(
            mission=mission,
            tape=tape,
            agents=agents,
            party=party,
            security=terms.security,
            fingerprint=plan.recipe,
            program=dict(description),
            slots=slots,
            band=min(band, BAND),
            slot_pad=(_DELTA + plan.slots[0].pad_bytes[party], _DELTA + plan.slots[1].pad_bytes[party]),
            slot_correction=(plan.slots[0].correction_bytes[party], plan.slots[1].correction_bytes[party]),
            pair_pad=plan.pair.pad_bytes[party],
            pair_correction=plan.pair.correction_bytes[party],
        )
        for party in (0, 1)
    )
    return first, second


def deal_gallery(
    paths: tuple[Path, Path],
    agents: tuple[str, str],
    terms: Terms,
    slots: tuple[int, int],
    *,
    mission: str | None = None,
    description: Mapping[str, Json] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Deal a gallery and write both parties' tapes.

    Args:
        paths: Where party 0's and party 1's tape go.
        agents: Their names.
        terms: What the gallery is for.
        slots: Slots for vectors of party 0 and of party 1, rounded up to whole bands.
        mission: Hex id of the dealing run; a fresh one if not given.
        description: What the headers say of the program.
        progress: Called with pairs dealt and pairs in all.

    Raises:
        ValueError: if the program cannot be dealt for a gallery.
        OSError: if a tape cannot be written.
    """
    plan = measure_gallery(terms)
    mission, tape = mission or secrets.token_hex(16), secrets.token_hex(16)
    headers = gallery_headers(
        plan, terms, agents, slots, mission=mission, tape=tape, description=description or {}
    )
    mac_key = random_mac_key() if terms.security == "malicious" else None
    bands = BandKeys.fresh(headers[0].bands.counts)
    with ExitStack() as stack:
        writers = []
        for party in (0, 1):
            alpha = bytes(16) if mac_key is None else mac_key.shares[party].to_bytes(16, "little")
            writer = GalleryWriter(paths[party], headers[party], *bands.of[party], alpha)
            writers.append(stack.enter_context(writer))
        dealing = GalleryDealing(terms, headers, bands.of, mac_key)
        for owner in (0, 1):
            for index, corrections in dealing.slots(owner):
                for writer, correction in zip(writers, corrections, strict=True):
                    writer.write_slot(owner, index, correction)
        done, total = 0, headers[0].capacity[0] * headers[0].capacity[1]
        for row_band, column_band, tiles in dealing.tiles():
            for writer, correction in zip(writers, tiles, strict=True):
                writer.write_tile(row_band, column_band, correction)
            done += tiles[0].shape[0] * tiles[0].shape[1]
            progress(done, total)


class GalleryDealing:
    """One gallery being dealt: first the slots of both parties, then the tiles.

    Args:
        terms: What it is for.
        headers: Both parties'.
        bands: Both parties' band keys, ``bands[party][owner][band]``.
        mac_key: The MAC key, or None in semi-honest mode.
    """

    def __init__(
        self,
        terms: Terms,
        headers: tuple[GalleryHeader, GalleryHeader],
        bands: Any,
        mac_key: MacKey | None,
    ) -> None:
        self._terms, self._headers, self._bands, self._mac_key = terms, headers, bands, mac_key
        self._offsets: list[IntArray] = []
        self._derived: list[list[Value]] = []

    def slots(self, owner: int) -> Iterator[tuple[int, tuple[Any, Any]]]:
        """Deal all slots of one party: their numbers and both parties' corrections."""
        count = self._headers[0].capacity[owner]
        offsets, derived = [], []
        for start in range(0, count, SLOTS_TOGETHER):
            numbers = range(start, min(start + SLOTS_TOGETHER, count))
            streams = (self.slot_stream(0, owner, numbers), self.slot_stream(1, owner, numbers))
            job, outlet = self._job(streams)
            shape = (len(numbers), self._terms.dim)
            masked = job.input_mask(Input(owner, shape, self._terms.norm))
            prepared, _ = run_silently(fill(job, self._terms, masked))
            offsets.append(field_offsets(masked.parts[0]))
            derived.append(prepared)
            yield from zip(numbers, zip(*outlet.corrections, strict=True), strict=True)
        self._offsets.append(np.concatenate(offsets))
        self._derived.append(
            [concatenate(*(one.value for one in column)) for column in zip(*derived, strict=True)]
        )

    def tiles(self) -> Iterator[tuple[int, int, tuple[Any, Any]]]:
        """Deal all tiles: row band, column band and both parties' corrections."""
        sizes, counts = self._headers[0].bands
        bytes_each = sizes[0] * sizes[1] * max(header.pair_correction for header in self._headers)
        group = max(1, TILES_BYTES // max(1, bytes_each))
        for row_band in range(counts[0]):
            for start in range(0, counts[1], group):
                columns = range(start, min(start + group, counts[1]))
                outlet = self._deal_tiles(row_band, columns)
                for at, column_band in enumerate(columns):
                    cut = slice(at * sizes[0] * sizes[1], (at + 1) * sizes[0] * sizes[1])
                    first, second = (rows[cut].reshape(*sizes, -1) for rows in outlet.corrections)
                    yield row_band, column_band, (first, second)

    def _deal_tiles(self, row_band: int, column_bands: range) -> RecordOutlet:
        sizes, _ = self._headers[0].bands
        rows = slice(row_band * sizes[0], (row_band + 1) * sizes[0])
        columns = slice(column_bands.start * sizes[1], column_bands.stop * sizes[1])
        streams = (self.pair_stream(0, row_band, column_bands), self.pair_stream(1, row_band, column_bands))
        job, outlet = self._job(streams)
        sides = (self._filled(job, 0, rows), self._filled(job, 1, columns))
        run_silently(compare(job, self._terms, *sides))
        return outlet

    def _job(self, streams: tuple[RecordStream, RecordStream]) -> tuple[DealtJob, RecordOutlet]:
        outlet = RecordOutlet(streams[0])
        job = DealtJob(self._terms.security, streams, self._mac_key, outlet)
        job.resolution, job.slot_bits = self._terms.resolution, self._terms.word_bits
        return job, outlet

    def _filled(self, job: DealtJob, owner: int, which: slice) -> Filled:
        offsets = self._offsets[owner][which]
        standing = replace(self._terms.standing(owner), s=offsets)
        derived = tuple(Derived(value[which]) for value in self._derived[owner])
        return Filled(
            standing, derived, len(offsets), lambda: standing.parts(malicious=job.malicious, dealt=True)
        )

    def slot_stream(
        self, party: int, owner: int, numbers: range, corrections: Octets | None = None
    ) -> RecordStream:
        """What a party draws for slots: its pads, and corrections (n, bytes) where they are dealt already."""
        header, size = self._headers[party], self._headers[party].bands.sizes[owner]
        pads = np.stack(
            [
                keys.slot_pad(
                    keys.slot_keys(self._bands[party][owner][i // size], i % size).pad, header.slot_pad[owner]
                )
                for i in numbers
            ]
        )
        deltas = np.ascontiguousarray(pads[:, :_DELTA]).view("<u8")
        if corrections is None:
            corrections = np.empty((len(numbers), 0), dtype=np.uint8)
        hash_keys = [keys.slot_hash_key(header.tape, owner, i) for i in numbers]
        return slot_stream(pads[:, _DELTA:], corrections, deltas, hash_keys)

    def pair_stream(
        self, party: int, row_band: int, column_bands: range, corrections: Octets | None = None
    ) -> RecordStream:
        """The same for all pairs of a row band and of column bands; corrections (rows, columns, bytes)."""
        header, (rows, columns) = self._headers[party], self._headers[party].bands.sizes
        if corrections is None:
            corrections = np.empty((rows, len(column_bands) * columns, 0), dtype=np.uint8)
        parts = []
        for at, band in enumerate(column_bands):
            tile = keys.tile_keys(self._bands[party][0][row_band], self._bands[party][1][band])
            delta, pad = keys.tile_pad(tile.pad, rows, columns, header.pair_pad)
            where = slice(at * columns, (at + 1) * columns)
            hash_key = keys.tile_hash_key(header.tape, row_band, band)
            parts.append(TilePart(slice(0, rows), where, pad, corrections[:, where], delta, hash_key))
        return pair_stream((rows, len(column_bands) * columns), parts)
