"""Crashes of the machine at every step, with every fate of the writes that were not synced yet."""

import errno
import itertools
import shutil

import pytest
from crash_helpers import FATES, Crash, Disk
from tape_helpers import ALPHA, CHAIN, chains, deal

from spdz.arithmetic import prf
from spdz.foundations.errors import TapeDestroyed, TapeError
from spdz.tape import Tape
from spdz.tape.envelope import SECTOR
from spdz.tape.state import State, StateSlots, encode_slot


class Robot:
    """A robot that uses a tape, and remembers outside the simulated machine what it was handed."""

    def __init__(self, folder, dealt):
        self.folder, self.path, self.state = folder, folder / "bob.tape", folder / "state"
        folder.mkdir()
        shutil.copy(dealt, self.path)
        self.handed = []
        self.pending = []
        self.furthest = 0
        self.destroyed = False

    def run(self, *actions):
        with Tape.open(self.path, state_dir=self.state) as tape:
            self.saw(tape)
            for action, number in actions:
                if action == "reserve":
                    self.handed += tape.reserve(number)
                elif action == "resume":
                    tape.resume(number)
                else:
                    tape.destroy()
                    self.destroyed = True
                    return
                self.saw(tape)

    def saw(self, tape):
        assert tape.cursor >= self.furthest, "the cursor went back"
        self.furthest = tape.cursor
        content = self.path.read_bytes()
        assert not any(chain in content for chain in chains(tape.cursor + 1)[:-1]), "a used chain is left"

    def crash(self, stop_at, fate, *actions):
        """Run until the crash; False if there was none."""
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = Disk(monkeypatch, self.folder, stop_at, fate, self.pending)
            try:
                self.run(*actions)
            except Crash:
                self.pending = disk.pending if fate == "killed" else []
                return True
        return False

    def check(self):
        indices = [job.index for job in self.handed]
        assert len(indices) == len(set(indices)), "a job was handed out twice"
        ratchet = chains(max(indices, default=0) + 1)
        for job in self.handed:
            assert job.key == prf.job_key(ratchet[job.index])


USE = [("reserve", 2), ("reserve", 1), ("resume", 5), ("reserve", 1)]


@pytest.fixture
def dealt(tmp_path):
    return deal(tmp_path / "dealt.tape", jobs=20, correction_bytes=8)


@pytest.fixture
def new_robot(tmp_path, dealt):
    numbers = itertools.count()
    with pytest.MonkeyPatch.context() as monkeypatch:
        Disk(monkeypatch, tmp_path, None, "kept")
        yield lambda: Robot(tmp_path / str(next(numbers)), dealt)


@pytest.mark.parametrize("lost_too", ["nothing", "mark", "tape"])
@pytest.mark.parametrize("fate", FATES)
def test_no_job_is_handed_out_twice_whatever_crashes(new_robot, dealt, fate, lost_too):
    """The tape's state and its high-water mark are each enough without the other."""
    for stop_at in itertools.count(1):
        robot = new_robot()
        crashed = robot.crash(stop_at, fate, *USE)
        if lost_too == "mark":
            shutil.rmtree(robot.state, ignore_errors=True)
        if lost_too == "tape":
            shutil.copy(dealt, robot.path)
        robot.run(("reserve", 1), ("reserve", 2))
        robot.check()
        if not crashed:
            break
    assert stop_at > 30


@pytest.mark.parametrize("first_fate", ["killed", "torn"])
@pytest.mark.parametrize("second_fate", FATES)
def test_crash_during_recovery_is_survived_too(new_robot, first_fate, second_fate):
    for first in range(1, 45):
        for second in itertools.count(1):
            robot = new_robot()
            robot.crash(first, first_fate, *USE)
            crashed = robot.crash(second, second_fate)
            robot.run(("reserve", 1))
            robot.check()
            if not crashed:
                break


@pytest.mark.parametrize("fate", FATES)
def test_mark_is_never_behind_the_tape(new_robot, fate):
    for stop_at in itertools.count(1):
        robot = new_robot()
        crashed = robot.crash(stop_at, fate, *USE)
        mark = robot.state / "beef-0.mark"
        marked = int(mark.read_text().split()[4]) if mark.exists() else 0
        with Tape.open(robot.path, state_dir=robot.folder / "no mark") as tape:
            assert tape.cursor <= marked
        if not crashed:
            break


def test_everything_is_synced_when_a_call_returns(new_robot):
    robot = new_robot()
    with pytest.MonkeyPatch.context() as monkeypatch:
        disk = Disk(monkeypatch, robot.folder, None, "kept")
        with Tape.open(robot.path, state_dir=robot.state) as tape:
            assert disk.pending == []
            for use in (lambda: tape.reserve(2), lambda: tape.resume(4), tape.destroy):
                before = disk.steps
                use()
                assert disk.steps > before
                assert disk.pending == []


def test_later_of_two_whole_states_counts_and_the_other_is_wiped(tmp_path):
    path = tmp_path / "slots"
    for first in (0, 1):
        states = [State(5 + which, bytes([which + 1]) * 32, ALPHA) for which in (0, 1)]
        slots = [encode_slot(state, 7 + which, b"x") for which, state in enumerate(states)]
        path.write_bytes(slots[first] + slots[1 - first])
        with path.open("r+b") as file:
            assert StateSlots(file.fileno(), 0, b"x").load() == states[1]
        assert sorted([path.read_bytes()[:SECTOR], path.read_bytes()[SECTOR:]]) == [bytes(SECTOR), slots[1]]


@pytest.mark.parametrize("fate", FATES)
def test_crash_during_destroy_leaves_the_tape_whole_or_destroyed(new_robot, fate):
    refused = 0
    for stop_at in itertools.count(1):
        robot = new_robot()
        crashed = robot.crash(stop_at, fate, ("reserve", 2), ("destroy", 0))
        assert robot.destroyed is not crashed
        try:
            robot.run(("reserve", 1))
            robot.check()
            assert crashed
        except TapeDestroyed:
            refused += 1
            content = robot.path.read_bytes()
            assert ALPHA not in content
            assert CHAIN not in content
        if not crashed:
            break
    assert refused >= 4


def test_full_disk_hands_out_nothing_and_the_tape_must_be_opened_again(new_robot):
    for failing in range(1, 12):
        robot = new_robot()
        robot.run(("reserve", 1))
        tape = Tape.open(robot.path, state_dir=robot.state)
        robot.saw(tape)
        with pytest.MonkeyPatch.context() as monkeypatch:
            disk = Disk(monkeypatch, robot.folder, failing, "torn")
            step = disk.step

            def fail(under_way=lambda: None, step=step):
                try:
                    step(under_way)
                except Crash:
                    raise OSError(errno.ENOSPC, "No space left on device") from None

            disk.step = fail
            try:
                robot.handed += tape.reserve(2)
                failed = False
            except TapeError as error:
                failed = True
                assert "No space left on device" in str(error)
        if failed:
            with pytest.raises(TapeError, match="open it again"):
                tape.reserve(1)
        tape.close()
        robot.run(("reserve", 1))
        robot.check()
    assert not failed


def test_disk_error_does_not_stop_destroy(new_robot):
    robot = new_robot()
    with Tape.open(robot.path, state_dir=robot.state) as tape:
        with pytest.MonkeyPatch.context() as monkeypatch:
            Disk(monkeypatch, robot.folder, 5, "kept")
            with pytest.raises(Crash):
                tape.reserve(1)
        tape.destroy()
    with pytest.raises(TapeDestroyed):
        robot.run()
    assert ALPHA not in robot.path.read_bytes()
