"""Room for meetings and interruptions: what one costs, what is dealt for it, and what the dealer says."""

import json
from pathlib import Path

import link_helpers
import pytest
from link_helpers import DIM, Cut, Link, mission, robots, unit

from dealer import cli
from dealer.plan import TilePlan, pick, plan_maps, plan_tile
from protocols import batching
from protocols.catalog import Purpose
from spdz import TapeExhausted
from spdz.tape import tape_status

AGENTS = ("alice", "bob")
MAPS = (4, 6)
PURPOSE = Purpose("S10", DIM, tile=(2, 1), max_norm=1.0)
JOBS, TOGETHER = 12, 3


class LateNews(Cut):
    """A link whose sender still gets what was on its way to it when it broke."""

    def put(self, piece):
        if self.left <= 0:
            return
        if piece is None or len(piece) >= self.left:
            if piece:
                self.there.put(piece[: self.left])
            self.left = 0
            self.there.put(None)
        else:
            self.left -= len(piece)
            self.there.put(piece)


@pytest.fixture(autouse=True)
def _several_runs_and_quick_disk(monkeypatch):
    monkeypatch.setattr("spdz.tape.durable.os.fsync", lambda descriptor: None)
    monkeypatch.setattr(batching, "MOST_JOBS", TOGETHER)
    monkeypatch.setattr(link_helpers, "Cut", LateNews)


def meet(one, party):
    return one.match(unit(party, MAPS[party])).complete


def bytes_sent(one):
    return one._session._channel.bytes_sent


def lost_jobs(folder):
    """Jobs that a break of the link cost: by sender and by the byte at which it broke."""
    paths = mission(folder / "m", 12_000, tile=PURPOSE.tile)
    ends = robots(folder, paths, Link(), lambda one, party: (meet(one, party), bytes_sent(one))[1])
    left, lost = 6_000 - JOBS, {}
    for sender in (0, 1):
        for limit in range(500, ends[sender], 24):
            assert robots(folder, paths, Link([(sender, limit)]), meet) == [True, True]
            now = min(tape_status(path, folder / f"state-{k}").left for k, path in enumerate(paths))
            left, lost[sender, limit] = now, left - now - JOBS
    return lost


def words(folder, *more):
    fixed = f"--agents alice bob --score S10 --dim {DIM} --tile 2x1 --max-norm 1 --maps {MAPS[0]}x{MAPS[1]}"
    return [*fixed.split(), "--quiet", "--out", str(folder), *more]


def test_an_interruption_costs_what_the_plan_says_and_the_room_for_one_is_enough_for_it(tmp_path, capsys):
    lost = lost_jobs(tmp_path / "sweep")
    plan = plan_tile(AGENTS, PURPOSE, JOBS, MAPS, "malicious", interruptions=1)
    assert max(lost.values()) == plan.lost_jobs == plan.spare_jobs == 2 * TOGETHER
    worst = max(lost, key=lost.__getitem__)
    for spare in ("0", "1"):
        folder = tmp_path / spare
        assert cli.main(words(folder / "m", "--spare", spare)) == 0
        paths = folder / "m" / "alice" / "bob.tape", folder / "m" / "bob" / "alice.tape"
        results = robots(folder, paths, Link([worst]), meet)
        if spare == "1":
            assert results == [True, True]
        else:
            assert all(isinstance(error, TapeExhausted) for error in results)
    capsys.readouterr()


@pytest.mark.parametrize(("jobs", "lost"), [(1, 1), (TOGETHER, TOGETHER), (5, 5), (6, 6), (100, 6)])
def test_no_interruption_costs_more_than_the_whole_meeting(jobs, lost):
    assert plan_tile(AGENTS, PURPOSE, jobs, None, "malicious").lost_jobs == lost


def test_jobs_dealt_are_those_of_all_meetings_and_the_spare_ones():
    once = plan_tile(AGENTS, PURPOSE, JOBS, MAPS, "malicious")
    often = plan_tile(AGENTS, PURPOSE, JOBS, MAPS, "malicious", meetings=5, interruptions=2)
    assert (once.jobs, once.meeting_jobs, once.spare_jobs) == (JOBS, JOBS, 0)
    assert (often.jobs, often.meeting_jobs, often.spare_jobs) == (5 * JOBS + 12, JOBS, 12)
    assert often.comparisons == often.jobs * PURPOSE.pairs
    assert min(often.tape_bytes) > 4 * min(once.tape_bytes) / 2
    for name in ("rounds", "bytes_sent", "link_seconds", "matching_memory"):  # of one meeting
        assert getattr(often, name) == getattr(once, name)


@pytest.mark.parametrize(
    ("more", "jobs", "spare"),
    [
        ((), 12 + 18, 18),
        (("--spare", "0"), 12, 0),
        (("--meetings", "4", "--spare", "1"), 48 + 6, 6),
    ],
)
def test_maps_are_dealt_with_room_for_three_interruptions_unless_told_otherwise(
    tmp_path, capsys, more, jobs, spare
):
    assert cli.main(words(tmp_path / "m", *more, "--plan", "--json")) == 0
    planned = json.loads(capsys.readouterr().out)
    assert cli.main(words(tmp_path / "m", *more, "--json")) == 0
    dealt = json.loads(capsys.readouterr().out)
    for told in (planned, dealt):
        assert (told["jobs"], told["spare_jobs"]) == (jobs, spare)
    tape = tmp_path / "m" / "alice" / "bob.tape"
    assert tape_status(tape).left == jobs and tape.stat().st_size == planned["tape_bytes"][0]


def test_a_count_is_dealt_exactly_unless_spare_jobs_are_asked_for(tmp_path, capsys):
    count = f"--agents alice bob --score S10 --dim {DIM} --max-norm 1 --count 20 --quiet --json".split()
    assert cli.main([*count, "--out", str(tmp_path / "a")]) == 0
    assert cli.main([*count, "--out", str(tmp_path / "b"), "--spare", "2"]) == 0
    exact, more = map(json.loads, capsys.readouterr().out.splitlines())
    assert (exact["jobs"], exact["spare_jobs"], exact["meetings"]) == (20, 0, None)
    assert (more["jobs"], more["spare_jobs"]) == (20 + 12, 12)


@pytest.mark.parametrize("plan", [True, False])
def test_the_note_says_whose_map_is_which_and_what_the_tapes_suffice_for(tmp_path, capsys, plan):
    assert cli.main(words(tmp_path / "m", "--meetings", "2", *["--plan"] * plan)) == 0
    shown = capsys.readouterr().out
    assert "2 meetings of at most 4 of alice x 6 of bob descriptors" in shown
    assert "up to 3 interruptions in all" in shown and "up to 6 jobs; 18 spare" in shown
    assert "a larger map costs a whole row of tiles" in shown


def test_the_note_names_every_couple_of_a_few_robots_and_says_how_to_get_spare_jobs(tmp_path, capsys):
    few = words(tmp_path / "m", "--plan", "--spare", "0")
    few[1:3] = ["alice", "bob", "carol"]
    assert cli.main(few) == 0
    shown = capsys.readouterr().out
    assert "4 of alice x 6 of bob, 4 of alice x 6 of carol, 4 of bob x 6 of carol descriptors" in shown
    assert "no interruption" in shown and "--spare S" in shown
    few[1:4] = ["a", "b", "c", "d"]
    assert cli.main(few) == 0
    assert "4 of a x 6 of d descriptors (and so on for the other pairs)" in capsys.readouterr().out


def test_a_tile_of_which_an_interruption_costs_everything_is_no_quicker_for_the_pick(monkeypatch):
    monkeypatch.setattr(batching, "MOST_JOBS", 64)
    plans = plan_maps(AGENTS, Purpose("S10", 1200, max_norm=1.0), (40, 500), "malicious", interruptions=3)
    picked, why = pick(plans)
    by_tile = {p.tile: p for p in plans if isinstance(p, TilePlan)}
    larger = by_tile[40, 500]
    assert larger.lost_jobs == larger.meeting_jobs and picked.lost_jobs < picked.meeting_jobs
    assert picked.link_seconds > 1.3 * larger.link_seconds  # so that without interruptions it would lose
    assert picked.interrupted_seconds < 1.05 * larger.interrupted_seconds
    assert sum(picked.tape_bytes) < sum(larger.tape_bytes) and "interruption included" in why


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--meetings", "0"), "at least one meeting"),
        (("--spare", "-1"), "fewer than 0"),
        (("--spare", "many"), "--spare"),
        (("--spare", "99999999999"), "more than a tape can have"),
    ],
)
def test_senseless_room_is_refused(tmp_path, capsys, more, says):
    assert cli.main(words(tmp_path / "m", *more)) == 2
    assert says in capsys.readouterr().err and list(tmp_path.iterdir()) == []


def test_meetings_without_maps_are_refused(tmp_path, capsys):
    given = f"--agents alice bob --score S10 --dim {DIM} --count 3 --meetings 2 --plan".split()
    assert cli.main(given) == 2
    assert "give --maps, or a larger --count" in capsys.readouterr().err


@pytest.mark.parametrize("below", ["", "deep/er"])
def test_a_file_in_the_place_of_the_folder_is_refused_in_words(tmp_path, capsys, below):
    (tmp_path / "a.npy").write_bytes(b"mine")
    assert cli.main(words(tmp_path / "a.npy" / below)) == 2
    told = capsys.readouterr().err
    assert "a.npy is not a folder" in told and "Errno" not in told
    assert (tmp_path / "a.npy").read_bytes() == b"mine"


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="there is no /proc")
def test_a_folder_that_cannot_be_made_is_told_in_words(capsys):
    assert cli.main(words("/proc/mission")) == 2
    told = capsys.readouterr().err
    assert "the folder /proc/mission cannot be made" in told and "--out" in told and "Errno" not in told


def test_what_the_system_says_of_a_file_is_told_without_its_number(tmp_path, capsys, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device", str(tmp_path / "m"))

    monkeypatch.setattr(cli, "deal_mission", full)
    assert cli.main(words(tmp_path / "m")) == 2
    told = capsys.readouterr().err
    assert f"{tmp_path / 'm'}: No space left on device" in told and "Errno" not in told


def test_the_dealer_tells_its_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("spdz ")
