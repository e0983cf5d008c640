"""What a compromised robot gains: the attacks work on what is broadcast, and less on what is exchanged."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bench.attacks.insider import refusals
from bench.attacks.prober import Oracle, Prior, Probing, probe
from bench.attacks.scans import correlation, overlap
from bench.demo import dataset
from protocols import is_candidate
from protocols.check.clear_scores import unit
from protocols.scores import S10
from spdz.local import run_clear

ROOT = Path(__file__).resolve().parent.parent
DIM, THRESHOLD = 48, 0.5


@pytest.fixture(scope="module", autouse=True)
def one_blas_thread():
    """As the command has it: threads that wait for each other cost more where other processes run."""
    with threadpool_limits(1, user_api="blas"):
        yield


def rng(seed=11):
    return np.random.default_rng(seed)


def just_matching(hidden, seed=12, cosine=THRESHOLD + 1e-3):
    other = rng(seed).standard_normal(len(hidden))
    return cosine * hidden + np.sqrt(1 - cosine**2) * unit(other - (other @ hidden) * hidden)


# Probing with unit vectors


def test_an_oracle_decides_as_the_program_does():
    hidden, *probes = unit(rng().standard_normal((1 + 200, 3)))
    program = is_candidate(S10.within(1.0), THRESHOLD)
    oracle = Oracle(hidden, THRESHOLD, rng(), resolution=32)
    for vector in probes:
        assert oracle(vector) == bool(run_clear(program, vector, hidden).value)
    assert 0 < sum(oracle.answers) < len(probes) == len(oracle.answers)


def test_an_oracle_is_as_fine_as_the_resolution():
    """A score within half a step of the threshold comes out both ways, one beyond never."""
    hidden, step = np.array([1.0, 0.0]), 2.0**-8
    for offset, shares in (
        (0.0, (0.3, 0.7)),
        (0.25 * step, (0.6, 0.9)),
        (0.6 * step, (1, 1)),
        (-0.6 * step, (0, 0)),
    ):
        cosine = THRESHOLD + offset
        oracle = Oracle(hidden, THRESHOLD, rng(), resolution=8)
        found = np.mean([oracle(np.array([cosine, np.sqrt(1 - cosine**2)])) for _ in range(300)])
        assert shares[0] <= found <= shares[1]


@pytest.mark.parametrize("norm", [1.01, 2.0, 1e6])
def test_an_oracle_takes_no_longer_probe(norm):
    hidden = unit(rng().standard_normal(DIM))
    oracle = Oracle(hidden, THRESHOLD, rng())
    with pytest.raises(ValueError, match="norm"):
        oracle(norm * hidden)
    assert oracle.answers == []


def test_a_prober_finds_a_hidden_vector_bit_by_bit():
    hidden = unit(rng().standard_normal(DIM))
    found = probe(hidden, just_matching(hidden), Prior.nothing(DIM), THRESHOLD, 6 * DIM, rng(13))
    assert len(found.cosines) == len(found.answers) == 6 * DIM
    assert found.cosines[0] == pytest.approx(THRESHOLD, abs=0.01) and found.cosines[-1] > 0.98
    assert 28 < found.bits_until(0.8) < found.bits_until(0.95) and found.bits_until(1.1) is None


def test_what_is_known_beforehand_saves_bits():
    lengths = 0.8 ** np.arange(DIM)
    drawn = unit(rng().standard_normal((400, DIM)) * lengths)
    hidden = unit(rng(14).standard_normal(DIM) * lengths)
    bits = [
        probe(hidden, just_matching(hidden), prior, THRESHOLD, 6 * DIM, rng(13)).bits_until(0.9)
        for prior in (Prior.of(drawn), Prior.nothing(DIM))
    ]
    assert bits[0] < bits[1] - 30


def test_a_prior_keeps_what_became_known():
    prior = Prior.of(rng().standard_normal((100, 6)))
    axes, values = np.linalg.qr(rng().standard_normal((6, 2)))[0], np.array([0.3, -0.1])
    given = prior.given(axes, values)
    np.testing.assert_allclose(axes.T @ given.mean, values, atol=1e-12)
    np.testing.assert_allclose(given.covariance @ axes, 0, atol=1e-9)
    assert np.linalg.eigvalsh(given.covariance).min() > -1e-9


def test_the_third_match_is_counted_by_answers():
    found = Probing(np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.array([True, False, True, True, False]))
    assert found.cosine_at_match(3) == 0.4 and found.cosine_at_match(4) is None


# Longer vectors, by the real protocol


@pytest.fixture(scope="module")
def brought():
    return {row.probe: row for row in refusals(unit(rng().standard_normal((3, 8))), THRESHOLD)}


@pytest.mark.parametrize("name", ["norm 1.01", "norm 2", "huge: one coordinate of 2^14"])
def test_a_longer_probe_is_refused_by_name_and_gets_no_bit(brought, name):
    row = brought[name]
    assert row.refused and row.names and (row.bits, row.matches) == (0, 0)
    assert re.match("ProtocolViolation: the vector in slot 0 of bob has not a norm", row.error)


def test_an_honest_probe_is_compared(brought):
    row = brought["norm 1, as it should be"]
    assert not row.refused and row.bits == 3 and row.matches >= 1


def test_a_huge_probe_gets_its_bits_where_nothing_proves_norms(brought):
    row = brought["the same, where no proofs were dealt"]
    assert not row.proof and not row.refused and row.bits == 3


def test_a_zero_vector_matches_everything_unless_a_least_norm_was_dealt(brought):
    free, bound = (brought[f"zero, under a distance {how}"] for how in ("without a least norm", "with one"))
    assert not free.refused and free.bits == free.matches == 3
    assert bound.refused and bound.names and bound.bits == 0


# Paths and scans, on the corridor data


@pytest.fixture(scope="module")
def world():
    pytest.importorskip("rtbdata")
    from bench.attacks.world import build

    return build(dataset.load(), dense=2.0)


@pytest.fixture(scope="module")
def paths(world):
    from bench.attacks.paths import judged, reconstructions

    return [(judged(one, world), one) for one in reconstructions(world)]


@pytest.fixture(scope="module")
def rows(paths):
    return [row for row, _ in paths]


@pytest.fixture(scope="module")
def scans(world):
    from bench.attacks.scans import rebuild

    return rebuild(world, seed=1)


def test_the_attacked_descriptors_are_the_demos(world):
    from bench.demo.places import robots

    alice, bob = robots(dataset.load())
    np.testing.assert_array_equal(world.alice.descriptors, alice.descriptors)
    np.testing.assert_array_equal(world.bob.descriptors, bob.descriptors)
    np.testing.assert_array_equal(world.bob.positions, bob.positions)


def test_a_broadcast_tells_more_of_a_path_than_this_exchange(rows):
    every = [row for row in rows if row.source == "broadcast" and row.claimed == row.keyframes]
    exchanged = [row for row in rows if row.source == "exchange"]
    (nothing,) = (row for row in rows if row.source == "nothing")
    (best,) = every
    assert best.localised > 1.3 * max(row.localised for row in exchanged)
    assert max(row.localised for row in exchanged) > 10 > nothing.localised == 0
    (lines,) = (row for row in exchanged if row.claimed == row.keyframes)
    assert best.mean_m < lines.mean_m / 2 < nothing.mean_m / 2


def test_only_a_broadcast_tells_where_the_attacker_has_never_been(rows):
    reached = {source: max(row.unseen_localised for row in rows if row.source == source) for source in
               ("broadcast", "exchange")}  # fmt: skip
    assert reached["broadcast"] >= 10 and reached["exchange"] <= 3


def test_bits_tell_what_the_papers_rule_makes_of_the_same_keyframes(world, rows):
    """With the attacker's keyframes alone a broadcast and the bits give the same: that is by design."""
    from bench.attacks.paths import Reconstruction, exchanged_matches, judged, mean_of_matches

    matches = exchanged_matches(world)
    (bits,) = (row for row in rows if row.source == "exchange" and row.claimed < row.keyframes)
    same = judged(Reconstruction("", "", "", mean_of_matches(matches, world.bob.positions)), world)
    assert (same.claimed, same.localised) == (bits.claimed, bits.localised) == (30, 28)


def test_what_was_not_revealed_changes_nothing_of_what_the_exchange_gives(world):
    from bench.attacks.paths import exchanged_matches, reconstructions

    hidden = ~exchanged_matches(world).any(axis=1)
    known = world.dense.descriptors @ world.bob.descriptors.T
    lonely = world.dense.descriptors[known.max(axis=1) < world.threshold]
    changed = world.alice.descriptors.copy()
    changed[hidden] = lonely[rng().integers(len(lonely), size=hidden.sum())]
    other = replace(world, alice=replace(world.alice, descriptors=changed))
    for before, after in zip(reconstructions(world), reconstructions(other), strict=True):
        same = np.array_equal(before.positions, after.positions, equal_nan=True)
        assert same == (before.source != "broadcast"), before.attack


def test_occupied_cells_turn_as_polar_grids_do():
    from bench.attacks.world import occupied, quarter_turned
    from bench.demo.scan_context import polar_grid, quarter_turns

    points = rng().uniform(-15, 15, (500, 2))
    turned = np.stack([-points[:, 1], points[:, 0]], axis=1)
    np.testing.assert_array_equal(quarter_turned(occupied(points), 2)[1], occupied(turned))
    np.testing.assert_allclose(quarter_turns(polar_grid(points), 2)[1], polar_grid(turned))


def test_two_descriptors_in_a_row_tell_the_step_between_them(world):
    from bench.attacks.motion import SHIFTS, rebuilt_grids, step_likelihoods
    from bench.attacks.world import CELL

    some = slice(40, 60)
    rebuilt = rebuilt_grids(world.alice.descriptors[some], world.bob.grids, world.public.background)
    likely = [
        np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(rebuilt, world.alice.grids[some], strict=True)
    ]
    assert np.median(likely) > 0.99
    steps = step_likelihoods(rebuilt)
    np.testing.assert_allclose(steps.sum(axis=(1, 2)), 1)
    most = np.array([np.unravel_index(step.argmax(), step.shape) for step in steps]) - SHIFTS
    moved = np.diff(world.alice.positions[some], axis=0)
    true = (moved[:, 0] + 1j * moved[:, 1]) * np.exp(-1j * world.public.walls)
    error = np.abs(CELL * (most[:, 0] + 1j * most[:, 1]) - true)
    assert np.median(error) < 0.5 < np.median(np.abs(true))


def test_a_track_follows_known_steps_from_a_known_place():
    from bench.attacks.motion import SHIFTS
    from bench.attacks.tracking import Floor
    from bench.attacks.world import CELL

    floor = Floor.around(np.array([[0.0, 0.0], [10.0, 6.0]]))
    moves = np.array([[8, 0], [8, 1], [0, 7], [-8, 0]])
    steps = np.zeros((4, 2 * SHIFTS + 1, 2 * SHIFTS + 1))
    for step, (i, j) in zip(steps, moves, strict=True):
        step[SHIFTS + i, SHIFTS + j] = 1
    start = floor.centres[floor.nearest(np.array([[1.0, 2.0]]))[1].argmin()]
    known = (np.linalg.norm(floor.centres - start, axis=1) < 0.1).astype(float) + 1e-9
    everywhere = [np.ones(len(floor.centres))] * 3
    true = start + CELL * np.concatenate([[[0, 0]], np.cumsum(moves, axis=0)])
    np.testing.assert_allclose(floor.track(steps, [known, *everywhere, everywhere[0]]), true, atol=0.1)
    back = floor.track(steps, [*everywhere, everywhere[0], known])  # the end tells as much as the beginning
    np.testing.assert_allclose(back, true - true[-1] + start, atol=0.1)


def test_a_regression_rebuilds_scans_from_a_broadcast_and_not_from_this_exchange(scans):
    broadcast, exchange, constant, shuffled = scans.rows
    assert broadcast.overlap > 1.4 * exchange.overlap and broadcast.correlation > exchange.correlation + 0.1
    assert exchange.overlap >= constant.overlap > shuffled.overlap
    assert broadcast.overlap_unseen > 1.3 * constant.overlap_unseen
    assert (broadcast.fed, exchange.fed, constant.fed) == (99, 30, 0)
    assert scans.guessed.shape == scans.true.shape == (99, 80, 80)


def test_overlap_and_correlation_are_those_of_the_books():
    a = np.array([[True, True, False, False]])
    b = np.array([[True, False, True, False]])
    assert overlap(a, b) == pytest.approx(1 / 3) and overlap(~a & a, a) == 0 == overlap(~a & a, ~a & a)
    x, y = rng().standard_normal((2, 3, 50))
    expected = [np.corrcoef(p, q)[0, 1] for p, q in zip(x, y, strict=True)]
    np.testing.assert_allclose(correlation(x, y), expected)
    assert correlation(np.ones((1, 4)), y[:1, :4]) == 0


# The command


def attacks(*words, without=""):
    code = f"import sys; sys.modules[{without!r}] = None; from bench.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "attacks", *map(str, words)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, check=False)


@pytest.mark.parametrize("module", ["rtbdata", "matplotlib"])
def test_a_missing_package_is_told_with_a_command(module, tmp_path):
    result = attacks("--quick", "--out", tmp_path / "out", without=module)
    assert result.returncode == 1 and not result.stdout and "Traceback" not in result.stderr
    last = result.stderr.splitlines()[-1]
    assert module.replace("rtbdata", "rtb-data") in last and "pip install rtb-data" in last.replace("'", "")


def test_usage_errors_are_json_where_asked():
    result = attacks("--only", "everything", "--json")
    assert result.returncode == 2 and json.loads(result.stdout)["error"] == "UsageError"
    assert attacks("--seed", -1).returncode == 2


@pytest.fixture(scope="module")
def ran(world, paths, scans, tmp_path_factory):
    """All parts, quick, on the world that is there already; findings, page, folder."""
    pytest.importorskip("matplotlib")
    from bench.attacks import probes, run
    from bench.attacks.page import write_page
    from bench.attacks.pictures import draw

    folder = tmp_path_factory.mktemp("attacks")
    found = run.Findings(world, seed=1, paths=paths, scans=scans)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "build", lambda *_: world)
        patch.setattr(probes, "ISOTROPIC", 64)
        other = run.run_attacks(("probes",), run.QUICK, seed=1)
    found.probes, found.refusals = other.probes, other.refusals
    draw(folder, found)
    return found, write_page(folder, found).read_text(encoding="utf-8"), folder


def test_rows_are_json_and_tell_every_part(ran):
    told = [json.loads(json.dumps(row, allow_nan=False)) for row in ran[0].rows()]
    assert {row["part"] for row in told} == {"paths", "scans", "probes", "strikes", "refusals"}
    (strikes,) = (row for row in told if row["part"] == "strikes")
    assert strikes["most_bits"] == pytest.approx(
        np.log2(1 + 300 + 300 * 299 / 2 + 300 * 299 * 298 / 6), abs=0.01
    )


def test_raw_descriptors_are_matched_and_guessed_more_easily_than_whitened_ones(ran):
    raw, centred, whitened = (
        next(row for row in ran[0].rows() if row["part"] == "probes" and row["descriptors"] == name)
        for name in ("raw Scan Context", "public mean subtracted", "the demo's, whitened")
    )
    assert raw["equal"] == 1.0 and centred["equal"] == whitened["equal"] == 0.0
    assert raw["foreign"] > centred["foreign"] > 0.1 > 1e-4 > whitened["foreign"]
    assert raw["effective_dimension"] < 20 < 200 < whitened["effective_dimension"]
    assert raw["cosine_before"] > 0.6 > 0.1 > whitened["cosine_before"]
    assert raw["cosine_after"][140] > whitened["cosine_after"][140] + 0.1


def test_the_page_needs_nothing_else(ran):
    _, page, folder = ran
    assert {path.name for path in folder.iterdir()} == {
        "attacks.html",
        "paths.png",
        "scans.png",
        "probes.png",
    }
    assert page.count("data:image/png;base64,") == 4 + 6 + 1 and page.count("<table>") == 6
    assert not re.search(r"(?:src|href)=\"(?!data:)", page) and "<script" not in page


def test_the_terminal_has_the_same_tables(ran):
    from bench.attacks.report import show, tables

    text = "\n".join(show(ran[0]))
    for table in tables(ran[0]):
        assert table.title in text and all(row[0] in text for row in table.rows)
        assert all(meaning.split()[0] in text for _, meaning in table.key)


def test_the_terminal_needs_no_more_than_100_columns(ran):
    from bench.attacks.report import show

    assert max(map(len, show(ran[0]))) <= 100


def test_headers_are_told_apart_and_shares_are_in_percent(ran):
    from bench.attacks.report import tables

    for table in tables(ran[0]):
        assert len(set(table.head)) == len(table.head), table.head
    (matches,) = (table for table in tables(ran[0]) if table.title.startswith("The first match"))
    assert all(cell == "-" or cell.endswith("%") for row in matches.rows for cell in row[1:4])


def test_bits_that_did_not_suffice_and_a_single_target_are_told_so(ran):
    from bench.attacks.report import tables

    (probes,) = (table for table in tables(ran[0]) if table.title.startswith("Probes"))
    assert "> 150" in probes.rows[0] and probes.notes[0].startswith("One descriptor of Alice's")


def test_a_cell_of_the_page_names_its_column_for_narrow_screens(ran):
    page = ran[1]
    assert page.count("<td ") == page.count("<td data-column=") > 60 and "<td>" not in page
    assert "@media (max-width" in page and "attr(data-column)" in page
