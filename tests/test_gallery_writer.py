"""The dealer's mistakes and crashes leave no gallery's tape, and none is overwritten."""

import os
import re
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
from gallery_helpers import (
    ALPHA,
    HEADER,
    band_keys,
    check_all,
    deal,
    skip_sync,
    slot_correction,
    tile_correction,
    write,
)

from spdz.gallery import GalleryTape, GalleryWriter


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


def test_dealt_tape_is_never_overwritten(tmp_path):
    path = deal(tmp_path / "mission" / "bob.tape")
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="never overwritten"):
        deal(path)
    assert path.read_bytes() == before
    meanwhile = tmp_path / "t.tape"
    with (
        pytest.raises(FileExistsError),
        GalleryWriter(meanwhile, HEADER, *band_keys(HEADER), ALPHA) as writer,
    ):
        write(writer, HEADER)
        meanwhile.write_bytes(b"somebody else's")
    assert meanwhile.read_bytes() == b"somebody else's"
    assert sorted(tmp_path.iterdir()) == [path.parent, meanwhile]


@pytest.mark.parametrize(
    ("says", "act"),
    [
        ("a slot of party 0 takes 33 bytes, not 32", lambda w: w.write_slot(0, 0, bytes(32))),
        ("a slot of party 1 takes 0 bytes, not 33", lambda w: w.write_slot(1, 0, bytes(33))),
        ("party 0 has slots 0 to 17, not 18", lambda w: w.write_slot(0, 18, bytes(33))),
        ("party 0 or 1, not 2", lambda w: w.write_slot(2, 0, b"")),
        ("row bands 0 to 1, not 2", lambda w: w.write_tile(2, 0, tile_correction(HEADER, 0, 0))),
        ("column bands 0 to 0, not -1", lambda w: w.write_tile(0, -1, tile_correction(HEADER, 0, 0))),
        (
            "takes uint8 of shape (9, 5, 29), not",
            lambda w: w.write_tile(0, 0, np.zeros((5, 9, 29), np.uint8)),
        ),
        ("not uint64 of", lambda w: w.write_tile(0, 0, np.zeros((9, 5, 29), np.uint64))),
        ("1 slots and 0 tiles were not written", lambda w: write_but(w, "slot")),
        ("0 slots and 1 tiles were not written", lambda w: write_but(w, "tile")),
        ("slot 3 of party 0 is written already", lambda w: [w.write_slot(0, 3, bytes(33)) for _ in "12"]),
        (
            "tile (1, 0) is written already",
            lambda w: [w.write_tile(1, 0, tile_correction(HEADER, 1, 0)) for _ in "12"],
        ),
    ],
)
def test_mistakes_of_the_dealer_leave_no_file(tmp_path, says, act):
    with pytest.raises(ValueError, match=re.escape(says)):
        with GalleryWriter(tmp_path / "t.tape", HEADER, *band_keys(HEADER), ALPHA) as writer:
            act(writer)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="closed"):
        writer.write_slot(0, 0, bytes(33))


def write_but(writer, kind):
    """All records but the last slot or the last tile."""
    for owner, capacity in enumerate(HEADER.capacity):
        for index in range(capacity - (kind == "slot" and owner == 1)):
            writer.write_slot(owner, index, slot_correction(HEADER, owner, index))
    for row in range(2 - (kind == "tile")):
        writer.write_tile(row, 0, tile_correction(HEADER, row, 0))


def test_secrets_of_wrong_number_or_length_are_refused(tmp_path):
    rows, columns = band_keys(HEADER)
    for wrong, says in (
        ((rows[:1], columns, ALPHA), "(2, 1) keys are needed for rows and columns, not (1, 1)"),
        ((rows, columns * 2, ALPHA), "(2, 1) keys are needed"),
        (([rows[0], rows[1][1:]], columns, ALPHA), "takes 32 bytes and alpha 16"),
        ((rows, columns, ALPHA[1:]), "takes 32 bytes and alpha 16"),
        ((rows, rows[:1], ALPHA), "two of these are alike"),
    ):
        with pytest.raises(ValueError, match=re.escape(says)):
            GalleryWriter(tmp_path / "t.tape", HEADER, *wrong)
    with pytest.raises(ValueError, match="at most 65536"):
        GalleryWriter(tmp_path / "t.tape", replace(HEADER, program={"x": "y" * 70000}), rows, columns, ALPHA)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_no_file(tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    for broken in ("os.pwrite", "os.link"):
        with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
            patch.setattr(broken, full)
            patch.setattr("pathlib.Path.rename", full)
            deal(tmp_path / "t.tape")
        assert list(tmp_path.iterdir()) == []


def test_a_killed_dealer_leaves_no_file_of_that_name(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # forking beside BLAS threads, from Python 3.12
        child = os.fork()
    if child == 0:
        write(GalleryWriter(tmp_path / "t.tape", HEADER, *band_keys(HEADER), ALPHA), HEADER)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert not (tmp_path / "t.tape").exists()
    deal(tmp_path / "t.tape")
    with GalleryTape.open(
        shutil.move(tmp_path / "t.tape", tmp_path / "moved.tape"), state_dir=tmp_path
    ) as tape:
        check_all(tape)
