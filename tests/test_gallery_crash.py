"""Crashes of the machine at every step of erasing bands and of destroying a gallery's tape."""

import itertools
import os
import shutil

import pytest
from crash_helpers import FATES, Crash, Disk
from gallery_helpers import ALPHA, HEADER, band_keys, check_all, deal, skip_sync, slot_correction

from spdz.foundations.errors import TapeDestroyed, TapeExhausted
from spdz.gallery import GalleryTape


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


def crash(monkeypatch, folder, stop_at, fate, act):
    """Whether the machine stopped while ``act`` was done to the tape."""
    with monkeypatch.context() as patch:
        tape = GalleryTape.open(folder / "bob.tape", state_dir=folder / "state")
        Disk(patch, folder, stop_at, fate)
        for module in ("tape.durable", "tape.state", "gallery.table"):
            patch.setattr(f"spdz.{module}.sync", os.fsync)
        try:
            act(tape)
        except Crash:
            return True
        finally:
            tape.close()
    return False


@pytest.mark.parametrize("fate", FATES)
def test_a_crash_while_erasing_touches_no_other_band_and_erasing_again_finishes_it(
    tmp_path, monkeypatch, fate
):
    dealt = deal(tmp_path / "dealt.tape")
    key = band_keys(HEADER)[0][0]
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        folder.mkdir()
        path = shutil.copy(dealt, folder / "bob.tape")
        crashed = crash(monkeypatch, folder, stop_at, fate, lambda tape: tape.erase(rows=[0]))
        with GalleryTape.open(path, state_dir=folder / "state") as tape:
            assert tape.slot(0, 9).correction == slot_correction(HEADER, 0, 9)
            tape.tile(1, 0)
            if not crashed:
                with pytest.raises(TapeExhausted):
                    tape.tile(0, 0)
            tape.erase(rows=[0])
            with pytest.raises(TapeExhausted):
                tape.tile(0, 0)
        assert key not in path.read_bytes()
        if not crashed:
            break
    assert stop_at == 3  # a write and a sync


@pytest.mark.parametrize("fate", FATES)
def test_a_crash_while_destroying_leaves_a_whole_tape_or_none(tmp_path, monkeypatch, fate):
    dealt = deal(tmp_path / "dealt.tape")
    secrets = (ALPHA, *band_keys(HEADER)[0], *band_keys(HEADER)[1])
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        folder.mkdir()
        path = shutil.copy(dealt, folder / "bob.tape")
        crashed = crash(monkeypatch, folder, stop_at, fate, lambda tape: tape.destroy())
        try:
            with GalleryTape.open(path, state_dir=folder / "state") as tape:
                assert crashed
                check_all(tape)
        except TapeDestroyed:
            assert not any(secret in path.read_bytes() for secret in secrets)
        if not crashed:
            break
    assert stop_at > 8


def test_zeros_that_a_killed_process_left_unsynced_are_synced_before_they_count(tmp_path, monkeypatch):
    path, state = deal(tmp_path / "bob.tape"), tmp_path / "state"
    with GalleryTape.open(path, state_dir=state) as tape:
        tape.erase(rows=[0])
    synced = []
    monkeypatch.setattr("spdz.gallery.table.sync", synced.append)
    GalleryTape.open(path, state_dir=state).close()
    assert len(synced) == 1
