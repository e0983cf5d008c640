"""How a user's own descriptors stand: the figures, the advice, the command."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.attacks.prober import Prior, probe
from protocols.check import Form, Standing, Whitening, describe
from protocols.check.advice import advice
from protocols.check.clear_scores import score_table, threshold_cosine, unit
from protocols.check.percent import percent
from protocols.check.spread import bits_until, effective_dimension
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import encode
from spdz.local import run_clear

ROOT = Path(__file__).resolve().parent.parent


def rng(seed=5):
    return np.random.default_rng(seed)


def isotropic(count, dim, seed=5):
    return unit(rng(seed).standard_normal((count, dim)))


def correlated(count, dim=40, seed=5):
    """Non-negative descriptors of norm 1 that have much in common, and little that is their own."""
    generator = rng(seed)
    shared = rng(99).random((3, dim)) + 1.0
    return unit(generator.random((count, 3)) @ shared + 0.2 * generator.random((count, dim)))


def check(*words):
    command = [sys.executable, "-m", "spdz", "check", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


# Effective dimension


@pytest.mark.parametrize(("count", "dim"), [(60, 400), (400, 60), (3000, 20)])
def test_isotropic_vectors_have_as_many_dimensions_as_numbers(count, dim):
    assert effective_dimension(isotropic(count, dim)) > 0.9 * dim


def test_vectors_in_few_directions_have_as_many_dimensions():
    vectors = rng().standard_normal((300, 12)) @ np.linalg.qr(rng().standard_normal((200, 12)))[0].T
    assert effective_dimension(vectors) == pytest.approx(12, rel=0.1)


def test_a_direction_that_outweighs_the_others_is_nearly_the_only_one():
    lengths = np.r_[10.0, np.ones(99)]
    expected = (lengths**2).sum() ** 2 / (lengths**4).sum()
    assert effective_dimension(rng().standard_normal((2000, 100)) * lengths) == pytest.approx(
        expected, rel=0.1
    )


def test_neighbours_that_show_one_place_do_not_lower_it():
    once = isotropic(100, 300)
    thrice = np.repeat(once, 3, axis=0) + 1e-3 * isotropic(300, 300, seed=6)
    assert effective_dimension(thrice, neighbours=2) > 0.8 * 300 > 1.2 * effective_dimension(thrice)


def test_equal_vectors_have_no_direction_and_it_is_no_error():
    assert effective_dimension(np.ones((30, 8))) == 8


def test_too_few_vectors_are_refused():
    with pytest.raises(ValueError, match="more than 6 descriptors, got 5"):
        effective_dimension(isotropic(5, 8), neighbours=5)


def test_probe_bits_are_the_rule_the_other_way_round():
    bits = bits_until(0.9, 0.42, 1536)
    assert 0.42**2 + 0.64 * (1 - 0.42**2) * bits / 1536 == pytest.approx(0.81)
    assert bits_until(0.4, 0.42, 1536) == 0 == bits_until(0.9, 1.0, 1536)
    assert bits_until(0.9, -0.5, 100) == bits_until(0.9, 0.0, 100)


def test_the_rule_is_what_a_prober_needs_of_isotropic_vectors():
    dim, threshold, wanted = 128, 0.5, 0.8
    hidden, other = isotropic(2, dim)
    first = unit(0.51 * hidden + np.sqrt(1 - 0.51**2) * unit(other - (other @ hidden) * hidden))
    got = probe(hidden, first, Prior.nothing(dim), threshold, 3 * dim, rng(1)).bits_until(wanted)
    assert got is not None
    assert got - 28 == pytest.approx(bits_until(wanted, threshold, dim), rel=0.25)


# Scores and whitening


@pytest.mark.parametrize("name", SCORES)
def test_clear_scores_are_those_of_the_programs(name):
    x, y = rng().standard_normal((2, 4, 16))
    table = score_table(name, x, y)
    exact = np.array(run_clear(SCORES[name].within(16.0), x[:, None], y[None]).value, dtype=np.float64)
    np.testing.assert_allclose(table, exact, atol=5e-3)


@pytest.mark.parametrize("name", [name for name in SCORES if name not in ("S1", "S2")])
def test_a_threshold_asks_for_the_cosine_of_vectors_that_just_match(name):
    x, y = 2.0 * isotropic(2, 9)
    score = float(score_table(name, x[None], y[None])[0, 0])
    assert threshold_cosine(name, score, 2.0) == pytest.approx(float(x @ y) / 4)


@pytest.mark.parametrize("name", ["S1", "S2"])
def test_an_l1_threshold_fixes_no_cosine(name):
    assert threshold_cosine(name, 0.5, 1.0) is None


@pytest.mark.parametrize("count", [30, 200])
def test_whitening_is_the_inverse_root_of_the_shrunk_covariance(count):
    vectors, shrinkage = correlated(count), 0.3
    centred = vectors - vectors.mean(axis=0)
    covariance = centred.T @ centred / count
    values, axes = np.linalg.eigh(covariance + shrinkage * np.trace(covariance) / 40 * np.eye(40))
    expected = unit(centred @ (axes * values**-0.5) @ axes.T) * 2.0
    np.testing.assert_allclose(Whitening.fit(vectors, shrinkage).applied(vectors, 2.0), expected, atol=1e-9)


def test_whitening_that_was_saved_is_the_same_on_every_robot(tmp_path):
    fitted, rows = Whitening.fit(correlated(100)), correlated(20, seed=7)
    fitted.save(tmp_path / "whitening.npz")
    np.testing.assert_array_equal(
        Whitening.load(tmp_path / "whitening.npz").applied(rows, 1.0), fitted.applied(rows, 1.0)
    )


def _cut(path):
    path.write_bytes(path.read_bytes()[:-200])


def _flip(path):
    content = bytearray(path.read_bytes())
    content[300] ^= 0xFF
    path.write_bytes(content)


def _without_axes(path):
    with np.load(path) as file:
        np.savez(path, **{key: file[key] for key in ("mean", "gains", "rest")})


def _nan(path):
    with np.load(path) as file:
        np.savez(path, **(dict(file) | {"rest": np.nan}))


def _other_shape(path):
    with np.load(path) as file:
        np.savez(path, **(dict(file) | {"gains": file["gains"][:-1]}))


def _text(path):
    path.write_text("mean")


def _array(path):
    with path.open("wb") as file:
        np.save(file, np.ones(3))


@pytest.mark.parametrize("damage", [_cut, _flip, _without_axes, _nan, _other_shape, _text, _array])
def test_a_damaged_or_foreign_whitening_file_is_refused(damage, tmp_path):
    path = tmp_path / "whitening.npz"
    Whitening.fit(correlated(100)).save(path)
    damage(path)
    with pytest.raises(ValueError, match=r"whitening\.npz: expected"):
        Whitening.load(path)


def test_whitening_wants_finite_vectors_of_one_length():
    with pytest.raises(ValueError, match="NaN"):
        Whitening.fit(np.full((3, 4), np.nan))
    with pytest.raises(ValueError, match="at least two"):
        Whitening.fit(np.ones((1, 4)))
    with pytest.raises(ValueError, match=r"shape \(n, 40\)"):
        Whitening.fit(correlated(50)).applied(np.ones((3, 4)), 1.0)


# What is described


def test_an_all_equal_vector_matches_non_negative_descriptors_until_they_are_whitened():
    standing = describe(correlated(200), foreign=correlated(200, seed=7), threshold=0.7)
    assert standing.as_is.equal == 1.0 == standing.as_is.foreign
    assert standing.whitened.equal < 0.05 and standing.whitened.foreign < 0.2
    assert standing.whitened.effective_dimension > 2 * standing.as_is.effective_dimension
    assert standing.whitened.bits > standing.as_is.bits
    words = " ".join(standing.advice)
    assert "all-equal vector matches 100% of them" in words and "Subtract a public mean" in words
    assert "whitening would make it better: effective dimension" in words and "instead of 100%" in words


def test_isotropic_descriptors_are_left_in_peace():
    standing = describe(isotropic(300, 200), foreign=isotropic(300, 200, seed=6), threshold=0.5)
    form = standing.as_is
    assert form.random == form.equal == form.foreign == form.own == 0.0
    assert form.effective_dimension > 180
    assert not any("hiten" in sentence for sentence in standing.advice[:-1])


def test_foreign_vectors_that_match_are_told():
    own = isotropic(100, 64)
    standing = describe(own, foreign=own[:50], threshold=0.9)
    assert standing.as_is.foreign == pytest.approx(1 / 99)  # the last row has none that follows it
    assert any("another place matches in 1.01% of" in sentence for sentence in standing.advice)


def test_without_foreign_ones_it_says_what_it_does_not_know():
    standing = describe(isotropic(100, 64), threshold=0.9)
    assert standing.as_is.foreign is None and standing.foreign_count is None
    assert any("--foreign" in sentence for sentence in standing.advice)
    assert "first half of the descriptors themselves" in standing.statistics_of


def drive(count=300, dim=100, seed=3):
    """Descriptors along a path: each resembles the one before."""
    steps = rng(seed).standard_normal((count, dim))
    for at in range(1, count):
        steps[at] = 0.9 * steps[at - 1] + np.sqrt(1 - 0.81) * steps[at]
    return unit(steps)


@pytest.mark.parametrize("score", ["S10", "S6"])
def test_suggested_thresholds_keep_foreign_places_out_and_neighbours_in(score):
    own, foreign = drive(), isotropic(300, 100, seed=8)
    standing = describe(own, foreign=foreign, score=score, neighbours=30)
    lax, strict = standing.as_is.thresholds
    sign = 1 if score == "S10" else -1
    assert sign * lax < sign * strict and standing.threshold == lax and not standing.threshold_given
    assert standing.as_is.foreign <= 2e-4
    near = np.diagonal(score_table(score, own, own), offset=1)
    assert (sign * near >= sign * strict).mean() == pytest.approx(0.5, abs=0.01)


def test_long_drives_are_thinned_and_their_neighbours_stay_direct_ones(monkeypatch):
    own, foreign = drive(900), isotropic(300, 100, seed=8)
    whole = describe(own, foreign=foreign, neighbours=30)
    monkeypatch.setattr("protocols.check.description.MOST_ROWS", 200)
    few = describe(own, foreign=foreign, neighbours=30)
    assert few.as_is.thresholds[1] == pytest.approx(whole.as_is.thresholds[1], abs=0.02)
    assert few.as_is.effective_dimension == pytest.approx(whole.as_is.effective_dimension, rel=0.15)
    assert few.count == whole.count == 900
    assert (
        describe(own, neighbours=200).as_is.effective_dimension > 1
    )  # 200 of 900, not of those that are kept


def test_an_l1_score_is_described_too():
    standing = describe(drive(700), foreign=isotropic(100, 100, seed=8), score="S2", neighbours=30)
    lax, strict = standing.as_is.thresholds
    assert lax > strict and standing.as_is.bits is None and standing.as_is.foreign < 1e-3


def test_where_nothing_tells_places_apart_no_threshold_is_suggested():
    standing = describe(isotropic(200, 50), foreign=isotropic(200, 50, seed=6))
    assert standing.as_is.thresholds is None and standing.threshold is None and standing.as_is.random is None
    (said,) = (sentence for sentence in standing.advice if "no threshold tells them apart" in sentence)
    assert "Nor whitened" in said and "hiten" not in " ".join(set(standing.advice) - {said})


def test_what_whitening_makes_worse_is_called_so_and_what_stays_is_left_out():
    unchanged, changed = Form(128, 0, 0.02, 0.5, 0, 9, None), Form(87, 0, 0.02, 0.001, 0, 9, None)
    rows = isotropic(60, 30)
    standing = dataclasses.replace(
        describe(rows, threshold=0.9), as_is=unchanged, centred=unchanged, whitened=changed
    )
    (said,) = (sentence for sentence in advice(standing) if "would make it" in sentence)
    assert said == (
        "whitening would make it better: foreign ones match 0.10% instead of 50.0%; "
        "and worse: effective dimension 87 instead of 128."
    )


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0%"), (1.1e-5, "below 0.01%"), (1e-4, "0.01%"), (0.034, "3.40%"), (0.56, "56.0%"),
     (0.9999, "99.9%"), (1.0, "100%")],
)  # fmt: skip
def test_every_share_is_told_in_percent(share, words):
    assert percent(share) == words


def test_the_suggested_threshold_is_not_called_too_lax():
    standing = describe(drive(), foreign=isotropic(300, 100, seed=8), neighbours=30)
    assert 1e-4 < standing.as_is.foreign < 1.5e-4
    assert not any("another place matches in" in sentence for sentence in standing.advice)


def test_a_lax_threshold_is_told():
    own, foreign = drive(), isotropic(300, 100, seed=8)
    lax = describe(own, foreign=foreign, threshold=0.1, neighbours=30)
    assert any("0.1 is laxer" in sentence for sentence in lax.advice)


def test_norms_are_held_against_what_a_robot_refuses():
    rows = isotropic(60, 30)
    rows[7] *= 1.7
    standing = describe(rows, threshold=0.9)
    assert standing.norms.outside == 1 and standing.norms.most == pytest.approx(1.7)
    encode(rows, max_norm=standing.norms.advised)
    with pytest.raises(ValueError, match="norm"):
        encode(rows, max_norm=0.99 * standing.norms.advised)
    assert any(f"--max-norm {standing.norms.advised:g}" in sentence for sentence in standing.advice)


def test_unit_vectors_need_max_norm_1_although_rounding_lengthens_some():
    rows = isotropic(200, 300)
    standing = describe(rows, threshold=0.9)
    assert standing.norms.outside == 0 and standing.norms.advised == 1.0


@pytest.mark.parametrize("scale", [1.2345e-3, 0.33333, 31.234, 4.0321e5])
def test_the_advised_norm_serves_descriptors_of_any_size(scale):
    rows = scale * isotropic(60, 30)
    advised = describe(rows, score="S7", threshold=0.9).norms.advised
    encode(rows, max_norm=advised)
    assert advised < 1.02 * scale + 1e-4


def test_bad_rows_are_counted_and_left_out():
    rows = np.concatenate([isotropic(60, 30), np.zeros((2, 30)), isotropic(60, 30)[:3], np.zeros((3, 30))])
    rows[-3:, 4] = np.nan, np.inf, 1e300
    standing = describe(rows, threshold=0.9)
    assert (standing.count, standing.unusable, standing.zero, standing.duplicates) == (68, 3, 2, 3)
    assert standing.norms.most == pytest.approx(1.0)
    assert [sentence.split()[0] for sentence in standing.advice[:3]] == ["3", "2", "3"]


def test_a_distance_wants_a_least_norm():
    assert any("--min-norm" in sentence for sentence in describe(isotropic(60, 30), score="S6").advice)
    assert not any("--min-norm" in sentence for sentence in describe(isotropic(60, 30), score="S5").advice)


def test_numbers_that_vanish_are_told():
    rows = 1e-6 * isotropic(60, 300)
    rows[:, 0] = 1.0
    standing = describe(rows, threshold=0.9)
    assert standing.vanished > 0.9 and any("become zero" in sentence for sentence in standing.advice)


@pytest.mark.parametrize(
    ("rows", "options", "words"),
    [
        (np.ones(8), {}, r"shape \(n, N\).*\(8,\)"),
        (np.ones((0, 8)), {}, r"\(0, 8\)"),
        (np.array([["a"]]), {}, "integers or floats"),
        (np.ones((5, 8)), {}, "at least 28 descriptors .* got 5 of 5"),
        (np.ones((50, 8)), {"neighbours": 500}, "at least 2008 descriptors .*--neighbours 500"),
        (isotropic(50, 8), {"threshold": 5.0}, "5 lets no pair match: no S10 is above 1 "),
        (isotropic(50, 8), {"threshold": -0.1, "score": "S6"}, "no pair match: a distance"),
        (2 * isotropic(50, 8), {"threshold": 4.1}, "no S10 is above 4"),
        (np.full((50, 8), np.nan), {}, "got 0 of 50"),
        (np.ones((50, 8)), {"foreign": np.ones((50, 9))}, "expected 8 numbers a row .* got 9"),
        (np.ones((50, 8)), {"foreign": np.zeros((50, 8))}, "foreign descriptors: none"),
        (np.ones((50, 8)), {"score": "S11"}, "unknown score 'S11'"),
        (np.ones((50, 8)), {"threshold": float("nan")}, "finite threshold"),
        (np.ones((50, 8)), {"max_norm": 0.0}, "max_norm"),
    ],
)
def test_what_cannot_be_described_is_refused(rows, options, words):
    with pytest.raises(ValueError, match=words):
        describe(rows, **options)


# The command


def test_the_command_prints_figures_and_advice(tmp_path):
    np.save(tmp_path / "a.npy", correlated(120).astype(np.float32))
    np.save(tmp_path / "b.npy", correlated(120, seed=7))
    result = check(tmp_path / "a.npy", "--foreign", tmp_path / "b.npy", "--threshold", 0.7)
    assert result.returncode == 0 and not result.stderr
    assert "an all-equal vector matches" in result.stdout and "- An all-equal vector" in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 110


def test_without_a_threshold_there_is_no_row_of_dashes(tmp_path):
    np.save(tmp_path / "a.npy", isotropic(200, 16))
    text = check(tmp_path / "a.npy").stdout
    assert "give --threshold to see how often they match" in text and " - " not in text
    assert "0 outside --max-norm 1\n" in text


def test_json_has_every_field(tmp_path):
    np.save(tmp_path / "a.npy", isotropic(60, 16))
    (line,) = check(tmp_path / "a.npy", "--json").stdout.splitlines()
    assert set(json.loads(line)) == {"file"} | {field.name for field in dataclasses.fields(Standing)}


def test_a_picture_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    np.save(tmp_path / "a.npy", isotropic(60, 16))
    result = check(tmp_path / "a.npy", "--threshold", 0.9, "--plot", tmp_path / "scores.png")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "scores.png").read_bytes().startswith(b"\x89PNG")


def test_a_missing_matplotlib_is_told_with_a_command(tmp_path):
    np.save(tmp_path / "a.npy", isotropic(60, 16))
    code = "import sys; sys.modules['matplotlib'] = None; from spdz.__main__ import main; sys.exit(main())"
    command = [
        sys.executable,
        "-c",
        code,
        "check",
        str(tmp_path / "a.npy"),
        "--plot",
        str(tmp_path / "p.png"),
    ]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2 and "pip install matplotlib" in result.stderr
    assert "Traceback" not in result.stderr and not result.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["missing.npy"], "cannot read descriptors from missing.npy"),
        (["three.npy"], "at least 28"),
        (["good.npy", "--neighbours", "-1"], "--neighbours"),
        (["good.npy", "--plot", "no/such/folder.png", "--threshold", "0.9"], "no/such"),
        (["good.npy", "--plot", "picture.qqq", "--threshold", "0.9"], "qqq"),
    ],
)
def test_bad_input_is_one_line_and_json_where_asked(words, message, tmp_path, monkeypatch):
    if "--plot" in words:
        pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    np.save("good.npy", isotropic(60, 16))
    np.save("three.npy", isotropic(3, 16))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    plain, as_json = check(*words), check(*words, "--json")
    assert plain.returncode == as_json.returncode == 2 and not plain.stdout
    assert message in plain.stderr and plain.stderr.count("\n") == 1
    assert message in json.loads(as_json.stdout)["message"] and not as_json.stderr
