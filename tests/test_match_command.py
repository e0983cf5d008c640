"""``python -m spdz match`` over lines that break: over TLS, in processes of their own."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from proxy_helpers import Forwarder

from bench.parties import free_port
from dealer.mission import deal_mission
from protocols.catalog import Purpose

DIM, OWN = 8, 20
ALIKE = [[i, i + 3] for i in range(OWN - 3)]


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    """400 pairs, one a job, in runs of 64."""
    folder = tmp_path_factory.mktemp("mission")
    deal_mission(folder, ["alice", "bob"], Purpose("S10", DIM, max_norm=1.0), 6000)
    places = np.random.default_rng(1).standard_normal((OWN + 3, DIM))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    np.save(folder / "alice.npy", places[3:])
    np.save(folder / "bob.npy", places[:OWN])
    return folder


def start(folder, robot, where, *extra):
    """Start a robot; one that listens has said so when this returns."""
    peer = {"alice": "bob", "bob": "alice"}[robot]
    words = [*where, "--tape", f"{folder}/{robot}/{peer}.tape", "--descriptors", f"{folder}/{robot}.npy"]
    words += ["--threshold", "0.999", "--state-dir", f"{folder}/state-{robot}", *extra]
    process = subprocess.Popen(
        [sys.executable, "-m", "spdz", "match", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in a shell's background
    )
    if "--listen" in where:
        while "listening on" not in (line := process.stderr.readline()):
            assert line
    return process


def run(folder, limits, *extra, gone=False):
    port = free_port()
    with Forwarder(port, limits, gone=gone) as forwarder:
        alice = start(folder, "alice", ["--listen", f"127.0.0.1:{port}"], *extra)
        bob = start(folder, "bob", ["--connect", f"127.0.0.1:{forwarder.port}"], *extra)
        results = [(*process.communicate(timeout=60), process.returncode) for process in (alice, bob)]
        return results, forwarder.count


def test_two_drops_cost_jobs_and_no_match(mission):
    results, connections = run(mission, [9_000, 20_000], "--json", "--wait", "20")
    assert connections >= 3
    for (out, err, status), found in zip(results, (ALIKE, [pair[::-1] for pair in ALIKE]), strict=True):
        answer = json.loads(out)
        assert status == 0 and sorted(answer["matches"]) == sorted(found), err
        assert answer["decided"] == OWN * OWN < answer["jobs"] + 2 * 64
        assert "lost" in err and err.count("connected to") >= 3


@pytest.mark.parametrize("as_json", [True, False])
def test_what_was_decided_is_printed_when_the_peer_is_gone_for_good(mission, as_json):
    results, _ = run(mission, [25_000], "--wait", "4", "--timeout", "4", *["--json"] * as_json, gone=True)
    for out, err, status in results:
        assert status == 1, err
        if as_json:
            answer = json.loads(out)
            assert 64 <= answer["decided"] < OWN * OWN and answer["shape"] == [OWN, OWN]
            assert answer["error"].startswith("Channel") and answer["message"]
        else:
            assert "pairs were compared: broken off" in out and "python -m spdz match: Channel" in err


def test_ctrl_c_prints_what_was_decided(mission):
    """Bob's line goes silent; Alice's user loses patience."""
    port = free_port()
    alice = start(mission, "alice", ["--listen", f"127.0.0.1:{port}"], "--wait", "60")
    with Forwarder(port, [25_000], gone=True) as forwarder:
        bob = start(mission, "bob", ["--connect", f"127.0.0.1:{forwarder.port}"], "--wait", "4", "--quiet")
        bob.communicate(timeout=60)
        while "lost bob" not in (line := alice.stderr.readline()):
            assert line
    alice.send_signal(signal.SIGINT)
    out, err = alice.communicate(timeout=30)
    assert alice.returncode == 130 and "Traceback" not in err
    assert "pairs were compared: broken off" in out
