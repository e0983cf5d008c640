import os
from dataclasses import replace

import numpy as np
import pytest
from tape_helpers import ALPHA, HEADER, chains, corrections, deal, skip_sync

from spdz.arithmetic import prf
from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.tape import Tape, TapeHeader
from spdz.tape.envelope import SECTOR


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
    data = bytearray(path.read_bytes())
    data[offset] ^= 0x10
    path.write_bytes(data)


def test_damaged_correction_names_file_job_and_offset_and_consumes_nothing(path, state):
    with Tape.open(path, state_dir=state) as tape:
        offset = tape._layout.corrections + 3 * 48
        flip(path, offset + 5)
        with pytest.raises(TapeDamaged, match=rf"bob\.tape: the checksum of job 3 .* byte {offset}\."):
            tape.reserve(5)
        assert tape.cursor == 0
        assert len(tape.reserve(3)) == 3
        with pytest.raises(TapeDamaged):
            tape.reserve(1)


def test_corrections_that_changed_places_are_noticed(path, state):
    with Tape.open(path, state_dir=state) as tape:
        data = bytearray(path.read_bytes())
        a, b = tape._layout.corrections, tape._layout.checksums
        data[a : a + 48], data[a + 48 : a + 96] = data[a + 48 : a + 96], data[a : a + 48]
        data[b : b + 4], data[b + 4 : b + 8] = data[b + 4 : b + 8], data[b : b + 4]
        path.write_bytes(data)
        with pytest.raises(TapeDamaged, match="job 0"):
            tape.reserve(2)


def test_flipped_bit_anywhere_is_refused_or_changes_nothing(path, tmp_path):
    whole = path.read_bytes()
    dense = [*range(500), *range(SECTOR, SECTOR + 100), *range(2 * SECTOR, 2 * SECTOR + 100)]
    rng = np.random.default_rng(2)
    refused = 0
    for number, offset in enumerate(dense + rng.integers(3 * SECTOR, len(whole), 200).tolist()):
        path.write_bytes(whole)
        flip(path, offset)
        try:
            with Tape.open(path, state_dir=tmp_path / str(number)) as tape:
                assert (tape.alpha, tape.cursor) == (ALPHA, 0)
                taken = tape.reserve(10)
        except TapeDamaged:
            refused += 1
        else:
            assert [bytes(job.correction) for job in taken] == corrections(HEADER)
            assert [job.key for job in taken] == [prf.job_key(chain) for chain in chains(10)]
    assert refused > 500


def test_truncated_or_grown_file_is_refused(path, state):
    whole = path.read_bytes()
    for size in [0, 3, 15, 16, 100, SECTOR, 2 * SECTOR, 3 * SECTOR, len(whole) - 40, len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(TapeDamaged, match=r"bob\.tape"):
            Tape.open(path, state_dir=state)
    path.write_bytes(whole + b"\0")
    with pytest.raises(TapeDamaged, match="bytes long instead of"):
        Tape.open(path, state_dir=state)


def test_file_that_shrinks_while_open_is_refused(path, state):
    with Tape.open(path, state_dir=state) as tape:
        os.truncate(path, path.stat().st_size - 1)
        with pytest.raises(TapeDamaged, match="truncated"):
            tape.reserve(10)
        assert tape.cursor == 0


def test_other_files_and_versions_are_refused(path, state):
    whole = path.read_bytes()
    for content, message in (
        (b"PK" + whole[2:], "not a tape"),
        (whole[:8] + b"\2" + whole[9:], "tape format 2"),
        (whole[:12] + b"\xff\xff\xff\x7f" + whole[16:], "claims 2147483647 bytes"),
        (whole.replace(b'"jobs":10', b'"jobs":11'), "checksum of the header"),
    ):
        path.write_bytes(content)
        with pytest.raises(TapeDamaged, match=message):
            Tape.open(path, state_dir=state)


def test_state_of_another_tape_is_refused(path, state, tmp_path):
    other = deal(tmp_path / "other.tape", tape="dead").read_bytes()
    path.write_bytes(
        path.read_bytes()[:SECTOR] + other[SECTOR : 3 * SECTOR] + path.read_bytes()[3 * SECTOR :]
    )
    with pytest.raises(TapeDamaged, match="state at byte 4096"):
        Tape.open(path, state_dir=state)


def test_missing_tape_and_folder_are_tape_errors(tmp_path, state):
    for name, says in (("missing.tape", "no such file"), (".", "is a folder")):
        with pytest.raises(TapeError, match=says):
            Tape.open(tmp_path / name, state_dir=state)


@pytest.mark.parametrize(
    "change",
    [
        {"tape": "../../x"},
        {"tape": ""},
        {"mission": "XYZ"},
        {"fingerprint": 12},
        {"party": 2},
        {"party": True},
        {"jobs": 0},
        {"jobs": 1 << 33},
        {"pad_bytes": -1},
        {"correction_bytes": 1 << 50},
        {"correction_bytes": 1.0},
        {"security": "none"},
        {"agents": ("alice", "alice")},
        {"agents": ("alice",)},
        {"agents": ("alice", "b\nob")},
        {"program": {"x": float("nan")}},
        {"program": {"x": b""}},
        {"program": [1]},
    ],
)
def test_senseless_header_is_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(HEADER, **change)


def test_program_is_kept_as_it_will_be_read_back():
    assert isinstance(HEADER, TapeHeader)
    assert replace(HEADER, program={"tile": (1, 2)}).program == {"tile": [1, 2]}
