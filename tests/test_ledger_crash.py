"""A robot is killed at every step of its ledger; what it has sent or shown before must still be there."""

import itertools
import os
import random
import shutil
import signal
import sqlite3
import time

import pytest
from ledger_helpers import Model, facts, mark_of, open_ledger, random_actions, run

from spdz.foundations.errors import TapeDestroyed

KILLED = 9


@pytest.fixture
def no_sync(quick_disk, monkeypatch):
    """Killing a process loses nothing that it wrote."""
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))


def states(actions):
    """What a ledger holds after 0, 1, ... operations."""
    model, found = Model(), [Model().facts()]
    for action in actions:
        model.apply(*action)
        found.append(model.copy().facts())
    return found


def child(folder, actions, returned, stop_at=None):
    """Do the operations and tell of each that returned; die at a step of the disk."""
    if stop_at is not None:
        steps = itertools.count(1)

        def step():
            if next(steps) == stop_at:
                os._exit(KILLED)

        for name in ("pwrite", "replace", "fsync", "fdatasync"):
            watch(name, step)
        connect = sqlite3.connect

        def watched(*args, **options):
            base = connect(*args, **options)
            base.set_trace_callback(lambda statement: step())
            return base

        sqlite3.connect = watched
    with open_ledger(folder) as ledger:
        for action in actions:
            if action == ("destroy",):
                ledger.destroy()
            else:
                run(ledger, *action)
            os.write(returned, b".")
    os._exit(0)


def watch(name, step):
    """Have ``step`` called before and after a function of ``os``."""
    function = getattr(os, name)

    def watched(*args):
        step()
        result = function(*args)
        step()
        return result

    setattr(os, name, watched)


def run_child(folder, actions, stop_at=None, kill_after=None):
    """Number of operations that returned, and whether the child was killed.

    ``kill_after``: that many operations and so many seconds.
    """
    reading, writing = os.pipe()
    process = os.fork()
    if process == 0:
        try:
            child(folder, actions, writing, stop_at)
        finally:
            os._exit(1)
    os.close(writing)
    returned = 0
    while got := os.read(reading, 1):
        returned += len(got)
        if kill_after is not None and returned == kill_after[0]:
            time.sleep(kill_after[1])
            os.kill(process, signal.SIGKILL)
    os.close(reading)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    assert code in (0, KILLED, -signal.SIGKILL)
    return returned, code != 0


def check(folder, expected, returned):
    """All that returned is there, the next operation is there wholly or not at all; then use it."""
    with open_ledger(folder) as ledger:
        assert not ledger.rolled_back
        found = facts(ledger)
        assert found in expected[returned : returned + 2]
        slot = ledger.slots[0].filled
        ledger.slots[0].fill([(slot, b"after")])
    with open_ledger(folder) as ledger:
        assert ledger.slots[0].eps(0, slot + 1) == [*found["eps 0"], b"after"]


@pytest.mark.parametrize("seed", range(3))
def test_killed_at_every_step(no_sync, tmp_path, seed):
    actions = random_actions(seed, 12)
    expected = states(actions)
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        returned, killed = run_child(folder, actions, stop_at)
        check(folder, expected, returned)
        shutil.rmtree(folder)
        if not killed:
            break
    assert returned == len(actions)
    assert stop_at > 100


def test_killed_at_any_time(tmp_path):
    rng = random.Random(1)
    actions = random_actions(1, 100)
    expected = states(actions)
    for attempt in range(40):
        folder = tmp_path / str(attempt)
        returned, _ = run_child(folder, actions, kill_after=(rng.randint(1, 30), rng.uniform(0, 0.004)))
        check(folder, expected, returned)
        shutil.rmtree(folder)


@pytest.mark.parametrize("seed", range(2))
def test_killed_and_then_restored_from_a_backup(no_sync, tmp_path, seed):
    """Whatever was sent before the crash is void, burnt or the same, as the mark says."""
    actions = random_actions(seed + 10, 14)
    expected = states(actions)
    before = tmp_path / "before"
    with open_ledger(before) as ledger:
        for action in actions[:6]:
            run(ledger, *action)
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        shutil.copytree(before, folder)
        returned, killed = run_child(folder, actions[6:], stop_at)
        for file in folder.glob("t.ledger*"):
            file.unlink()
        shutil.copy(before / "t.ledger", folder)
        with open_ledger(folder) as ledger:
            found, sent = facts(ledger), expected[6 + returned]
            for owner in (0, 1):
                assert len(found[f"eps {owner}"]) >= len(sent[f"eps {owner}"])
                for here, there in zip(found[f"eps {owner}"], sent[f"eps {owner}"], strict=False):
                    assert here in (None, there)
            assert sent["text"] in (None, found["text"])
            used = max(sent["done"][0], found["done"][0]), max(sent["done"][1], found["done"][1])
            assert found["done"] == used
            if sent["flight"] not in (None, found["flight"]):
                assert found["done"][0] >= sent["flight"].rows.stop
                assert found["done"][1] >= sent["flight"].columns.stop
        shutil.rmtree(folder)
        if not killed:
            break
    assert stop_at > 60


def test_killed_while_recovering(no_sync, tmp_path):
    actions = random_actions(5, 25)
    before = tmp_path / "before"
    with open_ledger(before) as ledger:
        for action in actions[:10]:
            run(ledger, *action)
        copy = shutil.copy(before / "t.ledger", tmp_path / "backup")
        for action in actions[10:]:
            run(ledger, *action)
    shutil.copy(copy, before / "t.ledger")
    whole = tmp_path / "whole"
    shutil.copytree(before, whole)
    with open_ledger(whole) as ledger:
        assert ledger.rolled_back
        expected = facts(ledger)
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        shutil.copytree(before, folder)
        _, killed = run_child(folder, [], stop_at)
        with open_ledger(folder) as ledger:
            assert facts(ledger) == expected
        shutil.rmtree(folder)
        if not killed:
            break
    assert stop_at > 10


def test_killed_while_destroying(no_sync, tmp_path):
    refused = 0
    actions = [*random_actions(2, 4), ("destroy",)]
    for stop_at in itertools.count(1):
        folder = tmp_path / str(stop_at)
        returned, killed = run_child(folder, actions, stop_at)
        try:
            open_ledger(folder).close()
            assert returned < len(actions)
        except TapeDestroyed:
            assert returned >= len(actions) - 1
            refused += 1
            for lost in (folder / "t.ledger", mark_of(folder)) if not killed else ():
                lost.unlink()
                with pytest.raises(TapeDestroyed):
                    open_ledger(folder)
        shutil.rmtree(folder)
        if not killed:
            break
    assert refused > 2
