"""Damage of a gallery's tape is found wherever it is."""

import os
from dataclasses import replace

import numpy as np
import pytest
from gallery_helpers import (
    HEADER,
    check_all,
    deal,
    skip_sync,
    slot_correction,
)

from spdz.foundations.errors import TapeDamaged
from spdz.gallery import GalleryTape, gallery_bytes, keys
from spdz.gallery.format import TAG
from spdz.tape.envelope import SECTOR

REMEDY = "If this tape was never used, copy it again from where it was dealt; otherwise deal anew"
KEYS = 3 * SECTOR
SLOTS = KEYS + 3 * SECTOR
COLUMN_SLOTS = SLOTS + 18 * (33 + 16)
TILES = COLUMN_SLOTS + 5 * 16
TILE = 9 * 5 * 29 + 16


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


def flip(path, offset):
    with path.open("r+b") as file:
        file.seek(offset)
        byte = file.read(1)[0]
        file.seek(offset)
        file.write(bytes([byte ^ 0x10]))


@pytest.mark.parametrize(
    ("offset", "says", "use"),
    [
        (30, "checksum of the header", None),
        (SECTOR + 60, "state at byte 4096", None),
        (KEYS + 5, f"key of row band 0 at byte {KEYS} ", lambda tape: tape.tile(0, 0)),
        (KEYS + 40, f"key of row band 0 at byte {KEYS} ", lambda tape: tape.slot(0, 8)),
        (
            KEYS + 2 * SECTOR,
            f"key of column band 0 at byte {KEYS + 2 * SECTOR} ",
            lambda tape: tape.slot(1, 0),
        ),
        (SLOTS + 49, f"slot 1 of party 0 at byte {SLOTS + 49} ", lambda tape: tape.slot(0, 1)),
        (SLOTS + 97, f"slot 1 of party 0 at byte {SLOTS + 49} ", lambda tape: tape.slot(0, 1)),
        (COLUMN_SLOTS, f"slot 0 of party 1 at byte {COLUMN_SLOTS} ", lambda tape: tape.slot(1, 0)),
        (TILES, rf"tile \(0, 0\) at byte {TILES} ", lambda tape: tape.tile(0, 0)),
        (TILES + 2 * TILE - 1, rf"tile \(1, 0\) at byte {TILES + TILE} ", lambda tape: tape.tile(1, 0)),
    ],
)
def test_damage_is_found_and_named_with_its_place_and_the_remedy(path, state, offset, says, use):
    assert path.stat().st_size == TILES + 2 * TILE == gallery_bytes(HEADER)
    flip(path, offset)
    with pytest.raises(TapeDamaged, match=rf"bob\.tape: .*{says}") as caught:
        with GalleryTape.open(path, state_dir=state) as tape:
            assert use is not None
            use(tape)
    assert REMEDY in str(caught.value)
    flip(path, offset)
    with GalleryTape.open(path, state_dir=state) as tape:
        check_all(tape)


def test_flipped_bit_anywhere_is_refused_or_changes_nothing(path, tmp_path):
    dense = [*range(0, 600, 7), *range(SECTOR, SECTOR + 100), *range(KEYS, KEYS + 60)]
    rng = np.random.default_rng(2)
    refused = 0
    for number, offset in enumerate(dense + rng.integers(SLOTS, TILES + 2 * TILE, 200).tolist()):
        flip(path, offset)
        try:
            with GalleryTape.open(path, state_dir=tmp_path / str(number)) as tape:
                check_all(tape)
        except TapeDamaged:
            refused += 1
        flip(path, offset)
    assert refused > 380


def test_damage_of_one_place_leaves_the_others(path, state):
    for offset in (KEYS + SECTOR, SLOTS, TILES):
        flip(path, offset)
    with GalleryTape.open(path, state_dir=state) as tape:
        assert tape.slot(0, 1).correction == slot_correction(HEADER, 0, 1)
        assert tape.slot(1, 1).correction == slot_correction(HEADER, 1, 1)
        tape.erase(rows=[1])


def test_truncated_or_grown_file_is_refused(path, state):
    whole = path.read_bytes()
    for size in [0, 3, 15, 16, 100, SECTOR, KEYS, SLOTS, TILES, len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(TapeDamaged, match=r"bob\.tape"):
            GalleryTape.open(path, state_dir=state)
    path.write_bytes(whole + b"\0")
    with pytest.raises(TapeDamaged, match="bytes long instead of"):
        GalleryTape.open(path, state_dir=state)


def test_file_that_shrinks_while_open_is_refused(path, state):
    with GalleryTape.open(path, state_dir=state) as tape:
        os.truncate(path, TILES + TILE + 5)
        with pytest.raises(TapeDamaged, match=rf"ends before tile \(1, 0\), which is at byte {TILES + TILE}"):
            tape.tile(1, 0)
        tape.tile(0, 0)


def swap(path, first, second, size):
    data = bytearray(path.read_bytes())
    one, two = data[first : first + size], data[second : second + size]
    data[first : first + size], data[second : second + size] = two, one
    path.write_bytes(data)


def test_records_and_keys_that_changed_places_are_noticed(path, state):
    swap(path, SLOTS, SLOTS + 9 * 49, 49)  # the same place in another band
    swap(path, SLOTS + 49, SLOTS + 98, 49)
    swap(path, COLUMN_SLOTS, COLUMN_SLOTS + 16, 16)  # nothing but seals
    swap(path, TILES, TILES + TILE, TILE)
    with GalleryTape.open(path, state_dir=state) as tape:
        for slot in ((0, 0), (0, 1), (0, 2), (0, 9), (1, 0), (1, 1)):
            with pytest.raises(TapeDamaged, match=f"slot {slot[1]} of party {slot[0]} .* of another place"):
                tape.slot(*slot)
        for row in (0, 1):
            with pytest.raises(TapeDamaged, match="of another place"):
                tape.tile(row, 0)
        assert tape.slot(0, 3).correction == slot_correction(HEADER, 0, 3)
    swap(path, KEYS, KEYS + SECTOR, SECTOR)
    with GalleryTape.open(path, state_dir=state) as tape:
        with pytest.raises(TapeDamaged, match="key of row band 0"):
            tape.slot(0, 3)


def test_places_are_sealed_even_where_keys_are_alike(path, state, tmp_path):
    """Two tapes that a dealer wrongly gave the same keys: a record of the other still does not fit."""
    other = deal(tmp_path / "other.tape", tape="dead").read_bytes()
    data = bytearray(path.read_bytes())
    data[TILES:] = other[TILES:]
    data[SLOTS : SLOTS + 49] = other[SLOTS : SLOTS + 49]
    path.write_bytes(data)
    with GalleryTape.open(path, state_dir=state) as tape:
        for use in (lambda: tape.tile(0, 0), lambda: tape.slot(0, 0)):
            with pytest.raises(TapeDamaged, match="another place or tape"):
                use()


def test_a_seal_fits_one_kind_place_and_tape():
    places = [keys.slot_place(b"x" * 16, owner, index) for owner in (0, 1) for index in (0, 1)]
    places += [keys.tile_place(b"x" * 16, row, column) for row in (0, 1) for column in (0, 1)]
    places += [keys.slot_place(b"y" * 16, 0, 0), keys.tile_place(b"y" * 16, 0, 0)]
    key = bytes(range(32))
    for place in places:
        record = keys.seal(key, b"correction", place)
        assert len(record) == 10 + TAG
        assert [other for other in places if keys.unseal(key, record, other) == b"correction"] == [place]
    assert len({keys.seal(key, b"", place) for place in places}) == len(places)


@pytest.mark.parametrize(("start", "says"), [(SECTOR, "state at byte"), (KEYS, "key of row band 0")])
def test_state_and_keys_of_another_tape_are_refused(path, state, tmp_path, start, says):
    other = deal(tmp_path / "other.tape", tape="dead").read_bytes()
    data = bytearray(path.read_bytes())
    data[start : start + 2 * SECTOR] = other[start : start + 2 * SECTOR]
    path.write_bytes(data)
    with pytest.raises(TapeDamaged, match=says), GalleryTape.open(path, state_dir=state) as tape:
        tape.slot(0, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"party": 2},
        {"tape": "../x"},
        {"slots": (0, 1)},
        {"slots": (1, (1 << 16) + 1)},
        {"slots": (1, 2, 3)},
        {"slots": 5},
        {"slots": (1, True)},
        {"slot_pad": (1, -1)},
        {"slot_correction": (1.0, 1)},
        {"slot_correction": ((1 << 30) + 1, 1)},
        {"pair_pad": -1},
        {"pair_correction": (1 << 22) + 1},
        {"pair_correction": None},
    ],
)
def test_senseless_header_is_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(HEADER, **change)


def test_header_names_robots_and_the_dealers_command():
    assert (HEADER.name, HEADER.peer) == ("alice", "bob")
    assert HEADER.dealer_command == (
        "python -m spdz.dealer --agents alice bob --score S10 --dim 8 --max-norm 1.5 "
        "--security malicious --slots RxC --out FOLDER"
    )
