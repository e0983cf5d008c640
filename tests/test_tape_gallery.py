"""``python -m spdz tape`` on a gallery: it shows what there is, disturbs nobody and tells no secret."""

import json
import shutil
import sqlite3
import threading

import numpy as np
import pytest
from link_helpers import Link
from stream_helpers import deal, fresh, robots, stream, tape
from tape_gallery_helpers import begun, facts, ledger, opened, show

from spdz.__main__ import main
from spdz.foundations.errors import TapeDestroyed
from spdz.gallery.status import gallery_status

pytestmark = pytest.mark.usefixtures("quick_disk")

RULE = "S10 >= 0.2, to 2^-16"


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def test_a_gallery_that_nobody_has_used(mission, capsys):
    answer = facts(capsys, mission)
    wanted = {"robot": "alice", "peer": "bob", "agents": ["alice", "bob"], "score": "S10", "dim": 4}
    wanted |= {"security": "malicious", "resolution": "2^-16", "slots": [8, 6], "capacity": [8, 6]}
    wanted |= {"slots_used": [0, 0], "slots_void": [0, 0], "slots_left": [8, 6], "pairs_used": 0}
    wanted |= {"pairs_burnt": 0, "pinned": None, "in_flight": None, "ledger": False, "verified": False}
    wanted |= {"in_use": False, "destroyed": False, "rolled_back": False}
    assert wanted.items() <= answer.items()
    assert answer["bytes"] == tape(mission, 0).stat().st_size and len(answer["tape"]) == 12
    status, out, err = show(capsys, mission)
    assert (status, err) == (0, "")
    for part in (
        "alice, to compare with bob (pair alice bob)",
        "a gallery, S10",
        "4-D descriptors of norm at most 1; opens the candidate bit alone (resolution 2^-16), malicious",
        "of alice: 8 of 8 left, 0 used\n",
        "of bob: 6 of 6 left, 0 used\n",
        "0 of 48 used\n",
        "nothing yet: the first threshold",
        "state     unused\n",
        "no record (--verify)",
        "--slots RxC --out FOLDER",
    ):
        assert part in out, part
    assert not (mission / "state-0").exists() and not tape(mission, 0).with_suffix(".ledger").exists()


def test_what_was_used_is_the_same_on_both_sides(mission, capsys):
    robots(mission, Link(), stream)
    for party in (0, 1):
        answer = facts(capsys, mission, party=party)
        assert answer["slots_used"] == [6, 4] and answer["slots_left"] == [2, 2]
        assert (answer["pairs_used"], answer["pairs_burnt"], answer["pinned"]) == (24, 0, RULE)
        out = show(capsys, mission, party=party)[1]
        assert (
            "24 of 48 used\n" in out
            and "state     ready" in out
            and f"{RULE}, and never anything else" in out
        )


def test_void_slots_burnt_pairs_and_a_strip_in_flight_are_told(mission, capsys):
    begun(mission)
    answer = facts(capsys, mission)
    wanted = {"slots_used": [3, 2], "slots_void": [1, 0], "slots_left": [5, 4], "pairs_used": 4}
    wanted |= {"pairs_burnt": 2, "pinned": RULE, "in_flight": [2, 3, 0, 2], "ledger": True}
    assert wanted.items() <= answer.items()
    out = show(capsys, mission)[1]
    assert "5 of 8 left, 3 used, 1 of them hold nothing" in out
    assert "4 of 48 used, 2 of them given up without a result" in out
    assert "interrupted in rows 2 to 2 x columns 0 to 1: run match again, it goes on where it was" in out


def test_nothing_is_written_and_no_secret_is_shown(mission, capsys):
    robots(mission, Link(), stream)
    with opened(mission) as one:
        secrets = [one.alpha, *one._table._keys.values()]
    files = [path for path in mission.rglob("*") if path.is_file()]
    before = [(path, path.read_bytes(), path.stat().st_mtime_ns) for path in files]
    shown = show(capsys, mission, "--verify")[1] + show(capsys, mission, "--json")[1]
    shown += repr(gallery_status(tape(mission, 0), mission / "state-0"))
    assert [(path, path.read_bytes(), path.stat().st_mtime_ns) for path in files] == before
    assert sorted(path for path in mission.rglob("*") if path.is_file()) == sorted(files)
    for secret in secrets:
        assert secret.hex() not in shown and str(int.from_bytes(secret, "little")) not in shown
        assert repr(secret)[2:-1] not in shown


def test_a_gallery_in_use_is_shown_while_its_robots_step(mission, capsys):
    """The robots wait in a step for each look."""
    looks = []

    def work(one, party):
        if party == 0:
            one._on_block = lambda block: looks.append(gallery_status(tape(mission, 0), mission / "state-0"))
        return stream(one, party)

    results = robots(mission, Link(timeout=20.0), work)
    assert not any(isinstance(result, Exception) for result in results)
    assert len(looks) > 2 and all(look.in_use and not look.rolled_back for look in looks)
    assert [look.done for look in looks] == sorted(look.done for look in looks)
    assert looks[-1].done == (6, 4) and facts(capsys, mission)["in_use"] is False


def test_looking_never_fails_and_never_keeps_a_robot_from_writing(mission):
    stop, seen, errors = threading.Event(), [], []

    def look():
        while not stop.is_set():
            try:
                seen.append(gallery_status(tape(mission, 0), mission / "state-0"))
            except Exception as error:
                errors.append(error)

    looking = [threading.Thread(target=look) for _ in range(2)]
    for thread in looking:
        thread.start()
    try:
        results = robots(mission, Link(timeout=20.0), stream)
    finally:
        stop.set()
        for thread in looking:
            thread.join()
    assert errors == [] and len(seen) > 10
    assert not any(isinstance(result, Exception) for result in results), results


def test_a_ledger_that_was_copied_back_or_lost_is_told(mission, capsys):
    path = tape(mission, 0).with_suffix(".ledger")
    with ledger(mission) as one:
        one.slots[0].fill([(0, b"a")])
    shutil.copy(path, path.with_suffix(".old"))
    begun_after = [(1, b"b"), (2, b"c")]
    with ledger(mission) as one:
        one.slots[0].fill(begun_after)
    assert facts(capsys, mission)["rolled_back"] is False
    path.with_suffix(".old").replace(path)
    for _ in range(2):
        answer = facts(capsys, mission)
        assert answer["rolled_back"] and answer["slots_used"] == [3, 0]
        assert "older copy of itself" in show(capsys, mission)[1]
        path.unlink(missing_ok=True)


def test_a_ledger_without_a_mark_is_believed(mission, capsys):
    begun(mission)
    shutil.rmtree(mission / "state-0")
    answer = facts(capsys, mission)
    assert (answer["slots_used"], answer["rolled_back"]) == ([3, 2], False)


def test_a_commit_that_was_cut_off_is_left_to_the_robot(mission, capsys):
    """A journal that SQLite would have to play back: reading alone cannot."""
    begun(mission)
    path = tape(mission, 0).with_suffix(".ledger")
    base = sqlite3.connect(path, isolation_level=None)
    for words in ("PRAGMA journal_mode=TRUNCATE", "PRAGMA cache_size=1", "BEGIN IMMEDIATE"):
        base.execute(words)
    base.execute("UPDATE slots SET eps = ?", [bytes(100_000)])  # more than the cache: it is written out
    copies = {one: one.read_bytes() for one in (path, path.with_name(path.name + "-journal"))}
    base.execute("ROLLBACK")
    base.close()
    for one, content in copies.items():
        one.write_bytes(content)
    answer = facts(capsys, mission)
    assert (answer["pairs_burnt"], answer["slots_used"], answer["rolled_back"]) == (None, [3, 2], False)
    out = show(capsys, mission)[1]
    assert "stopped while it wrote" in out and "given up is not known" in out
    assert path.read_bytes() == copies[path]
    with ledger(mission) as one:
        assert one.slots[0].filled == 3
    assert facts(capsys, mission)["pairs_burnt"] == 2


def test_a_ledger_just_made_is_no_error(mission, capsys):
    tape(mission, 0).with_suffix(".ledger").touch()
    assert facts(capsys, mission)["ledger"] is False


def test_a_destroyed_gallery_and_its_copies_have_nothing_left(mission, capsys, tmp_path):
    copy = fresh(mission, tmp_path / "copy")
    with opened(mission) as one:
        one.destroy()
    for where in (tape(mission, 0), tape(copy, 0)):
        assert main(["tape", "--json", str(where), "--state-dir", str(mission / "state-0"), "--verify"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert answer["destroyed"] and answer["slots_left"] == [0, 0]
    assert "destroyed after a failed MAC check" in show(capsys, mission)[1]
    with pytest.raises(TapeDestroyed):
        opened(mission)


def test_a_full_gallery_says_so(mission, capsys):
    with ledger(mission) as one:
        one.slots[0].fill([(slot, b"a") for slot in range(8)])
    assert "every own slot is used" in show(capsys, mission)[1]


def test_folders_show_galleries_and_jobs(mission, capsys):
    assert main(["tape", "--json", str(mission)]) == 0
    robots_seen = [json.loads(line)["robot"] for line in capsys.readouterr().out.splitlines()]
    assert robots_seen == ["alice", "bob"]


def test_a_gallery_of_a_program_of_ones_own_is_shown_without_a_purpose(tmp_path, capsys):
    from dealer.gallery import deal_gallery
    from protocols.catalog import GalleryPurpose

    paths = tmp_path / "bob.tape", tmp_path / "alice.tape"
    terms = GalleryPurpose("S10", 4).dealt_terms("semi-honest")
    deal_gallery(paths, ("alice", "bob"), terms, (2, 2), description={"mine": "\x1b[2J", "n": 3})
    assert main(["tape", "--state-dir", str(tmp_path), str(paths[0])]) == 0
    out = capsys.readouterr().out
    assert "a gallery, a program of your own, semi-honest" in out and "deal more" not in out
    assert main(["tape", "--json", "--state-dir", str(tmp_path), str(paths[0])]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["program"]["n"] == 3 and "dealer_command" not in answer
    assert np.isscalar(answer["bytes"])
