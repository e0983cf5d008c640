"""The dealer's plans: what they foresee is what dealing and matching then cost."""

import json

import numpy as np
import pytest
from session_helpers import run_pair, state_dirs

from dealer import cli, options, plan
from dealer.mission import deal_mission, mission_bytes
from dealer.plan import Impossible, TilePlan, candidate_tiles, jobs_for, pick, plan_maps, plan_tile
from protocols import batching, memory
from protocols.catalog import Purpose
from protocols.matching import match
from spdz.console.command import CommandParser

AGENTS = ("alice", "bob")


def rows(seed, count, dim):
    vectors = np.random.default_rng(seed).standard_normal((count, dim))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def words(text, *more):
    return [*f"--agents alice bob --score S10 --dim 8 --max-norm 1 {text}".split(), *map(str, more)]


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize(
    ("purpose", "maps"),
    [
        (Purpose("S10", 5, max_norm=1.0), (9, 8)),  # 72 jobs: more than a batch
        (Purpose("S10", 5, tile=(2, 3), max_norm=1.0), (5, 7)),
        (Purpose("S6", 5, tile=(3, 2), reveal="score"), (4, 4)),
        (Purpose("S10", 4, tile=(1, 3), max_norm=2.0**13), (3, 4)),  # words of 63 bits, and elements
        (Purpose("S2", 4, tile=(2, 2), max_norm=1.0), (4, 3)),
        (Purpose("S4", 4, tile=(1, 3), max_norm=1.0), (2, 3)),
        (Purpose("S7", 4, tile=(2, 1), max_norm=1.0), (3, 2)),
    ],
    ids=lambda value: value.score if isinstance(value, Purpose) else None,
)
def test_jobs_bytes_and_rounds_are_what_the_plan_says(tmp_path, purpose, maps, security):
    jobs = jobs_for(maps, purpose.tile)
    foreseen = plan_tile(AGENTS, purpose, jobs, maps, security)
    deal_mission(tmp_path / "m", AGENTS, purpose, foreseen.comparisons, security)
    paths = tmp_path / "m" / "alice" / "bob.tape", tmp_path / "m" / "bob" / "alice.tape"
    sizes = tuple(path.stat().st_size for path in paths)
    assert foreseen.tape_bytes == sizes
    assert mission_bytes(AGENTS, purpose, foreseen.comparisons, security) == sum(sizes)
    own = [rows(party, maps[party], purpose.dim) for party in (0, 1)]
    threshold = 0.5 if purpose.reveal == "bit" else None
    done = run_pair(
        paths, state_dirs(tmp_path), lambda session: match(session, own[session.party], threshold)
    )
    assert [matches.jobs for matches in done] == [foreseen.meeting_jobs] * 2
    assert tuple(matches.stats.bytes_sent for matches in done) == foreseen.bytes_sent
    assert [matches.stats.rounds for matches in done] == [foreseen.rounds] * 2


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_both_kinds_of_masks_and_several_batches_were_among_these(security):
    """Words of 48 bits, 6 bytes, and elements of 16."""
    short = plan_tile(AGENTS, Purpose("S10", 5, max_norm=1.0), 72, (9, 8), security)
    long = plan_tile(AGENTS, Purpose("S10", 5), 72, (9, 8), security)
    assert short.bytes_sent[0] == long.bytes_sent[0] - 72 * 5 * (16 - 6)
    assert short.together == batching.MOST_JOBS < short.jobs


@pytest.mark.parametrize(
    ("tile", "dim", "dealt", "together"),
    [
        ((1, 1), 4, (10, 10), 64),
        ((1, 1), 4, (0, 0), 64),
        ((2, 100), 128, (10, 10), 10),
        ((100, 2), 128, (10, 10), 10),
        ((1, 1), 4, (10, 20 << 20), 3),
        ((4000, 1), 8192, (10, 10), 1),
    ],
)
def test_jobs_share_rounds_up_to_three_limits(tile, dim, dealt, together):
    assert batching.jobs_together(tile, dim, dealt) == together


@pytest.mark.parametrize("maps", [(1, 1), (1, 100), (7, 5), (200, 300), (129, 3)])
def test_candidates_differ_fit_the_maps_and_waste_little(maps):
    tiles = candidate_tiles(maps)
    assert len(set(tiles)) == len(tiles) and (1, 1) in tiles and maps in tiles
    for tile in tiles:
        assert tile[0] <= maps[0] and tile[1] <= maps[1]
        blocks = [-(-size // side) for size, side in zip(maps, tile, strict=True)]
        assert all(n * side - size < n for n, side, size in zip(blocks, tile, maps, strict=True))


@pytest.mark.parametrize(("score", "maps"), [("S2", (200, 300)), ("S10", (400, 600))])
def test_the_picked_tile_keeps_jobs_small_and_the_link_quick(score, maps):
    plans = plan_maps(AGENTS, Purpose(score, 1200, max_norm=1.0), maps, "malicious")
    picked, why = pick(plans)
    assert picked in plans and "link" in why
    assert picked.job_bytes <= batching.DEALT_BYTES and picked.matching_memory <= plan.ROBOT_MEMORY
    alike = [
        p
        for p in plans
        if isinstance(p, TilePlan)
        and p.job_bytes <= batching.DEALT_BYTES
        and p.matching_memory <= plan.ROBOT_MEMORY
    ]
    assert picked.interrupted_seconds <= 1.05 * min(p.interrupted_seconds for p in alike)
    assert picked.tile != (1, 1) and any(p.job_bytes > batching.DEALT_BYTES for p in plans if p not in alike)


def test_what_does_not_fit_a_frame_or_the_memory_is_impossible_with_its_reason(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 10**9)
    plans = plan_maps(AGENTS, Purpose("S10", 8192, max_norm=1.0), (3000, 3000), "malicious")
    reasons = {p.tile: p.reason for p in plans if isinstance(p, Impossible)}
    assert "frame" in reasons[(3000, 3000)]
    assert any("1 GB are available" in reason for reason in reasons.values())
    assert isinstance(pick(plans)[0], TilePlan)
    monkeypatch.setattr(memory, "available_memory", lambda: 1000)
    with pytest.raises(ValueError, match="needs about"):
        plan_maps(AGENTS, Purpose("S10", 8, max_norm=1.0), (3, 3), "malicious")


def test_a_plan_writes_nothing_and_marks_what_maps_alone_deals_with(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words("--maps 5x7 --plan --json --out", tmp_path / "m")) == 0
    plans = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert list(tmp_path.iterdir()) == []
    (picked,) = (p for p in plans if p["picked"])
    assert len(plans) > 3 and "link" in picked["reason"] and picked["dealing_seconds"] >= 0
    assert cli.main(words("--maps 5x7 --json --out", tmp_path / "m")) == 0
    dealt = json.loads(capsys.readouterr().out)
    for name in ("tile", "jobs", "comparisons"):
        assert dealt[name] == picked[name]
    sizes = [(tmp_path / "m" / path).stat().st_size for path in ("alice/bob.tape", "bob/alice.tape")]
    assert sizes == picked["tape_bytes"]


def test_a_plan_for_people_is_a_table_with_a_mark_and_a_reason(capsys):
    assert cli.main(words("--maps 5x7 --plan")) == 0
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert sum(line.startswith("* ") for line in lines) == 2 and "nothing was written" in lines[-1]
    assert all(title in lines[1] for title in ("tile", "spare", "sent", "radio", "tape", "memory"))


@pytest.mark.parametrize(
    ("given", "tile", "jobs"),
    [
        ("--count 30", [1, 1], 30),
        ("--count 30 --tile 4x4", [4, 4], 2),
        ("--maps 9x5 --tile 4x4 --spare 0", [4, 4], 6),
    ],
)
def test_with_a_tile_or_a_count_the_plan_is_for_that_alone(capsys, given, tile, jobs):
    assert cli.main(words(f"{given} --plan --json")) == 0
    (line,) = capsys.readouterr().out.splitlines()
    fields = json.loads(line)
    assert (fields["tile"], fields["jobs"], fields["picked"]) == (tile, jobs, True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("--count 3", "--out"),
        ("--out x", "--count"),
        ("--count 3 --maps 2x2 --out x", "not allowed"),
        ("--maps 2by2 --out x", "MxK"),
        ("--maps ²x2 --out x", "MxK"),
        ("--count 3 --out x --score S11", "S10 dotprod"),
        ("--count 0 --plan", "at least one"),
        ("--count 1 --plan --dim 0", "must be positive"),
        ("--count 99999999999 --plan", "more than a tape can have"),
        ("--count 1 --plan --agents a/b c", "a robot's name"),
        ("--count 1 --plan --agents a A", "already"),
        ("--count 1 --plan --tile 9000x9000 --dim 8192", "smaller tile"),
    ],
)
def test_bad_words_are_refused_with_status_2_and_as_json(tmp_path, capsys, monkeypatch, text, says):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words(text)) == 2
    told = capsys.readouterr()
    assert says in told.err and told.out == ""
    assert cli.main(words(text, "--json")) == 2
    fields = json.loads(capsys.readouterr().out)
    assert set(fields) == {"error", "message"} and says in fields["message"]
    assert list(tmp_path.iterdir()) == []


def test_scores_go_by_either_name_in_any_case():
    assert [options.score(name) for name in ("S10", "s10", "dotprod", "L2_DIST")] == [
        "S10",
        "S10",
        "S10",
        "S4",
    ]
    assert isinstance(cli.parser(), CommandParser)


def test_long_bags_of_words_come_with_another_way(capsys):
    assert cli.main(words("--count 1 --plan --score S2 --dim 10000")) == 0
    note = capsys.readouterr().err
    assert "S10 of the square roots" in note and len(note.splitlines()) == 1
    for quiet in ("--score S2 --dim 100", "--score S10 --dim 10000", "--score S2 --dim 10000 --quiet"):
        assert cli.main(words(f"--count 1 --plan {quiet}")) == 0
        assert capsys.readouterr().err == ""


def test_of_more_robots_every_pair_is_counted(capsys):
    assert cli.main(words("--count 4 --plan")) == 0
    two = capsys.readouterr().out
    assert cli.main(["--agents", "alice", "bob", "carol", *words("--count 4 --plan")[3:]]) == 0
    three = capsys.readouterr().out
    assert "each of 3 pairs of robots" in three and "for a pair of robots, tapes" in two
