"""``python -m spdz match`` on galleries: again and again, interrupted, refused; in processes of their own."""

import json
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from proxy_helpers import Forwarder
from stream_helpers import fresh

from bench.parties import free_port
from dealer.gallery_mission import deal_galleries
from dealer.mission import deal_mission
from protocols.catalog import GalleryPurpose, Purpose

DIM, MOST = 8, 40
PLACES = np.random.default_rng(1).standard_normal((MOST + 20, DIM))
PLACES /= np.linalg.norm(PLACES, axis=1, keepdims=True)
MAPS = {"alice": PLACES[5:], "bob": PLACES}  # Alice's slot i is Bob's i + 5
PEERS = {"alice": "bob", "bob": "alice"}


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mission") / "m"
    deal_galleries(folder, ["alice", "bob"], GalleryPurpose("S10", DIM), (MOST, MOST))
    return folder


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def start(folder, name, where, descriptors, *extra, threshold="0.999"):
    """Start a robot; one that listens has said so when this returns."""
    file = descriptors
    if not isinstance(file, str):
        file = folder / f"{name}.npy"
        np.save(file, descriptors)
    words = [*where, "--tape", f"{folder}/{name}/{PEERS[name]}.tape", "--descriptors", str(file)]
    words += ["--threshold", threshold] if threshold else []
    process = subprocess.Popen(
        [sys.executable, "-m", "spdz", "match", *words, "--state-dir", f"{folder}/state-{name}", *extra],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in a shell's background
    )
    if "--listen" in where:
        process.said = ""
        while "listening on" not in (line := process.stderr.readline()) and line:
            process.said += line
        process.said += line
    return process


def both(folder, first, second, *extra, limits=(), only=("alice", "bob"), wait="20", **options):
    """Run both; standard output, standard error and status of either, Alice first."""
    port = free_port()
    with Forwarder(port, list(limits)) as forwarder:
        extra = ("--wait", wait, "--timeout", "10", *extra)
        alice = start(folder, "alice", ["--listen", f"127.0.0.1:{port}"], first, *extra, **options)
        bob = start(folder, "bob", ["--connect", f"127.0.0.1:{forwarder.port}"], second, *extra, **options)
        return [outcome(process) for process in (alice, bob)]


def outcome(process):
    out, err = process.communicate(timeout=60)
    assert "Traceback" not in err, err
    return out, getattr(process, "said", "") + err, process.returncode


def alike(rows, columns):
    """Slots of Alice and Bob that hold the same place."""
    return [[i, i + 5] for i in rows if i + 5 in columns]


def answers(results, status=0):
    for _, err, code in results:
        assert code == status, err
    return [json.loads(out) for out, _, _ in results]


def test_maps_that_grow_are_compared_as_far_as_they_are_new(mission):
    runs = [(10, 8), (10, 12), (14, 12), (14, 12)]
    done, seen = (0, 0), []
    for rows, columns in runs:
        results = both(mission, MAPS["alice"][:rows], MAPS["bob"][:columns], "--json")
        first, second = answers(results)
        new = [pair for pair in alike(range(rows), range(columns)) if pair not in seen]
        seen += new
        assert sorted(first["matches"]) == sorted(new)
        assert sorted(second["matches"]) == sorted(pair[::-1] for pair in new)
        assert first["new"] == second["peer_new"] == list(range(done[0], rows))
        assert second["new"] == first["peer_new"] == list(range(done[1], columns))
        assert first["decided"] == second["decided"] == rows * columns - done[0] * done[1]
        assert (first["slots_left"], second["slots_left"]) == (42 - rows, 42 - columns)
        done = (rows, columns)
    wanted = {"robot": "bob", "peer": "alice", "security": "malicious", "score": "S10", "threshold": 0.999}
    assert wanted.items() <= second.items() and second["resolution"] == "2^-16" and second["ms"] > 0
    assert {"rounds", "bytes_sent", "field_elements_sent", "correlations"} <= set(second)
    first, second = answers(both(mission, MAPS["alice"][:14], MAPS["bob"][:12], "--json", "--all"))
    assert sorted(first["matches"]) == sorted(seen) and first["decided"] == 14 * 12
    assert sorted(second["matches"]) == sorted(pair[::-1] for pair in seen) and second["new"] == []


def test_what_people_are_told(mission):
    (out, err, status), (theirs, _, _) = both(mission, MAPS["alice"][:10], MAPS["bob"][:8])
    assert status == 0 and "match: alice 0  bob 5\n" in out and "match: bob 5  alice 0\n" in theirs
    assert "3 of 80 pairs match (S10 >= 0.999, to 2^-16, malicious)\n" in out
    last = r"[\d.]+ ms, [\d.]+ (kB|bytes) sent, \d+ rounds; 10 new here and 8 there; 32 of 42 slots left\n$"
    assert re.search(last, out), out
    assert "looking for bob" in err and "interrupted" not in err and "holds" not in err
    (out, err, _), _ = both(mission, MAPS["alice"][:10], MAPS["bob"][:8])
    assert out.startswith("nothing was compared: there was no new pair\n") and "pairs match" not in out
    assert "the gallery holds 10 of these descriptors, 0 are new" in err
    (out, err, _), _ = both(mission, MAPS["alice"][:10], MAPS["bob"][:8], "--all")
    assert "nothing was compared" in out and "3 of 80 pairs match so far" in out and "match: alice 2" in out


def test_append_takes_the_file_as_new(mission):
    answers(both(mission, MAPS["alice"][:4], MAPS["bob"][:6], "--json"))
    first, second = answers(both(mission, MAPS["alice"][4:6], MAPS["bob"][6:6], "--json", "--append"))
    assert (first["new"], second["new"], second["peer_new"]) == ([4, 5], [], [4, 5])
    first, _ = answers(both(mission, MAPS["alice"][:6], MAPS["bob"][:12], "--json", "--all"))
    assert sorted(first["matches"]) == alike(range(6), range(12))


def test_an_empty_file_is_legal(mission):
    (out, _, status), (_, _, other) = both(mission, MAPS["alice"][:0], MAPS["bob"][:3])
    assert status == other == 0 and "nothing was compared" in out and "0 new here and 3 there" in out


def test_another_threshold_is_refused_on_both_sides(mission):
    answers(both(mission, MAPS["alice"][:4], MAPS["bob"][:6], "--json"))
    results = both(mission, MAPS["alice"][:4], MAPS["bob"][:6], threshold="0.9", wait="3")
    assert all(status == 1 and out == "" for out, _, status in results)
    assert all("must never answer another threshold or program" in err for _, err, _ in results)
    answers(both(mission, MAPS["alice"][:4], MAPS["bob"][:7], "--json"))


def test_foreign_and_wrong_files_use_nothing(mission):
    answers(both(mission, MAPS["alice"][:4], MAPS["bob"][:6], "--json"))
    swapped = MAPS["alice"][:4][::-1]
    (_, err, status), _ = both(mission, swapped, MAPS["bob"][:6], wait="3")
    assert status == 2 and "holds 4 descriptors already" in err
    for wrong, says in (
        (MAPS["alice"][:4, :7], "shape (n, 8)"),
        (2 * MAPS["alice"][:5], "norm"),
        ("nothing.npy", "nothing.npy"),
    ):
        port = free_port()
        out, err, status = outcome(
            start(mission, "alice", ["--listen", f"127.0.0.1:{port}"], wrong, "--wait", "1")
        )
        assert (out, status) == ("", 2) and says in err and "Traceback" not in err
    first, _ = answers(both(mission, MAPS["alice"][:4], MAPS["bob"][:6], "--json"))
    assert first["slots_left"] == 38


def test_more_than_there_are_slots_for_is_refused(mission):
    many = np.tile(PLACES, (2, 1))[:43]
    (out, err, status), _ = both(mission, many, MAPS["bob"][:6], wait="3")
    assert (
        (out, status) == ("", 1)
        and "42 slots left for alice and 43 are needed" in err
        and "--slots RxC" in err
    )
    first, _ = answers(both(mission, many[:42], MAPS["bob"][:6], "--json"))
    assert first["slots_left"] == 0


def test_drops_are_survived(mission):
    results = both(mission, MAPS["alice"][:40], MAPS["bob"][:40], "--json", limits=[6000, 9000])
    first, second = answers(results)
    assert (
        sorted(first["matches"]) == alike(range(40), range(40)) == sorted(p[::-1] for p in second["matches"])
    )
    assert "lost" in results[1][1]


@pytest.mark.parametrize("limit", [4000, 7000, 9000])
@pytest.mark.parametrize("killed", ["alice", "bob"])
def test_a_run_in_which_a_robot_was_killed_goes_on_when_it_is_run_again(mission, killed, limit):
    port, stopped = free_port(), []
    with Forwarder(port, [limit], gone=True) as forwarder:
        wait = ("--wait", "2", "--timeout", "2", "--json")
        processes = {
            "alice": start(mission, "alice", ["--listen", f"127.0.0.1:{port}"], MAPS["alice"][:30], *wait),
            "bob": start(
                mission, "bob", ["--connect", f"127.0.0.1:{forwarder.port}"], MAPS["bob"][:30], *wait
            ),
        }
        lines = processes[killed].stderr
        while "lost" not in (line := lines.readline()) and line:
            stopped.append(line)
        assert line, stopped
        processes[killed].kill()
        for name, process in processes.items():
            out, err = process.communicate(timeout=60)
            if name != killed:
                assert process.returncode == 1 and json.loads(out)["error"].startswith("Channel"), err
                assert "run it again on both robots: it goes on where it was" in err
    results = both(mission, MAPS["alice"][:30], MAPS["bob"][:30], "--json", "--all")
    first, second = answers(results)
    assert (
        sorted(first["matches"]) == alike(range(30), range(30)) == sorted(p[::-1] for p in second["matches"])
    )
    assert first["decided"] == second["decided"] == 900
    if first["new"] == second["new"] == []:  # all was filled before
        assert "an earlier run was interrupted: this one goes on" in results[0][1]


def test_ctrl_c_prints_what_there_is_and_what_to_do(mission):
    port = free_port()
    with Forwarder(port, [7000], gone=True) as forwarder:
        alice = start(mission, "alice", ["--listen", f"127.0.0.1:{port}"], MAPS["alice"][:30], "--wait", "60")
        where = ["--connect", f"127.0.0.1:{forwarder.port}"]
        start(mission, "bob", where, MAPS["bob"][:30], "--wait", "1", "--timeout", "1").communicate(
            timeout=60
        )
        while "lost bob" not in (line := alice.stderr.readline()):
            assert line
    alice.send_signal(signal.SIGINT)
    _, err, status = outcome(alice)
    assert status == 130 and "run it again on both robots" in err


def test_a_gallery_against_jobs_is_refused(mission):
    deal_mission(mission / "jobs", ["alice", "bob"], Purpose("S10", DIM, max_norm=1.0), 10)
    (mission / "bob" / "alice.tape").write_bytes((mission / "jobs" / "bob" / "alice.tape").read_bytes())
    results = both(mission, MAPS["alice"][:4], MAPS["bob"][:6], wait="3")
    assert [status for _, _, status in results] == [1, 1] and all(out == "" for out, _, _ in results)
    assert any("TapeMismatch" in err for _, err, _ in results), results


@pytest.mark.parametrize("security", ["semi-honest", "malicious"])
@pytest.mark.parametrize("score", ["S6", "S10"])
def test_scores_and_distances(tmp_path, score, security):
    purpose = GalleryPurpose(score, DIM, reveal="score", min_norm=0.9)
    deal_galleries(tmp_path / "m", ["alice", "bob"], purpose, (4, 4), security)
    own, theirs = MAPS["alice"][:2], MAPS["bob"][4:7]
    results = both(tmp_path / "m", own, theirs, "--json", "--insecure-plain-tcp", threshold=None)
    first, second = answers(results)
    table = own @ theirs.T if score == "S10" else ((own[:, None] - theirs) ** 2).sum(-1)
    assert first["decided"] == 6 and "matches" not in first and first["threshold"] is None
    for i, j, value in first["scores"]:
        assert abs(value - table[i, j]) < 1e-3 and [j, i, value] in second["scores"]
    (out, _, _), _ = both(tmp_path / "m", own, theirs, "--all", "--insecure-plain-tcp", threshold=None)
    assert "nothing was compared" in out and f"alice 0  bob 1: {first['scores'][1][2]:.6g}\n" in out


def test_a_distance_says_its_root(tmp_path):
    deal_galleries(tmp_path / "m", ["alice", "bob"], GalleryPurpose("S6", DIM, min_norm=0.9), (8, 8))
    (out, _, status), _ = both(tmp_path / "m", MAPS["alice"][:4], MAPS["bob"][:7], threshold="0.01")
    assert status == 0 and "match: alice 1  bob 6" in out
    assert "2 of 28 pairs match (S6 <= 0.01, a distance of 0.1, to 2^-16, malicious)" in out
