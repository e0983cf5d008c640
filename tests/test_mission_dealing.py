"""Dealing for a team: every pair once and for ever, whatever stops the dealer and whenever."""

import os
import random
import shutil
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from mission_helpers import COUPLE, TEAM, certificates, check_dealt, meet, plan, run_python

from dealer import cli, folders
from dealer.team import deal, here, pair
from dealer.team.deal import deal_team
from dealer.team.pair import deal_pair
from dealer.team.record import HALVES, Record, read_header
from dealer.team.room import ROOM, opened_room
from dealer.team.stopped import DealingStopped
from dealer.team.tasks import tasks_of
from protocols import memory
from protocols.mission import Folder


@pytest.fixture
def mission(tmp_path):
    return plan(tmp_path)


@pytest.fixture
def couple(tmp_path):
    return plan(tmp_path, COUPLE)


# -- what is dealt ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2])
def test_every_pair_has_two_halves_of_one_dealing_of_every_gallery(tmp_path, mission, workers):
    told = []
    dealt = deal_team(
        tmp_path / "m", mission, workers=workers, progress=lambda done, total: told.append((done, total))
    )
    check_dealt(tmp_path / "m", mission)
    assert (dealt.tasks, dealt.resumed) == (6, 0)
    for folder, size in dealt.folders.items():
        assert size == sum(path.stat().st_size for path in folder.glob("*.tape")) > 0
    assert Folder.open(tmp_path / "m" / "alice").mission_id == dealt.mission_id
    assert told == sorted(told) and told[-1][0] == told[-1][1] == told[0][1]


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_robots_meet_with_what_was_dealt(tmp_path, security):
    mission = plan(tmp_path, f'security = "{security}"\n{TEAM}')
    deal_team(tmp_path / "m", mission, workers=1)
    meet(tmp_path / "m", mission, ("alice", "bob"), "both", tmp_path)
    meet(tmp_path / "m", mission, ("bob", "carol"), "sonar", tmp_path)


def test_only_pairs_of_the_plan_are_dealt(tmp_path):
    mission = plan(tmp_path, 'pairs = [["carol", "bob"], ["alice", "carol"]]\n' + TEAM)
    deal_team(tmp_path / "m", mission, workers=1)
    check_dealt(tmp_path / "m", mission)
    assert not list((tmp_path / "m" / "alice").glob("bob*"))


# -- stopped and gone on with -----------------------------------------------------------------------------


class Stop(BaseException):
    """The process ends here; nothing of it runs any more."""


def stop_at(monkeypatch, step):
    """Stop before the ``step``-th change of names; from there on nothing on the disk changes."""
    count = 0

    def watched(change):
        def change_or_stop(*arguments, **options):
            nonlocal count
            count += 1
            if count >= step:
                raise Stop
            return change(*arguments, **options)

        return change_or_stop

    for name in ("rename", "replace", "link", "unlink", "rmdir", "mkdir"):
        monkeypatch.setattr(os, name, watched(getattr(os, name)))


@pytest.mark.usefixtures("quick_disk")
def test_a_dealer_that_is_stopped_anywhere_goes_on_with_the_same_credentials(tmp_path, couple, monkeypatch):
    for step in range(1, 1000):
        out = tmp_path / f"m{step}"
        with monkeypatch.context() as patch:
            stop_at(patch, step)
            try:
                deal_team(out, couple, workers=1)
                break
            except Stop:
                pass
        before = {name: pem for name, pem in certificates(out).items()} if (out / ROOM).exists() else {}
        published = {path.parent.name: path.read_bytes() for path in out.rglob("record.json")}
        handed_out = [name for name in ("alice", "bob") if (out / name).exists()]
        for name in handed_out:
            Folder.open(out / name)  # complete from the moment that it is there
        try:
            deal_team(out, couple, workers=1)
        except FileExistsError as error:
            assert "was dealt into the robots' folders" in str(error) and handed_out == ["alice", "bob"]
        check_dealt(out, couple)
        assert before in ({}, certificates(out))
        for path in out.rglob("record.json"):
            assert published.get(path.parent.name, path.read_bytes()) == path.read_bytes()
        shutil.rmtree(out)
    assert 15 < step < 200
    check_dealt(out, couple)


@pytest.mark.usefixtures("quick_disk")
@pytest.mark.parametrize("seed", range(4))
def test_a_dealer_that_is_stopped_again_and_again_gets_there(tmp_path, mission, monkeypatch, seed):
    numbers = random.Random(seed)
    for _ in range(100):
        with monkeypatch.context() as patch:
            stop_at(patch, numbers.randrange(1, 120))
            try:
                deal_team(tmp_path / "m", mission, workers=1)
                break
            except Stop:
                pass
            except FileExistsError as error:
                assert "was dealt into the robots' folders" in str(error)
                break
    check_dealt(tmp_path / "m", mission)
    meet(tmp_path / "m", mission, ("alice", "carol"), "both", tmp_path)


def test_what_was_half_dealt_or_half_written_is_gone_before_a_dealer_goes_on(tmp_path, couple):
    room, task = begun(tmp_path, couple)
    (room.work / f"{task.key}.dead").mkdir()
    (room.work / f"{task.key}.dead" / ".0.tape.1234.partial").write_bytes(b"secret")
    (room.path / ".finished.json.1234.partial").touch()
    (room.out / f"{ROOM}.1234.partial" / "robots").mkdir(parents=True)
    begun(tmp_path, couple)
    assert list(tmp_path.rglob("*.partial")) == list(room.work.iterdir()) == []


DEAL = """
import pathlib, sys
from dealer.team.deal import deal_team
from protocols.mission import Mission
from mission_helpers import plan
folder = pathlib.Path(sys.argv[1])
print(flush=True)
deal_team(folder / "m", Mission.load(folder / "mission.toml"), workers=int(sys.argv[2]))
"""


def children(process):
    """Processes whose parent it is, from /proc."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == process:
                found.append(int(folder.name))
    return found


@pytest.mark.parametrize("workers", [1, 2])
def test_a_dealer_that_is_killed_goes_on(tmp_path, mission, workers):
    numbers, before = random.Random(workers), None
    for _ in range(4):
        process = run_python(DEAL, tmp_path, workers)
        process.stdout.readline()
        time.sleep(numbers.uniform(0, 0.4 if workers == 1 else 1.2))
        process.kill()
        process.communicate()
        if before is not None:
            assert certificates(tmp_path / "m") == before
        if (tmp_path / "m" / ROOM).exists():
            before = certificates(tmp_path / "m")
    with suppress(FileExistsError):
        deal_team(tmp_path / "m", mission, workers=workers)
    check_dealt(tmp_path / "m", mission)
    assert before is None or certificates(tmp_path / "m") == before


LARGE = COUPLE.replace("keyframes = 2", "keyframes = 1500").replace('"bob" }', '"bob" }, { name = "carol" }')


def until(condition, seconds=20):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def busy(tmp_path):
    """A dealer with two processes that would deal for a while, and which these are."""
    plan(tmp_path, LARGE)
    process = run_python(DEAL, tmp_path, 2, start_new_session=True)
    work = tmp_path / "m" / ROOM / "work"
    until(lambda: process.poll() is not None or (work.is_dir() and len(list(work.rglob("*.partial"))) == 4))
    workers = [pid for pid in children(process.pid) if "spawn_main" in command_line(pid)]
    assert len(workers) == 2, process.communicate()
    yield process, workers, work
    process.kill()
    for pid in workers:
        if "spawn_main" in command_line(pid):  # it should have ended by now
            os.kill(pid, signal.SIGKILL)
    process.communicate()


def command_line(pid):
    with suppress(OSError), open(f"/proc/{pid}/cmdline") as file:
        return file.read()
    return ""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_the_processes_of_a_dealer_that_is_killed_end_with_it(busy):
    process, workers, work = busy
    process.kill()
    until(lambda: not any("spawn_main" in command_line(pid) for pid in workers))
    assert len(list(work.iterdir())) == 2  # for the next run to remove


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_a_process_that_dies_stops_the_dealer_with_a_sentence_and_leaves_no_half_dealt_pair(busy):
    process, workers, work = busy
    os.kill(workers[0], signal.SIGKILL)
    _, told = process.communicate(timeout=30)
    assert "DealingStopped: a dealing process died" in told
    assert list(work.iterdir()) == []
    assert not any("spawn_main" in command_line(pid) for pid in workers)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
def test_ctrl_c_ends_the_dealer_at_once_and_leaves_no_half_dealt_pair(busy):
    process, workers, work = busy
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, told = process.communicate(timeout=30)
    assert told.rstrip().endswith("KeyboardInterrupt") and told.count("Traceback") == 1
    assert list(work.iterdir()) == []
    assert not any("spawn_main" in command_line(pid) for pid in workers)


# -- two at once ------------------------------------------------------------------------------------------


def begun(tmp_path, mission):
    """A room, and its only task."""
    with opened_room(tmp_path / "m", mission) as room:
        return room, tasks_of(mission)[0]


def words(room, task):
    return str(room.out), room.mission_id, task.couple, task.gallery


def test_of_two_that_deal_a_pair_at_once_one_is_published_and_both_return_it(tmp_path, couple, monkeypatch):
    room, task = begun(tmp_path, couple)
    both, publish, dealt, records = threading.Barrier(2), pair._publish, [], []

    def together(work, target):
        dealt.append(Record.read(work))
        both.wait(timeout=20)
        publish(work, target)

    monkeypatch.setattr(pair, "_publish", together)
    threads = [threading.Thread(target=lambda: records.append(deal_pair(*words(room, task)))) for _ in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert dealt[0] != dealt[1]
    assert records[0] == records[1] == room.record(task) and records[0] in dealt
    assert [read_header(room.pair(task) / half).tape for half in HALVES] == [records[0].tape] * 2
    assert list(room.work.iterdir()) == []


def test_a_worker_that_was_thought_dead_changes_nothing_when_it_comes_back(tmp_path, couple, monkeypatch):
    room, task = begun(tmp_path, couple)
    publish, late, records = pair._publish, threading.Event(), []
    paused = threading.Event()

    def pause(work, target):
        paused.set()
        assert late.wait(timeout=30)
        publish(work, target)

    def come_back():
        try:
            records.append(deal_pair(*words(room, task)))
        except OSError as error:
            records.append(error)

    with monkeypatch.context() as patch:
        patch.setattr(pair, "_publish", pause)
        thread = threading.Thread(target=come_back)
        thread.start()
        assert paused.wait(timeout=30)
    deal_team(tmp_path / "m", couple, workers=1)  # removes what is half dealt, as after a stop
    late.set()
    thread.join()
    assert isinstance(records[0], OSError) or records[0] == room.record(task)
    check_dealt(tmp_path / "m", couple)


def test_a_worker_that_comes_back_while_tapes_are_handed_out_changes_nothing(tmp_path, couple, monkeypatch):
    room, task = begun(tmp_path, couple)
    deal_pair(*words(room, task))
    late = room.work / f"{task.key}.late"
    late.mkdir(mode=0o700)
    for half in HALVES:
        (late / half).write_bytes(b"another dealing")
    rename, moved = os.rename, []

    def and_publish(source, target):
        rename(source, target)
        moved.append(target)
        with suppress(OSError):
            rename(late, room.pair(task))

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", and_publish)
        deal_team(tmp_path / "m", couple, workers=1)
    assert len(moved) == 4
    check_dealt(tmp_path / "m", couple)


def test_a_pair_that_is_dealt_is_not_dealt_again(tmp_path, couple, monkeypatch):
    room, task = begun(tmp_path, couple)
    record = deal_pair(*words(room, task))
    monkeypatch.setattr(pair, "deal_gallery", None)
    assert deal_pair(*words(room, task)) == record


def test_a_second_dealer_is_refused_while_the_first_is_at_work(tmp_path, couple):
    with opened_room(tmp_path / "m", couple):
        with pytest.raises(ValueError, match="another dealer is at work"):
            deal_team(tmp_path / "m", couple, workers=1)
    deal_team(tmp_path / "m", couple, workers=1)


# -- what is refused --------------------------------------------------------------------------------------


def test_a_finished_mission_is_never_dealt_again_wherever_its_folders_are_now(tmp_path, couple):
    deal_team(tmp_path / "m", couple, workers=1)
    for name in ("alice", "bob"):
        with pytest.raises(
            FileExistsError, match="was dealt into the robots' folders, and is never dealt again"
        ):
            deal_team(tmp_path / "m", couple, workers=1)
        shutil.move(tmp_path / "m" / name, tmp_path / name)
    Folder.open(tmp_path / "bob")


@pytest.mark.parametrize(
    ("before", "after", "field"),
    [
        ("threshold = 0.5", "threshold = 0.6", "descriptors.lidar.threshold"),
        ("keyframes = 2", "keyframes = 3", "descriptors.lidar.keyframes.alice"),
        ('name = "bob"', 'name = "eve"', "pairs"),
        ("agents", 'name = "x"\nagents', "name"),
    ],
)
def test_another_plan_is_refused_with_the_field_that_differs(tmp_path, couple, before, after, field):
    begun(tmp_path, couple)
    with pytest.raises(ValueError, match=f"another plan's mission .*they differ in {field}\\)"):
        deal_team(tmp_path / "m", plan(tmp_path, COUPLE.replace(before, after)), workers=1)
    deal_team(tmp_path / "m", couple, workers=1)


def test_a_folder_in_a_robots_place_is_never_touched(tmp_path, couple):
    (tmp_path / "m" / "bob").mkdir(parents=True)
    with pytest.raises(FileExistsError, match=r"bob exists; dealt material is never overwritten"):
        deal_team(tmp_path / "m", couple, workers=1)
    assert {path.name for path in (tmp_path / "m").iterdir()} == {"bob", f"{ROOM}.lock"}


def test_a_folder_that_comes_into_a_robots_place_is_never_touched(tmp_path, couple):
    begun(tmp_path, couple)
    (tmp_path / "m" / "bob").mkdir()
    with pytest.raises(FileExistsError, match=r"bob exists; .* move it away and go on"):
        deal_team(tmp_path / "m", couple, workers=1)
    (tmp_path / "m" / "bob").rmdir()
    deal_team(tmp_path / "m", couple, workers=1)
    check_dealt(tmp_path / "m", couple)


def test_halves_of_two_dealings_are_never_handed_out(tmp_path, couple):
    rooms = [begun(tmp_path / name, couple) for name in "ab"]
    for room, task in rooms:
        deal_pair(*words(room, task))
    (room, task), (other, _) = rooms
    shutil.copy(other.pair(task) / HALVES[1], room.pair(task) / HALVES[1])
    with pytest.raises(ValueError, match="is not what was dealt"):
        deal_team(room.out, couple, workers=1)
    assert {path.name for path in room.out.iterdir()} == {ROOM, f"{ROOM}.lock"}


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda folder: (folder / "record.json").write_text("{"), "record.json is damaged"),
        (lambda folder: (folder / "record.json").write_text('{"tape": 3}'), "record.json is damaged"),
        (lambda folder: (folder / HALVES[0]).unlink(), "is of no use any more"),
        (lambda folder: (folder / HALVES[0]).write_bytes(b"x" * 100), "is of no use any more"),
    ],
)
def test_damage_to_what_was_dealt_is_told(tmp_path, couple, damage, says):
    room, task = begun(tmp_path, couple)
    deal_pair(*words(room, task))
    damage(room.pair(task))
    with pytest.raises(ValueError, match=says):
        deal_team(tmp_path / "m", couple, workers=1)


def test_workers_of_another_version_or_without_the_folder_are_refused(tmp_path, couple):
    room, task = begun(tmp_path, couple)
    with pytest.raises(ValueError, match=r"the dealer is spdz 9.9 and this worker|spdz 9.9, this worker"):
        deal_pair(*words(room, task), "9.9")
    with pytest.raises(FileNotFoundError, match="all need the same folder"):
        deal_pair(str(tmp_path), *words(room, task)[1:])
    with pytest.raises(ValueError, match="holds another mission"):
        deal_pair(str(room.out), "0" * 32, task.couple, task.gallery)


def test_a_full_disk_and_too_little_memory_are_told_before_anything_is_written(tmp_path, couple, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(folders.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**6, 0, 10))
        with pytest.raises(ValueError, match=r"the tapes would take .* and 10 bytes are free"):
            deal_team(tmp_path / "m", couple, workers=1)
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available_memory", lambda: 10**7)
        with pytest.raises(ValueError, match="give fewer --workers"):
            deal_team(tmp_path / "m", couple, workers=1)
    assert not (tmp_path / "m").exists()


def test_what_no_tape_holds_is_refused_by_the_gallerys_name(tmp_path):
    mission = plan(tmp_path, COUPLE.replace('"S10", dim = 3', '"S2", dim = 5000'))
    with pytest.raises(ValueError, match="lidar: a pair of descriptors would take"):
        deal_team(tmp_path / "m", mission, workers=1)
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize("name", ["mission.toml", "mission.toml/m"])
def test_a_file_in_the_folders_place_is_told(tmp_path, couple, name):
    with pytest.raises(NotADirectoryError, match="choose"):
        deal_team(tmp_path / name, couple, workers=1)


def test_workers_are_as_many_as_there_are_cores_and_memory_for(monkeypatch):
    monkeypatch.setattr(deal, "cores", lambda: 8)
    monkeypatch.setattr(deal, "available_memory", lambda: 1000)
    assert [deal.workers_for(size, 10**6) for size in (1, 125, 300, 5000)] == [8, 8, 3, 1]
    assert deal.workers_for(1, 100) == 1  # others would come too late
    assert here.cores() >= 1


# -- the command ------------------------------------------------------------------------------------------


def test_the_command_deals_a_plan_and_goes_on(tmp_path, couple, capsys):
    room, task = begun(tmp_path, couple)
    deal_pair(*words(room, task))
    command = [str(tmp_path / "mission.toml"), "--out", str(tmp_path / "m")]
    assert cli.main([*command, "--workers", "1"]) == 0
    told = capsys.readouterr()
    assert "dealt 1 gallery for 1 pair of robots" in told.out and "keep no other copy" in told.out
    assert "1 of 1 gallery had been dealt before" in told.err
    check_dealt(tmp_path / "m", couple)
    assert cli.main(command) == 2
    assert "never dealt again" in capsys.readouterr().err


def test_the_command_tells_a_broken_plan_by_its_line(tmp_path, capsys):
    plan(tmp_path, COUPLE)
    path = tmp_path / "mission.toml"
    path.write_text(COUPLE.replace("dim = 3", "dim = -3"))
    assert cli.main([str(path), "--plan"]) == 2
    told = capsys.readouterr()
    assert f"{path}:3: descriptors.lidar.dim: expected a whole number" in told.err and told.out == ""
    assert cli.main([str(path), "--plan", "--json"]) == 2
    assert '"error": "PlanError"' in capsys.readouterr().out


def test_who_interrupts_the_command_is_told_how_to_go_on(tmp_path, couple, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(deal, "deal_here", interrupted)
    assert cli.main([str(tmp_path / "mission.toml"), "--out", str(tmp_path / "m")]) == 130
    assert "give the same command to go on" in capsys.readouterr().err


def test_a_lost_process_is_a_failure_and_no_mistake_of_the_user(tmp_path, couple, capsys, monkeypatch):
    def lost(*arguments, **options):
        raise DealingStopped("a dealing process died")

    monkeypatch.setattr(deal, "deal_here", lost)
    assert cli.main([str(tmp_path / "mission.toml"), "--out", str(tmp_path / "m"), "--json"]) == 1
    assert '"error": "DealingStopped"' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mission.toml", "say where to write with --out DIR, or ask for a --plan"),
        ("mission.toml --out m --score S10", "--score does not go with a plan"),
        ("mission.toml --out m --security semi-honest", "--security does not go with a plan"),
        ("mission.toml --plan --spare 0", "--spare does not go with a plan"),
        ("mission.toml --out m --tls-key key.pem", "give --scheduler as well"),
        ("--agents a b --score S10 --dim 3 --slots 2x2 --plan --workers 2", "--workers goes with a plan"),
        ("--agents a b --score S10 --slots 2x2 --plan", "--dim; or a mission.toml instead"),
        (
            "--agents a b --score S10 --dim 3 --plan",
            "one of the arguments --count --maps --slots",
        ),
        ("--plan", "required: --agents, --score, --dim"),
    ],
)
def test_options_that_do_not_go_together_are_told(capsys, text, says):
    assert cli.main(text.split()) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize("workers", ["0", "-1"])
def test_no_workers_are_refused(tmp_path, couple, capsys, workers):
    for what in ("--plan", f"--out={tmp_path / 'm'}"):
        assert cli.main([str(tmp_path / "mission.toml"), what, "--workers", workers]) == 2
        told = capsys.readouterr()
        assert "at least one worker" in told.err and told.out == ""
    with pytest.raises(ValueError, match="at least one worker"):
        deal_team(tmp_path / "m", couple, workers=int(workers))


def test_plans_that_will_disappoint_come_with_a_note(tmp_path, capsys):
    text = COUPLE.replace('"S10", dim = 3, threshold = 0.5', '"S6", dim = 3, threshold = 2.5')
    plan(tmp_path, text)
    assert cli.main([str(tmp_path / "mission.toml"), "--plan"]) == 0
    told = capsys.readouterr().err
    assert "note: lidar: the threshold 2.5 lets descriptors match that have nothing in common" in told
    assert "note: lidar: a short vector is near to all in S6" in told
