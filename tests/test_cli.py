"""The commands of the README, as a user types them, in processes of their own."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

from bench.parties import free_port
from dealer.tapes import deal_tapes
from protocols.scores import S10

DIM = 8


def command(*words, **options):
    return subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, timeout=60, check=False, **options
    )


def deal(folder, *extra):
    return command(
        *f"spdz.dealer --agents alice bob --score S10 --dim {DIM} --count 12 --out {folder}".split(), *extra
    )


def match_both(folder, *extra, thresholds=("0.8", "0.8"), wait="20"):
    """Start both robots; returns (status, stdout, stderr) of each."""
    port = free_port()
    processes = []
    for robot, peer, role, threshold in (
        ("alice", "bob", "--listen", thresholds[0]),
        ("bob", "alice", "--connect", thresholds[1]),
    ):
        words = ["spdz", "match", "--tape", f"{folder}/{robot}/{peer}.tape", role, f"127.0.0.1:{port}"]
        words += ["--descriptors", f"{folder}/{robot}.npy", "--threshold", threshold]
        words += ["--state-dir", f"{folder}/state-{robot}", "--wait", wait, "--quiet", *extra]
        processes.append(
            subprocess.Popen(
                [sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        )
    results = []
    for process in processes:
        out, err = process.communicate(timeout=60)
        results.append((process.returncode, out, err))
    return results


@pytest.fixture
def mission(tmp_path):
    folder = tmp_path / "mission"
    dealt = deal(folder)
    assert dealt.returncode == 0, dealt.stderr
    eye = np.eye(DIM)
    np.save(folder / "alice.npy", eye[:3])
    np.save(folder / "bob.npy", eye[1:4])
    return folder


def test_deal_and_match_in_two_processes_over_tls(mission):
    first, second = match_both(mission)
    assert first[0] == second[0] == 0, (first, second)
    assert "match: alice 1  bob 0" in first[1] and "match: alice 2  bob 1" in first[1]
    assert "2 of 3 x 3 pairs match" in first[1] and "3 jobs left" in first[1]
    assert "match: bob 0  alice 1" in second[1]


def test_json_is_one_object_with_the_costs(mission):
    first, second = match_both(mission, "--json", "--insecure-plain-tcp")
    answers = [json.loads(out) for _, out, _ in (first, second)]
    assert answers[0]["matches"] == [[1, 0], [2, 1]]
    assert answers[1]["matches"] == [[0, 1], [1, 2]]
    for answer in answers:
        assert answer["rounds"] == 5 and answer["security"] == "malicious"
        assert answer["correlations"]["opened sign"] == 9 and answer["jobs_left"] == 3


@pytest.mark.parametrize("as_json", [True, False])
def test_tapes_of_a_program_of_ones_own_are_no_traceback(tmp_path, mission, as_json):
    paths = tmp_path / "a.tape", tmp_path / "b.tape"
    deal_tapes(paths, ("alice", "bob"), S10, ((DIM,), (DIM,)), 1)
    words = ["spdz", "match", "--tape", str(paths[0]), "--listen", "127.0.0.1:1", "--threshold", "0.8"]
    done = command(*words, "--descriptors", f"{mission}/alice.npy", *["--json"] * as_json)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    said = json.loads(done.stdout)["message"] if as_json else done.stderr
    assert "program of your own" in said


def test_a_tape_that_is_used_up_is_told_before_the_peer_is_looked_for(mission):
    np.save(mission / "bob.npy", np.eye(DIM)[1:5])  # 3 x 4 pairs: all twelve jobs
    match_both(mission)
    (status, _, err), _ = match_both(mission, wait="60")
    assert status == 1 and "every job of" in err and "spdz.dealer --agents alice bob" in err


def test_the_dealer_prints_comparisons_and_sizes(tmp_path):
    dealt = deal(tmp_path / "m")
    assert (
        "12 comparisons in 12 jobs" in dealt.stdout and "alice: " in dealt.stdout and " kB\n" in dealt.stdout
    )
    answer = json.loads(deal(tmp_path / "n", "--json", "--tile", "3x3").stdout)
    assert (answer["comparisons"], answer["jobs"]) == (18, 2)


def test_thresholds_that_differ_are_an_error_with_status_1(mission):
    for status, out, err in match_both(mission, thresholds=("0.8", "0.7")):
        assert status == 1 and not out
        assert "S10 >= 0.8" in err and "S10 >= 0.7" in err


def test_using_up_a_tape_says_what_to_do(mission):
    match_both(mission)
    for status, _, err in match_both(mission):
        assert status == 1
        assert "TapeExhausted" in err and "python -m spdz.dealer" in err


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda folder: np.save(folder / "alice.npy", np.full((2, DIM), np.nan)), "not finite"),
        (
            lambda folder: np.save(folder / "alice.npy", np.zeros((2, DIM + 1))),
            "expected descriptors of shape",
        ),
        (lambda folder: np.save(folder / "alice.npy", np.array([{}]), allow_pickle=True), "cannot read"),
        (lambda folder: (folder / "alice.npy").write_bytes(b"garbage"), "cannot read"),
        (lambda folder: (folder / "alice.npy").unlink(), "cannot read"),
        (lambda folder: (folder / "alice" / "bob.tape").unlink(), "bob.tape"),
        (lambda folder: (folder / "alice" / "key.pem").unlink(), "key.pem"),
        (lambda folder: (folder / "alice" / "bob.tape").write_bytes(b"x" * 5000), "bob.tape"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(mission, change, says):
    change(mission)
    status, out, err = match_both(mission, "--timeout", "5", wait="3")[0]
    assert status in (1, 2) and not out
    assert says in err and "Traceback" not in err and len(err.strip().splitlines()) == 1


def test_nobody_there_is_an_error_in_bounded_time(mission):
    result = command(
        *f"spdz match --tape {mission}/alice/bob.tape --listen 127.0.0.1:{free_port()}".split(),
        *f"--descriptors {mission}/alice.npy --threshold 0.8 --wait 0.3 --json".split(),
    )
    assert result.returncode == 1
    assert json.loads(result.stdout)["error"] == "ChannelTimeout"


@pytest.mark.parametrize(
    "words", [["spdz"], ["spdz", "match"], ["spdz", "tape"], ["spdz", "demo"], ["spdz.dealer"], ["bench"]]
)
def test_help_teaches(words):
    result = command(*words, "--help")
    assert result.returncode == 0 and "usage" in result.stdout and len(result.stdout) > 200


@pytest.mark.parametrize(
    "extra",
    [["--tile", "0x3"], ["--tile", "axb"], ["--max-norm", "-1"], ["--count", "0"], ["--agents", "solo"]],
)
def test_the_dealer_refuses_bad_arguments(tmp_path, extra):
    result = deal(tmp_path / "m", *extra)
    assert result.returncode == 2 and "Traceback" not in result.stderr
    assert not (tmp_path / "m").exists()


def test_the_bench_prints_one_json_object_a_line():
    result = command("bench", *"--score S10 S6 --dim 16 --trials 3 --json --security malicious".split())
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert {(row["score"], row["engine"]) for row in rows} == {
        (score, engine) for score in ("S6", "S10") for engine in ("spdz", "textbook", "clear")
    }
    for row in rows:
        assert {"n", "security", "trials", "median_ms", "bytes_sent", "rounds", "tape_bytes"} <= set(row)
        assert row["ahead_ms"] is None if row["engine"] == "clear" else row["ahead_ms"] > 0
        assert row["max_abs_error"] == 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_a_command_in_one_line(mission, number):
    words = [sys.executable, "-m", "spdz", "match", "--tape", f"{mission}/alice/bob.tape"]
    words += ["--listen", f"127.0.0.1:{free_port()}", "--descriptors", f"{mission}/alice.npy"]
    process = subprocess.Popen(
        [*words, "--threshold", "0.8"],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored in a shell's background
    )
    while "listening on 127.0.0.1" not in (line := process.stderr.readline()):
        assert line
    process.send_signal(number)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted" in err and "Traceback" not in err


def test_an_interrupted_dealer_leaves_nothing_behind(tmp_path):
    words = [sys.executable, "-m", *"spdz.dealer --agents a b --score S10 --dim 512 --count 200000".split()]
    process = subprocess.Popen([*words, "--out", str(tmp_path / "m")], stderr=subprocess.PIPE, text=True)
    assert "writing about" in process.stderr.readline()
    while not list(tmp_path.glob("m/b/.*")):
        assert process.poll() is None
    process.terminate()
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert list(tmp_path.glob("m/*")) == []


def test_a_mission_that_does_not_fit_the_disk_is_refused(tmp_path):
    result = deal(tmp_path / "m", "--count", "4000000000")
    assert result.returncode == 2 and "are free" in result.stderr
    assert not list(tmp_path.glob("m/*"))


def test_bad_descriptors_are_told_before_waiting_for_the_peer(mission):
    np.save(mission / "alice.npy", np.zeros((2, DIM + 1)))
    result = command(
        *f"spdz match --tape {mission}/alice/bob.tape --listen 127.0.0.1:{free_port()}".split(),
        *f"--descriptors {mission}/alice.npy --threshold 0.8 --wait 50".split(),
    )
    assert result.returncode == 2 and "expected descriptors" in result.stderr
    assert "waiting" not in result.stderr
