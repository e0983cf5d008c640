"""All pairs of descriptors over tiles, and the dealer's missions that they run on."""

import os
import stat

import numpy as np
import pytest
from session_helpers import run_pair, state_dirs

from dealer.mission import deal_mission
from dealer.tapes import deal_tapes
from protocols import batching
from protocols.catalog import Purpose
from protocols.matching import match
from spdz import PeerAborted, TapeExhausted
from spdz.tape import Tape

DIM = 6


def unit(seed, count):
    vectors = np.random.default_rng(seed).standard_normal((count, DIM))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def mission(folder, count, security="malicious", **purpose):
    deal_mission(folder, ["alice", "bob"], Purpose("S10", DIM, max_norm=1.0, **purpose), count, security)
    return folder / "alice" / "bob.tape", folder / "bob" / "alice.tape"


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
@pytest.mark.parametrize("tile", [(1, 1), (2, 3), (4, 5), (7, 1)])
@pytest.mark.parametrize("sizes", [(1, 1), (5, 7), (4, 5)])
def test_tiles_cover_every_pair(tmp_path, security, tile, sizes):
    alice, bob = unit(1, sizes[0]), unit(2, sizes[1])
    paths = mission(tmp_path / "m", 200, security, tile=tile)
    first, second = run_pair(
        paths, state_dirs(tmp_path), lambda session: match(session, (alice, bob)[session.party], 0.2)
    )
    quantised = [np.rint(vectors * 65536).astype(object) for vectors in (alice, bob)]
    expected = quantised[0] @ quantised[1].T >= 0.2 * 2**32
    assert np.array_equal(first.decisions, expected.astype(bool))
    assert np.array_equal(second.decisions, expected.astype(bool).T)


def test_scores_are_revealed_only_by_tapes_dealt_for_it(tmp_path):
    alice, bob = unit(1, 3), unit(2, 2)
    paths = mission(tmp_path / "m", 12, tile=(2, 2), reveal="score")
    first, second = run_pair(
        paths, state_dirs(tmp_path), lambda session: match(session, (alice, bob)[session.party])
    )
    assert np.allclose(first.decisions, alice @ bob.T, atol=1e-4)
    assert np.array_equal(first.decisions, second.decisions.T)

    def with_threshold(session):
        with pytest.raises(ValueError, match="reveal the score"):
            match(session, unit(1, 1), 0.5)

    run_pair(paths, state_dirs(tmp_path), with_threshold)


def test_too_few_jobs_are_told_before_anything_is_consumed(tmp_path):
    paths, states = mission(tmp_path / "m", 5), state_dirs(tmp_path)
    errors = run_pair(paths, states, lambda session: match(session, unit(session.party, 3), 0.5))
    assert all(isinstance(error, TapeExhausted) for error in errors)
    assert "need 9 jobs" in str(errors[0]) and "5 are left" in str(errors[0])
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        assert tape.cursor == 0


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((2, DIM + 1)),
        np.zeros(DIM),
        np.full((2, DIM), np.nan),
        2 * unit(1, 2),
        np.ma.array(unit(1, 2), mask=True),
    ],
)
def test_bad_descriptors_on_one_side_stop_both_and_consume_nothing(tmp_path, bad):
    paths, states = mission(tmp_path / "m", 4), state_dirs(tmp_path)
    first, second = run_pair(
        paths, states, lambda session: match(session, (bad, unit(2, 2))[session.party], 0.5)
    )
    assert isinstance(first, ValueError)
    assert isinstance(second, Exception) and not isinstance(second, ValueError)
    with Tape.open(paths[1], state_dir=states[1]) as tape:
        assert tape.cursor == 0


def test_a_peer_with_another_number_of_descriptors_than_it_said_is_stopped(tmp_path):
    paths = mission(tmp_path / "m", 30)

    def liar(session):
        session.exchange_note({"descriptors": "many"})

    first, second = run_pair(
        paths, state_dirs(tmp_path), lambda session: match(session, unit(1, 2), 0.5), liar
    )
    assert "sensible number" in str(first)
    assert second is None or isinstance(second, PeerAborted)


def test_every_pair_of_a_team_is_dealt_and_files_are_private(tmp_path):
    dealt = deal_mission(tmp_path / "m", ["a", "b", "c"], Purpose("S6", DIM), 3)
    assert (dealt.pairs, dealt.jobs, dealt.comparisons) == (3, 3, 3)
    for agent, peers in (("a", "bc"), ("b", "ac"), ("c", "ab")):
        folder = tmp_path / "m" / agent
        assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700
        assert {file.name for file in folder.iterdir()} == {
            "ca.pem",
            "cert.pem",
            "key.pem",
            *(f"{peer}.tape" for peer in peers),
        }
        assert all(stat.S_IMODE(file.stat().st_mode) == 0o600 for file in folder.iterdir())


def test_counts_are_rounded_up_to_whole_tiles(tmp_path):
    dealt = deal_mission(tmp_path / "m", ["a", "b"], Purpose("S10", DIM, tile=(4, 4)), 17)
    assert (dealt.jobs, dealt.comparisons) == (2, 32)


def test_nothing_dealt_is_overwritten(tmp_path):
    mission(tmp_path / "m", 1)
    with pytest.raises(FileExistsError, match="never overwritten"):
        mission(tmp_path / "m", 1)


@pytest.mark.parametrize("agents", [["a"], ["a", "a"], [], ["a", "b/c"], ["a", ".."]])
def test_bad_teams_are_refused(tmp_path, agents):
    with pytest.raises(ValueError):
        deal_mission(tmp_path / "m", agents, Purpose("S10", DIM), 1)


@pytest.mark.parametrize(
    "wrong",
    [{"score": "S99"}, {"dim": 0}, {"tile": (0, 1)}, {"reveal": "all"}, {"max_norm": 0.0}, {"max_norm": 1e9}],
)
def test_bad_purposes_are_refused(tmp_path, wrong):
    with pytest.raises(ValueError):
        deal_mission(tmp_path / "m", ["a", "b"], Purpose(**{"score": "S10", "dim": DIM, **wrong}), 1)
    assert not list(tmp_path.glob("m/*/*.tape"))


def test_the_same_mission_is_never_dealt_twice(tmp_path):
    first, second = (mission(tmp_path / name, 2)[0].read_bytes() for name in "ab")
    words = [{data[i : i + 16] for i in range(0, len(data), 16)} for data in (first, second)]
    shared = words[0] & words[1]
    assert all(len(set(word)) < 8 or word.isascii() for word in shared)


def test_the_filling_of_a_border_tile_tells_nothing_new(tmp_path, monkeypatch):
    """Every opened cell is a result that both robots have anyway: never one against a zero vector."""
    alice, bob = unit(1, 1), unit(2, 3)
    deal_mission(tmp_path / "m", ["alice", "bob"], Purpose("S6", DIM, "score", (4, 1), 1.0), 12)
    paths = tmp_path / "m" / "alice" / "bob.tape", tmp_path / "m" / "bob" / "alice.tape"
    opened = []

    def work(session):
        run_many = session.run_many
        session.run_many = lambda *call: opened.append(result := run_many(*call)) or result
        return match(session, (alice, bob)[session.party]).decisions

    first, _ = run_pair(paths, state_dirs(tmp_path), work)
    for result in opened:
        for block in result.value:
            assert set(np.ravel(block)) <= set(np.ravel(first))


def test_a_job_too_large_for_a_frame_is_refused_when_it_is_dealt(tmp_path):
    """The normalised vectors of S7 take more room than its inputs."""
    purpose = Purpose("S7", 8192, tile=(1500, 1500))
    with pytest.raises(ValueError, match="smaller tiles"):
        deal_tapes((tmp_path / "a", tmp_path / "b"), ("a", "b"), purpose.dealt_program, purpose.shapes, 1)


def test_dealing_that_fails_leaves_no_folder(tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    for kept in (False, True):
        if kept:
            (tmp_path / "m").mkdir()
        with pytest.raises(KeyboardInterrupt):
            deal_mission(tmp_path / "m", ["a", "b"], Purpose("S10", DIM), 1, progress=interrupt)
        assert (tmp_path / "m").exists() == kept and not list(tmp_path.glob("m/*"))


def test_batches_are_small_where_keys_are_large(tmp_path, monkeypatch):
    """As one batch of 64 or in batches of one: the same decisions, in other numbers of rounds."""
    alice, bob = unit(1, 4), unit(2, 3)
    results = []
    for limit in (1 << 40, 1):
        monkeypatch.setattr(batching, "DEALT_BYTES", limit)
        folder = tmp_path / str(limit)
        deal_mission(folder, ["alice", "bob"], Purpose("S2", DIM, max_norm=1.0, tile=(2, 2)), 40, "malicious")
        paths = folder / "alice" / "bob.tape", folder / "bob" / "alice.tape"
        first, _ = run_pair(
            paths, state_dirs(folder), lambda session: match(session, (alice, bob)[session.party], 2.0)
        )
        results.append(first)
    assert np.array_equal(results[0].decisions, results[1].decisions)
    assert results[1].stats.rounds == 4 * results[0].stats.rounds
