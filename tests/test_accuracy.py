"""How far secure scores are from the true ones, and that the command that tells it tells the truth."""

import json
from pathlib import Path

import numpy as np
import pytest

import bench.accuracy
import bench.recorded_accuracy
from bench.accuracy import exact_scores, main, secure_scores
from bench.exact import units
from bench.inputs import KINDS, draw
from protocols.scores import SCORES
from spdz.foundations.stats import Outcome, Stats

SECURITIES = ["malicious", "semi-honest"]
VECTORS = Path(__file__).parent / "vectors" / "mp_spdz.json"
EXACT = {"S2", "S6", "S10"}
"""Scores without a rounding: a result is the true score, rounded to a float64."""

BOUND = 2.0
"""Any other score of modest vectors is within so many units of 2^-16 of the true one; relatively, above 1."""


def scaled_errors(name, values, x, y):
    exact = exact_scores(name, x, y)
    return [units(value, true) / max(1, true) for value, true in zip(values, exact, strict=True)]


def rows(capsys, *words):
    assert main([*map(str, words), "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def wrong_by(monkeypatch, module, raw_units):
    """Let the engine return results that are off by so many units of 2^-16."""
    real = module.run_local

    def run_local(*arguments):
        return Outcome(real(*arguments).value + raw_units / 65536, (Stats(), Stats()))

    monkeypatch.setattr(module, "run_local", run_local)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
def test_scores_are_near_the_true_ones(name, security):
    for kind in KINDS:
        x, y = draw(kind, 4, 16, seed=3)
        values = secure_scores(SCORES[name], x, y, security)
        assert max(scaled_errors(name, values, x, y)) <= (2.0**-20 if name in EXACT else BOUND), kind


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
def test_the_zero_vector_has_scores(name, security):
    x = np.array([[0.0, 0.0], [0.6, -0.8], [0.0, 0.0]])
    y = np.array([[0.6, -0.8], [0.0, 0.0], [0.0, 0.0]])
    values = secure_scores(SCORES[name].within(1.0), x, y, security)
    assert max(scaled_errors(name, values, x, y)) <= (2.0**-20 if name in EXACT else BOUND)


def test_a_wrong_result_is_told(monkeypatch, capsys):
    cell = "--score S10 --dim 16 --kind unit --max-norm 1 --security malicious --trials 3".split()
    (right,) = rows(capsys, *cell)
    assert right["max_units"] == right["mean_units"] == right["max_scaled"] == 0.0
    wrong_by(monkeypatch, bench.accuracy, 3)
    (wrong,) = rows(capsys, *cell)
    assert wrong["max_units"] == wrong["mean_units"] == 3.0
    assert {key: wrong[key] for key in ("score", "n", "kind", "max_norm", "security", "trials")} == {
        "score": "S10",
        "n": 16,
        "kind": "unit",
        "max_norm": 1.0,
        "security": "malicious",
        "trials": 3,
    }


def test_a_large_score_is_scaled(monkeypatch, capsys):
    wrong_by(monkeypatch, bench.accuracy, 64)
    for row in rows(capsys, *"--score S6 --dim 256 --kind uniform --security semi-honest".split()):
        assert row["max_units"] == pytest.approx(64) and row["max_scaled"] < 0.01  # S6 is near 17,000


def test_many_long_pairs_are_cut_into_jobs_in_order(monkeypatch):
    x, y = draw("normal", 5, 16, seed=1)
    whole = secure_scores(SCORES["S10"], x, y, "semi-honest")
    jobs = []
    real = bench.accuracy.run_local
    monkeypatch.setattr(bench.accuracy, "JOB_COORDINATES", 32)
    monkeypatch.setattr(bench.accuracy, "run_local", lambda *a: jobs.append(a[1].shape) or real(*a))
    assert secure_scores(SCORES["S10"], x, y, "semi-honest") == whole
    assert jobs == [(2, 16), (2, 16), (1, 16)]


def test_kinds_keep_to_their_norms_and_are_reproducible():
    for name, kind in KINDS.items():
        for n in (1, 2, 16, 1536):
            x, y = draw(name, 3, n, seed=7)
            assert x.shape == y.shape == (3, n) and np.isfinite([x, y]).all()
            assert np.linalg.norm([x, y], axis=-1).max() <= kind.largest_norm(n) * (1 + 1e-12)
            assert np.array_equal(draw(name, 3, n, seed=7)[0], x)
            assert n == 1 or not np.array_equal(draw(name, 3, n, seed=8)[0], x)
    x, y = draw("near", 3, 16, seed=7)
    assert (np.linalg.norm(x - y, axis=-1) < 0.02).all() and (x != y).any()


def test_a_kind_is_measured_with_every_norm_that_it_keeps_to(capsys):
    found = rows(capsys, *"--score S10 --dim 4 --security malicious --trials 1 --max-norm 1 20".split())
    assert [(row["kind"], row["max_norm"]) for row in found] == [
        ("unit", 1.0),
        ("unit", 20.0),
        ("near", 1.0),
        ("near", 20.0),
        ("normal", 20.0),
        ("uniform", 20.0),
    ]


def test_the_table_ends_with_the_largest_errors(monkeypatch, capsys):
    wrong_by(monkeypatch, bench.accuracy, 2)
    assert main("--score S10 --dim 2 4 --kind unit near --trials 1".split()) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == [
        "score",
        "N",
        "kind",
        "max",
        "norm",
        "security",
        "trials",
        "largest",
        "mean",
        "scaled",
    ]
    assert sum(line.startswith("S10 ") for line in lines) == 2 * 2 * 2 * 2
    assert lines[-3:] == [
        "| score | unit | near | scaled |",
        "|---|---|---|---|",
        "| S10 | 2.00 | 2.00 | 2.00 |",
    ]


@pytest.mark.parametrize(
    "words",
    [
        "--trials 0",
        "--dim 0",
        "--seed -1",
        "--max-norm 0",
        "--max-norm 1e9",
        "--max-norm 0.5",
        "--score S11",
        "--kind huge",
        "--vectors no/such/file.json",
    ],
)
def test_bad_arguments_are_refused(words, capsys):
    with pytest.raises(SystemExit) as refused:
        main(words.split())
    assert refused.value.code == 2 and "error" in capsys.readouterr().err


def test_recorded_vectors_are_compared_with(monkeypatch, capsys):
    words = ["--vectors", VECTORS, "--score", "S2", "S10", "--security", "semi-honest"]
    distance, product = rows(capsys, *words)
    assert (distance["score"], distance["pairs"], distance["outputs"]) == ("S2", 10, 100)
    assert distance["ours"] == {"semi-honest": 0.0} and distance["theirs"] == distance["apart"] == 0.0
    assert product["ours"] == {"semi-honest": 0.0} and product["theirs"] == 0.9922
    assert product["apart"] == pytest.approx(0.99, abs=0.01)
    wrong_by(monkeypatch, bench.recorded_accuracy, 5)
    distance, _ = rows(capsys, *words)
    assert distance["ours"] == {"semi-honest": 5.0} and distance["apart"] == 5.0 and distance["theirs"] == 0.0


def test_recorded_vectors_make_a_table(capsys):
    assert main(["--vectors", str(VECTORS), "--score", "S10"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "10 recorded pairs" in lines[0] and lines[1] == "Recorded: MP-SPDZ v0.4.2 (bf7f8f4b)."
    assert lines[-3:] == [
        "| score | ours, malicious | ours, semi-honest | MP-SPDZ | apart |",
        "|---|---|---|---|---|",
        "| S10 | 0.00 | 0.00 | 0.99 | 0.99 |",
    ]
