"""A gallery's tape: what was dealt comes back, to one process, until it is erased or destroyed."""

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import threading
import warnings
from dataclasses import replace

import numpy as np
import pytest
import tape_helpers
from gallery_helpers import (
    ALPHA,
    HEADER,
    band_keys,
    check_all,
    deal,
    skip_sync,
    slot_correction,
    tile_correction,
    tiles,
)

from spdz.arithmetic import prf
from spdz.foundations.errors import (
    TapeDamaged,
    TapeDestroyed,
    TapeError,
    TapeExhausted,
    TapeInUse,
    TapeMismatch,
)
from spdz.gallery import GalleryTape, gallery_bytes
from spdz.tape import Tape, tape_status


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


@pytest.mark.parametrize(
    ("slots", "sizes", "counts"),
    [
        ((1, 1), (1, 1), (1, 1)),
        ((1, 300), (1, 16), (1, 19)),
        ((17, 5), (9, 5), (2, 1)),
        ((16, 33), (16, 11), (1, 3)),
        ((300, 300), (16, 16), (19, 19)),
    ],
)
def test_bands_are_few_and_even_and_hold_every_slot(slots, sizes, counts):
    header = replace(HEADER, slots=slots)
    assert header.bands == (sizes, counts)
    assert header.bands.sizes == sizes and header.bands.counts == counts
    assert header.capacity == (sizes[0] * counts[0], sizes[1] * counts[1])
    assert all(capacity >= number for capacity, number in zip(header.capacity, slots, strict=True))


def test_size_of_a_large_gallery_is_exact_without_writing_it():
    header = replace(HEADER, slots=(300, 300), slot_correction=(1000, 2000), pair_correction=290)
    corrections = 304 * 3000 + 304 * 304 * 290
    overhead = 4096 * (1 + 2 + 2 * 19) + 16 * (2 * 304 + 19 * 19)
    assert gallery_bytes(header) == corrections + overhead


@pytest.mark.parametrize("slots", [(1, 1), (1, 300), (17, 5), (40, 2)])
@pytest.mark.parametrize("sizes", [{}, {"slot_correction": (0, 5), "pair_correction": 0, "pair_pad": 0}])
def test_everything_comes_back_as_dealt_in_any_order(tmp_path, state, slots, sizes):
    path = deal(tmp_path / "t.tape", seed=3, slots=slots, **sizes)
    header = replace(HEADER, slots=slots, **sizes)
    assert path.stat().st_size == gallery_bytes(header)
    assert path.read_bytes() == deal(tmp_path / "again.tape", slots=slots, **sizes).read_bytes()
    for _ in range(2):
        with GalleryTape.open(path, state_dir=state) as tape:
            assert tape.header == header
            check_all(tape)
            rows, columns = header.bands.sizes
            assert tape.tile(0, 0).pad.shape == (rows, columns, header.pair_pad)
            assert [len(tape.slot(owner, 0).pad) for owner in (0, 1)] == [48, 40]


def test_pads_are_the_streams_that_the_format_says(path, state):
    (_, row), (column,) = band_keys(HEADER)
    with GalleryTape.open(path, state_dir=state) as tape:
        tile, slot = tape.tile(1, 0), tape.slot(0, 9 + 4)
    key = hashlib.sha256(b"spdz gallery v1: pad of a tile\0" + row + column).digest()
    stream = prf.expand(key, 16 + 320).tobytes()  # 9 * 5 * 7 = 315 bytes
    assert tile.delta.dtype == np.uint64 and tile.delta.tobytes() == stream[:16]
    assert tile.pad.tobytes() == stream[16 : 16 + 315]
    key = hashlib.sha256(b"spdz gallery v1: pad of a slot\0" + row + bytes([4, 0, 0, 0])).digest()
    assert slot.pad.tobytes() == prf.expand(key, 48).tobytes()
    with pytest.raises(ValueError, match="read-only"):
        tile.correction[0, 0, 0] = 1
    assert slot.correction.readonly


def test_hash_keys_are_public_distinct_and_alike_for_both_parties(tmp_path, state):
    kept = []
    for party in (0, 1):
        path = deal(tmp_path / f"{party}.tape", party=party)
        with GalleryTape.open(path, state_dir=state) as tape:
            records = [tape.tile(row, 0) for row in (0, 1)] + [
                tape.slot(0, 0),
                tape.slot(0, 1),
                tape.slot(1, 0),
            ]
        kept.append([record.hash_key for record in records])
    assert kept[0] == kept[1]
    assert len(set(kept[0])) == 5 and {len(key) for key in kept[0]} == {16}
    where = b"spdz gallery v1: hash key of a tile\0beef\0" + bytes([1, 0, 0, 0, 0, 0, 0, 0])
    assert kept[0][1] == hashlib.sha256(where).digest()[:16]


def test_records_of_other_places_share_no_pad_and_stay_sealed_in_the_file(path, state):
    content = path.read_bytes()
    with GalleryTape.open(path, state_dir=state) as tape:
        pads = [tape.slot(0, index).pad.tobytes() for index in range(18)]
        pads += [tape.slot(1, index).pad.tobytes() for index in range(5)]
        pads += [tape.tile(row, 0).pad.tobytes() for row in (0, 1)]
    assert len({pad[:16] for pad in pads}) == len(pads)
    assert slot_correction(HEADER, 0, 3) not in content
    assert tile_correction(HEADER, 0, 0).tobytes()[:64] not in content
    assert not any(pad[:16] in content for pad in pads)


@pytest.mark.parametrize(
    "use",
    [
        lambda tape: tape.slot(0, 18),
        lambda tape: tape.slot(1, -1),
        lambda tape: tape.slot(2, 0),
        lambda tape: tape.tile(2, 0),
        lambda tape: tape.tile(0, 1),
        lambda tape: tape.tile(-1, 0),
        lambda tape: tape.erase(rows=[0, 2]),
        lambda tape: tape.erase(columns=[-1]),
    ],
)
def test_places_that_there_are_not_are_refused(path, state, use):
    with GalleryTape.open(path, state_dir=state) as tape:
        with pytest.raises(ValueError, match="not"):
            use(tape)
        check_all(tape)


def test_either_kind_of_tape_says_what_it_is_and_who_takes_it(path, state, tmp_path):
    jobs = tape_helpers.deal(tmp_path / "jobs.tape")
    with pytest.raises(
        TapeMismatch, match=r"bob\.tape: a gallery's tape.*spdz\.gallery\.GalleryTape takes it"
    ):
        Tape.open(path, state_dir=state)
    with pytest.raises(TapeMismatch, match=r"GalleryTape takes it"):
        tape_status(path, state)
    with pytest.raises(TapeMismatch, match=r"jobs\.tape: a tape of jobs.*spdz match\) takes it"):
        GalleryTape.open(jobs, state_dir=state)


def test_what_is_no_tape_is_named(tmp_path, state):
    (tmp_path / "foreign").write_bytes(b"x" * 5000)
    for name, says in (("missing", "no such file"), (".", "is a folder"), ("foreign", "not a tape")):
        with pytest.raises(TapeError, match=says):
            GalleryTape.open(tmp_path / name, state_dir=state)


def test_second_open_and_a_copy_are_refused_until_the_first_is_closed(path, state, tmp_path):
    copy = shutil.copy(path, tmp_path / "copy.tape")
    other = deal(tmp_path / "other.tape", party=1)
    script = (
        "import sys, pathlib, spdz.gallery, spdz.foundations.errors\n"
        "try: spdz.gallery.GalleryTape.open(sys.argv[1], state_dir=pathlib.Path(sys.argv[2]))\n"
        "except spdz.foundations.errors.TapeInUse: print('in use')\n"
    )
    with GalleryTape.open(path, state_dir=state), GalleryTape.open(other, state_dir=state):
        for again in (path, copy):
            with pytest.raises(TapeInUse, match="open"):
                GalleryTape.open(again, state_dir=state)
        command = [sys.executable, "-c", script, str(path), str(state)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        assert done.stdout == "in use\n"
    for again in (path, copy, path):
        GalleryTape.open(again, state_dir=state).close()


def test_a_failed_open_leaves_nothing_locked(path, state):
    whole = path.read_bytes()
    os.truncate(path, 5000)
    with pytest.raises(TapeDamaged):
        GalleryTape.open(path, state_dir=state)
    path.write_bytes(whole)
    GalleryTape.open(path, state_dir=state).close()


def test_closed_tape_refuses(path, state):
    tape = GalleryTape.open(path, state_dir=state)
    tape.close()
    tape.close()
    for use in (
        lambda: tape.slot(0, 0),
        lambda: tape.tile(0, 0),
        lambda: tape.alpha,
        tape.erase,
        tape.destroy,
    ):
        with pytest.raises(TapeError, match="closed"):
            use()
    assert tape._table._keys == {}


def test_fork_is_noticed(path, state):
    with GalleryTape.open(path, state_dir=state) as tape:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # forking beside BLAS threads, from Python 3.12
            child = os.fork()
        if child == 0:
            refused = 0
            for use in (lambda: tape.slot(0, 0), lambda: tape.tile(0, 0), tape.erase, tape.destroy):
                try:
                    use()
                except TapeInUse:
                    refused += 1
            tape.close()
            os._exit(refused)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 4
        check_all(tape)
        with pytest.raises(TapeInUse):
            GalleryTape.open(path, state_dir=state)


def test_a_fork_that_lives_on_does_not_keep_a_closed_tape_locked(path, state):
    tape = GalleryTape.open(path, state_dir=state)
    until, done = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        os.close(done)
        os.read(until, 1)  # until the parent closes its end
        os._exit(0)
    try:
        tape.close()
        GalleryTape.open(path, state_dir=state).close()
    finally:
        os.close(done)
        os.close(until)
        os.waitpid(child, 0)


def test_threads_read_what_was_dealt_while_another_erases(tmp_path, state):
    path = deal(tmp_path / "t.tape", slots=(64, 32))
    header = replace(HEADER, slots=(64, 32))
    expected = {tile: tile_correction(header, *tile) for tile in tiles(header)}
    wrong, erased = [], []

    def read():
        for _ in range(20):
            for (row, column), dealt in expected.items():
                try:
                    if not np.array_equal(tape.tile(row, column).correction, dealt):
                        wrong.append((row, column))
                except TapeExhausted:
                    erased.append(row)

    with GalleryTape.open(path, state_dir=state) as tape:
        threads = [threading.Thread(target=read) for _ in range(3)]
        for thread in threads:
            thread.start()
        for row in (1, 3):
            tape.erase(rows=[row])
        for thread in threads:
            thread.join(60)
    assert wrong == [] and set(erased) <= {1, 3}


def test_repr_shows_no_secret_and_files_are_private(path, state):
    with GalleryTape.open(path, state_dir=state) as tape:
        shown = repr(tape) + repr(tape.tile(0, 0)) + repr(tape.slot(0, 0))
        tape.erase(rows=[0])
    assert "alice for bob: 17 x 5 slots" in shown
    assert not any(word in shown for word in ("pad=", "correction", "delta", repr(ALPHA)))
    for file in (path, *state.iterdir()):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert [file.name for file in path.parent.iterdir()] == ["bob.tape"]


def test_erased_bands_are_gone_for_good_and_the_others_stay(path, state):
    (first, second), (column,) = band_keys(HEADER)
    with GalleryTape.open(path, state_dir=state) as tape:
        tape.erase(rows=[0])
        assert first not in path.read_bytes()
    with GalleryTape.open(path, state_dir=state) as tape:
        for use in (lambda: tape.tile(0, 0), lambda: tape.slot(0, 8)):
            with pytest.raises(TapeExhausted, match=r"row band 0 was erased.* --slots RxC --out") as caught:
                use()
            assert "--tile" not in str(caught.value)
        assert tape.slot(0, 9).correction == slot_correction(HEADER, 0, 9)
        assert np.array_equal(tape.tile(1, 0).correction, tile_correction(HEADER, 1, 0))
        tape.erase(rows=[0], columns=[0])
        for use in (lambda: tape.tile(1, 0), lambda: tape.slot(1, 4)):
            with pytest.raises(TapeExhausted, match="column band 0"):
                use()
        assert tape.slot(0, 17).correction == slot_correction(HEADER, 0, 17)
    content = path.read_bytes()
    assert column not in content and second in content


def test_erasing_again_finishes_what_a_failing_disk_left(path, state, monkeypatch):
    (first, second), _ = band_keys(HEADER)
    with GalleryTape.open(path, state_dir=state) as tape:
        with monkeypatch.context() as patch, pytest.raises(TapeError, match="disk failed"):
            patch.setattr(os, "pwrite", lambda *arguments: (_ for _ in ()).throw(OSError(5, "broken")))
            tape.erase(rows=[0])
        assert first in path.read_bytes()
        with pytest.raises(TapeError, match="row band 0"):
            tape.tile(0, 0)
        tape.erase(rows=[0])
        assert first not in path.read_bytes() and second in path.read_bytes()


def test_destroyed_tape_keeps_no_secret_and_its_copies_are_refused(path, state, tmp_path):
    copy = shutil.copy(path, tmp_path / "copy.tape")
    with GalleryTape.open(path, state_dir=state) as tape:
        tape.erase(rows=[1])
        tape.destroy()
        tape.destroy()
        for use in (lambda: tape.slot(0, 0), lambda: tape.tile(0, 0), lambda: tape.alpha, tape.erase):
            with pytest.raises(TapeDestroyed):
                use()
    secrets = (ALPHA, *band_keys(HEADER)[0], *band_keys(HEADER)[1])
    assert not any(secret in path.read_bytes() for secret in secrets)
    assert all(secret in copy.read_bytes() for secret in secrets)
    with pytest.raises(TapeDestroyed, match=r"bob\.tape"):
        GalleryTape.open(path, state_dir=state / "elsewhere")
    with pytest.raises(TapeDestroyed, match=r"copy\.tape"):
        GalleryTape.open(copy, state_dir=state)
    assert not any(secret in copy.read_bytes() for secret in secrets)
