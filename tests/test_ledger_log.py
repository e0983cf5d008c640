"""The ledger's write-ahead log: what it leaves behind, who may read, and what forks and backups do to it."""

import os
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys

import pytest
from ledger_helpers import Model, facts, mark_of, open_ledger, random_actions, run

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery.store import Store

FRAME = 4096 + 24  # of a log: a page and its header (SQLite, file format, section 4.1)


@pytest.fixture(autouse=True)
def no_sync(quick_disk, monkeypatch):
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "gallery"


def files(folder):
    return sorted(file.name for file in folder.glob("t.ledger*"))


def fills(ledger, start, stop, size=10):
    for slot in range(start, stop):
        ledger.slots[0].fill([(slot, bytes(size))])


def killed(act):
    """Run in a process that is killed afterwards."""
    process = os.fork()
    if process == 0:
        try:
            act()
            os.kill(os.getpid(), signal.SIGKILL)
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == -signal.SIGKILL


def log_left(folder, actions):
    """Have a process do ``actions`` and be killed, so that its log is left."""

    def act():
        ledger = open_ledger(folder)
        for action in actions:
            run(ledger, *action)

    killed(act)
    assert files(folder) == ["t.ledger", "t.ledger-shm", "t.ledger-wal"]


def states(actions):
    model, found = Model(), [Model().facts()]
    for action in actions:
        model.apply(*action)
        found.append(model.copy().facts())
    return found


def test_one_whole_file_is_left_when_it_is_closed(folder):
    with open_ledger(folder) as ledger:
        fills(ledger, 0, 3)
        assert files(folder) == ["t.ledger", "t.ledger-shm", "t.ledger-wal"]
        before = facts(ledger)
    assert files(folder) == ["t.ledger"]
    copy = folder.with_name("copy")
    copy.mkdir()
    shutil.copy(folder / "t.ledger", copy)
    with open_ledger(copy) as ledger:
        assert facts(ledger) == before


def test_log_and_shared_memory_are_private_whatever_the_umask(folder):
    old = os.umask(0)
    try:
        with open_ledger(folder) as ledger:
            fills(ledger, 0, 1)
            modes = [stat.S_IMODE((folder / name).stat().st_mode) for name in files(folder)]
    finally:
        os.umask(old)
    assert modes == [0o600] * 3


READER = """
import sqlite3, sys
base = sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True)
count = lambda: base.execute("SELECT count(*) FROM slots").fetchall()[0][0]
if sys.argv[2:] == ["hold"]:
    base.execute("BEGIN")
print(count(), flush=True)
if len(sys.argv) > 2:
    sys.stdin.readline()
    print(count(), flush=True)
"""


def reader(folder, *more):
    script = [sys.executable, "-c", READER, str(folder / "t.ledger"), *more]
    return subprocess.Popen(script, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_another_process_reads_while_it_is_open_and_after(folder):
    with open_ledger(folder) as ledger:
        fills(ledger, 0, 2)
        standing, holding = reader(folder, "stay"), reader(folder, "hold")
        assert standing.stdout.readline() == holding.stdout.readline() == "2\n"
        fills(ledger, 2, 5)
        assert reader(folder).communicate() == ("5\n", None)
        assert holding.communicate("\n") == ("2\n", None)  # as when it began to read
    copy = shutil.copy(folder / "t.ledger", folder / "copy")  # the one that stays has left the log empty
    assert sqlite3.connect(copy).execute("SELECT count(*) FROM slots").fetchall() == [(5,)]
    assert standing.communicate("\n") == ("5\n", None)
    assert reader(folder).communicate() == ("5\n", None)
    with open_ledger(folder) as ledger:
        assert (ledger.slots[0].filled, ledger.rolled_back) == (5, False)
    assert files(folder) == ["t.ledger"]


def test_copy_without_its_log_is_an_older_ledger(folder):
    with open_ledger(folder) as ledger:
        fills(ledger, 0, 2)
    log_left(folder, [("fill", 0, [(2, b"sent")]), ("fill", 0, [(3, b"sent")])])
    for name in ("t.ledger-wal", "t.ledger-shm"):
        (folder / name).unlink()
    with open_ledger(folder) as ledger:
        assert ledger.rolled_back
        assert ledger.slots[0].voids == [2, 3]


@pytest.mark.parametrize("seed", range(2))
def test_log_cut_anywhere_is_an_older_ledger(tmp_path, folder, seed):
    """The disk has lost its end; all that was used stays used."""
    actions = random_actions(seed + 20, 12)
    expected = states(actions)
    log_left(folder, actions)
    size = (folder / "t.ledger-wal").stat().st_size
    older = 0
    for cut in [*range(31, size, FRAME), *range(33 + FRAME // 2, size, FRAME), size]:
        place = tmp_path / "cut"
        shutil.copytree(folder, place)
        os.truncate(place / "t.ledger-wal", cut)
        with open_ledger(place) as ledger:
            found, sent = facts(ledger), expected[-1]
            assert ledger.rolled_back is (found != sent)
            older += ledger.rolled_back
            assert (found["text"], found["done"][0] >= sent["done"][0]) == (sent["text"], True)
            for owner in (0, 1):
                assert len(found[f"eps {owner}"]) == len(sent[f"eps {owner}"])
                for here, there in zip(found[f"eps {owner}"], sent[f"eps {owner}"], strict=True):
                    assert here in (None, there)
        shutil.rmtree(place)
    assert older > 12


@pytest.mark.parametrize("seed", range(4))
def test_backup_beside_a_log_that_a_crash_left_is_whole_or_damaged(tmp_path, folder, seed):
    """The log's pages are put into a file of another time."""
    actions = random_actions(seed + 30, 40)
    expected = states(actions)[-1]
    backups = []
    for stop in range(0, 36, 4):
        with open_ledger(folder) as ledger:
            for action in actions[stop : stop + 4]:
                run(ledger, *action)
        backups.append(shutil.copy(folder / "t.ledger", tmp_path / f"{stop}"))
    log_left(folder, actions[36:])
    for backup in backups:
        place = tmp_path / "place"
        shutil.copytree(folder, place)
        shutil.copy(backup, place / "t.ledger")
        try:
            with open_ledger(place) as ledger:
                assert facts(ledger) == expected
        except TapeDamaged:
            pass
        shutil.rmtree(place)


def test_log_begins_anew_when_it_is_long(folder, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr("spdz.tape.durable.os.fsync", lambda descriptor: None)
    with open_ledger(folder) as ledger:
        ledger.slots[0].fill([(0, bytes(12_000_000))])
        assert (folder / "t.ledger-wal").stat().st_size > 12_000_000
        fills(ledger, 1, 3)
        assert (folder / "t.ledger-wal").stat().st_size <= 4_200_000
        ledger.slots[0].fill([(slot, bytes(100_000)) for slot in range(3, 103)])
        fills(ledger, 103, 105)
        assert (folder / "t.ledger-wal").stat().st_size <= 4_200_000


def test_log_that_a_killed_process_left_is_synced_before_it_counts(folder, monkeypatch):
    log_left(folder, [("fill", 0, [(0, b"sent")])])
    wanted = [(folder / "t.ledger-wal").stat().st_ino, folder.stat().st_ino]
    synced, connect = [], sqlite3.connect

    def connected(*args, **options):
        assert synced[-2:] == wanted
        return connect(*args, **options)

    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
    monkeypatch.setattr(sqlite3, "connect", connected)
    open_ledger(folder).close()
    assert synced[: len(wanted)] != []


def test_file_system_without_shared_memory_is_refused(folder, monkeypatch):
    monkeypatch.setattr(Store, "_journal_mode", lambda self, wanted="": "truncate")
    with pytest.raises(TapeError, match="shared memory"):
        open_ledger(folder)


def test_killed_between_making_the_tables_and_the_log(folder, monkeypatch):
    class Stop(BaseException):
        pass

    mode = Store._journal_mode

    def stop(self, wanted=""):
        if wanted == "WAL":
            raise Stop
        return mode(self, wanted)

    monkeypatch.setattr(Store, "_journal_mode", stop)
    with pytest.raises(Stop):
        open_ledger(folder)
    monkeypatch.undo()
    assert not mark_of(folder).exists()
    with open_ledger(folder) as ledger:
        assert ledger._journal._store.all("PRAGMA journal_mode") == [("wal",)]
        assert facts(ledger) == Model().facts()


FORKED = """
import os, sys, signal
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from ledger_helpers import open_ledger
folder = Path(sys.argv[1])
ledger = open_ledger(folder)
reading, writing = os.pipe()
late = os.fork()
if late == 0:
    os.close(writing)
    os.read(reading, 1)  # until the others are through
    ledger.close()
    del ledger
    sys.exit(7)
ledger.close()
killed = os.fork()
if killed == 0:
    ledger = open_ledger(folder)
    ledger.slots[0].fill([(0, b"sent")])
    os.kill(os.getpid(), signal.SIGKILL)
os.waitpid(killed, 0)
os.close(writing)
assert os.waitstatus_to_exitcode(os.waitpid(late, 0)[1]) == 7
"""


def test_fork_that_outlives_the_ledger_leaves_a_later_log_alone(folder):
    script = [sys.executable, "-W", "ignore", "-c", FORKED, str(folder), os.path.dirname(__file__)]
    done = subprocess.run(script, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stderr
    assert "t.ledger-wal" in files(folder)
    with open_ledger(folder) as ledger:
        assert (ledger.rolled_back, ledger.slots[0].eps(0, 1)) == (False, [b"sent"])
