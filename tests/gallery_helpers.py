import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tape_helpers

from spdz.gallery import GalleryHeader, GalleryTape, GalleryWriter

ALPHA = bytes(range(200, 216))

HEADER = GalleryHeader(
    mission="0a1b",
    tape="beef",
    agents=("alice", "bob"),
    party=0,
    security="malicious",
    fingerprint="c0ffee",
    program={"score": "S10", "reveal": "bit", "dim": 8, "tile": [1, 1], "max_norm": 1.5},
    slots=(17, 5),
    band=16,
    slot_pad=(48, 40),
    slot_correction=(33, 0),
    pair_pad=7,
    pair_correction=29,
)


def band_keys(header: GalleryHeader) -> tuple[list[bytes], list[bytes]]:
    rows, columns = header.bands.counts
    keys = [hashlib.sha256(f"{header.party} {number}".encode()).digest() for number in range(rows + columns)]
    return keys[:rows], keys[rows:]


def slot_correction(header: GalleryHeader, owner: int, index: int) -> bytes:
    return np.random.default_rng([owner, index, header.party]).bytes(header.slot_correction[owner])


def tile_correction(header: GalleryHeader, row: int, column: int) -> np.ndarray:
    rng = np.random.default_rng([2, row, column, header.party])
    return rng.integers(0, 256, (*header.bands.sizes, header.pair_correction), np.uint8)


def slots(header: GalleryHeader) -> list[tuple[int, int]]:
    return [(owner, index) for owner in (0, 1) for index in range(header.capacity[owner])]


def tiles(header: GalleryHeader) -> list[tuple[int, int]]:
    rows, columns = header.bands.counts
    return [(row, column) for row in range(rows) for column in range(columns)]


def write(writer: GalleryWriter, header: GalleryHeader, *, seed: int | None = None) -> None:
    """All records, in a random order if there is a seed."""
    records = [("slot", *slot) for slot in slots(header)] + [("tile", *tile) for tile in tiles(header)]
    if seed is not None:
        np.random.default_rng(seed).shuffle(records)
    for kind, first, second in records:
        first, second = int(first), int(second)
        if kind == "slot":
            writer.write_slot(first, second, slot_correction(header, first, second))
        else:
            writer.write_tile(first, second, tile_correction(header, first, second))


def deal(path: Path, *, seed: int | None = None, **changes: object) -> Path:
    header = replace(HEADER, **changes)  # type: ignore[arg-type]
    with GalleryWriter(path, header, *band_keys(header), ALPHA) as writer:
        write(writer, header, seed=seed)
    assert writer.bytes_written == path.stat().st_size
    return path


def check_all(tape: GalleryTape) -> None:
    """Read every record and hold its correction against what was dealt."""
    header = tape.header
    assert tape.alpha == ALPHA
    for owner, index in slots(header):
        assert tape.slot(owner, index).correction == slot_correction(header, owner, index)
    for row, column in tiles(header):
        assert np.array_equal(tape.tile(row, column).correction, tile_correction(header, row, column))


def skip_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    tape_helpers.skip_sync(monkeypatch)
    monkeypatch.setattr("spdz.gallery.table.sync", lambda descriptor: None)
