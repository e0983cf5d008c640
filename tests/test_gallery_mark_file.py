"""The mark's two slots: crashes of the machine at every write and sync, damage, growth."""

import itertools
import os
import shutil

import pytest
from crash_helpers import FATES, Crash, Disk
from ledger_helpers import TAPE, Model, facts, mark_of, open_ledger, random_actions, run

from spdz.foundations.errors import TapeDamaged, TapeDestroyed
from spdz.gallery.mark_file import MarkFile

TEXT = "pin_text", bytes(range(256)) * 20
"""Longer than a slot."""


@pytest.fixture(autouse=True)
def quick_log(monkeypatch):
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "gallery"


def act(ledger, actions):
    for action in actions:
        run(ledger, *action)


def fills(count, start=0):
    return [("fill", 0, [(slot, b"%d" % slot)]) for slot in range(start, start + count)]


def slots_of(folder):
    content = mark_of(folder).read_bytes()
    return content[: len(content) // 2], content[len(content) // 2 :]


def tear(folder, which):
    """Damage one slot: 0, 1, or that of the latest mark, or of the one before."""
    first, second = slots_of(folder)
    latest = 0 if sequence(first) > sequence(second) else 1
    which = {"latest": latest, "earlier": 1 - latest}.get(which, which)
    content = bytearray(first + second)
    content[which * len(first) + 25] ^= 1  # in the tape's id
    mark_of(folder).write_bytes(content)


def sequence(slot):
    return int(slot.split(b'"sequence":')[1].split(b",")[0])


@pytest.mark.parametrize("fate", [*FATES, "killed"])
@pytest.mark.parametrize("seed", range(2))
def test_crash_of_the_machine_at_every_step_of_the_mark(tmp_path, monkeypatch, seed, fate):
    actions = [*random_actions(seed, 6), TEXT] if seed else [TEXT, *fills(4)]
    actions = [action for action in actions if action[0] != "pin_text" or action is TEXT]
    model, expected = Model(), [Model().facts()]
    for action in actions:
        model.apply(*action)
        expected.append(model.copy().facts())
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        returned = -1
        with monkeypatch.context() as patch:
            disk = Disk(patch, folder, stop_at, fate)
            try:
                with open_ledger(folder) as ledger:
                    for action in actions:
                        returned += 1
                        run(ledger, *action)
                    returned += 1
            except Crash:
                pass
            crashed = disk.steps >= stop_at
        with open_ledger(folder) as ledger:
            assert not ledger.rolled_back
            assert facts(ledger) in expected[max(returned, 0) : returned + 2]
            slot = ledger.slots[0].filled
            ledger.slots[0].fill([(slot, b"after")])
        with open_ledger(folder) as ledger:
            assert (ledger.slots[0].filled, ledger.rolled_back) == (slot + 1, False)
        shutil.rmtree(folder)
        if not crashed:
            break
    assert returned == len(actions)
    assert stop_at > 2 * len(actions)


def test_a_step_overwrites_the_older_slot_and_syncs_once(folder, monkeypatch):
    done = []
    with open_ledger(folder) as ledger:
        inode = mark_of(folder).stat().st_ino
        for name in ("pwrite", "replace", "fsync", "fdatasync"):
            function = getattr(os, name)
            monkeypatch.setattr(
                os, name, lambda *args, name=name, function=function: (done.append(name), function(*args))[1]
            )
        slots = [slots_of(folder)]
        for action in fills(4):
            run(ledger, *action)
            slots.append(slots_of(folder))
        monkeypatch.undo()
    assert done == ["pwrite", "fdatasync"] * 4
    assert mark_of(folder).stat().st_ino == inode
    changed = [[a != b for a, b in zip(old, new, strict=True)] for old, new in itertools.pairwise(slots)]
    assert changed in ([[True, False], [False, True]] * 2, [[False, True], [True, False]] * 2)


@pytest.mark.parametrize("which", ["latest", "earlier"])
@pytest.mark.parametrize("ahead", [-1, 0, 1, 2])
def test_torn_slot_and_a_ledger_that_is_older_or_newer(tmp_path, folder, which, ahead):
    """It counts where the ledger is ahead of the slot that is left."""
    with open_ledger(folder) as ledger:
        act(ledger, fills(5))
    tear(folder, which)
    left = 4 if which == "latest" else 5
    other = tmp_path / "other"
    with open_ledger(other) as ledger:
        act(ledger, fills(left + ahead))
    shutil.copy(other / "t.ledger", folder)
    if ahead <= 0:
        with pytest.raises(TapeDamaged, match="mark is damaged"):
            open_ledger(folder)
        return
    with open_ledger(folder) as ledger:
        assert (ledger.rolled_back, ledger.slots[0].filled) == (False, left + ahead)
    assert max(map(sequence, slots_of(folder))) == left + ahead
    open_ledger(folder).close()


@pytest.mark.parametrize("which", ["latest", "earlier"])
def test_torn_slot_and_no_ledger_is_damage(folder, which):
    with open_ledger(folder) as ledger:
        act(ledger, fills(5))
    tear(folder, which)
    (folder / "t.ledger").unlink()
    with pytest.raises(TapeDamaged, match="mark is damaged"):
        open_ledger(folder)


def test_no_whole_slot_is_damage(folder):
    with open_ledger(folder) as ledger:
        act(ledger, fills(2))
    tear(folder, 0)
    tear(folder, 1)
    with pytest.raises(TapeDamaged, match="mark is damaged"):
        open_ledger(folder)


def test_slot_of_another_party_is_not_whole(folder):
    for party in (0, 1):
        with (
            open_ledger(folder / str(party), party=party, state_dir=folder / "state")
            if folder.mkdir(exist_ok=True) is None
            else None as ledger
        ):
            act(ledger, fills(2))
    other = (folder / "state" / f"{TAPE}-1.gallery").read_bytes()
    mine = mark_of(folder).read_bytes()
    mark_of(folder).write_bytes(other[:4096] + mine[4096:])
    marks = MarkFile(folder / "state", TAPE, 0)
    assert marks.read().party == 0 and marks.torn


def test_mark_that_outgrows_its_slot_gets_larger_ones(folder):
    with open_ledger(folder) as ledger:
        assert mark_of(folder).stat().st_size == 2 * 4096
        act(ledger, [*fills(3), TEXT])
        size = mark_of(folder).stat().st_size
        assert size >= 2 * 2 * 2 * len(TEXT[1]) and size % 8192 == 0
        assert slots_of(folder)[0] == slots_of(folder)[1]
        act(ledger, fills(2, 3))
        assert mark_of(folder).stat().st_size == size
    with open_ledger(folder) as ledger:
        assert (ledger.text, ledger.slots[0].filled, ledger.rolled_back) == (TEXT[1], 5, False)
    assert mark_of(folder).stat().st_mode & 0o777 == 0o600


def test_mark_that_goes_missing_while_open_is_made_again(folder):
    with open_ledger(folder) as ledger:
        act(ledger, fills(1))
        mark_of(folder).unlink()
        act(ledger, fills(1, 1))
    assert [sequence(slot) for slot in slots_of(folder)] == [2, 2]


def test_destroyed_in_one_slot_is_destroyed(folder):
    """Also where the other slot is of a later step: a copy of a destroyed ledger came from elsewhere."""
    with open_ledger(folder) as ledger:
        act(ledger, fills(1))
        copy = shutil.copy(folder / "t.ledger", folder / "copy")
    with open_ledger(folder) as ledger:
        act(ledger, fills(4, 1))
    kept = shutil.copy(folder / "t.ledger", folder / "kept")
    shutil.copy(copy, folder / "t.ledger")
    with open_ledger(folder, state_dir=folder / "elsewhere") as ledger:
        ledger.destroy()
    with pytest.raises(TapeDestroyed):
        open_ledger(folder)
    shutil.copy(kept, folder / "t.ledger")
    with pytest.raises(TapeDestroyed):
        open_ledger(folder)


def test_what_is_read_is_synced_first(folder, monkeypatch):
    """A killed process may have left it in memory only."""
    with open_ledger(folder) as ledger:
        act(ledger, fills(1))
    synced = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
    MarkFile(folder / "state", TAPE, 0).read()
    assert synced == [mark_of(folder).stat().st_ino, mark_of(folder).parent.stat().st_ino]
