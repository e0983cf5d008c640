"""Thresholds that do not do what their user wants are told, and no others."""

import math

import numpy as np
import pytest

from protocols.catalog import Purpose, threshold_warning
from protocols.scores import SCORES
from spdz import run_clear

DIM = 16


def warning(score, threshold, max_norm=1.0, reveal="bit"):
    return threshold_warning(Purpose(score, DIM, reveal=reveal, max_norm=max_norm), threshold)


@pytest.mark.parametrize("max_norm", [0.5, 1.0, 30.0])
@pytest.mark.parametrize("score", SCORES)
def test_extreme_descriptors_reach_the_ends_of_the_range(score, max_norm):
    """Of opposite, equal and spread vectors of the largest norm; within what rounding inputs does."""
    least, most = Purpose(score, DIM, max_norm=max_norm).score_range
    spread = np.full(DIM, max_norm / math.sqrt(DIM))
    axes = np.eye(DIM)[:2] * max_norm
    pairs = [(spread, -spread), (spread, spread), (axes[0], axes[1]), (axes[0], -axes[0])]
    values = [float(run_clear(SCORES[score].within(max_norm), x, y).value) for x, y in pairs]
    assert min(values) == pytest.approx(least, abs=1e-3 * most)
    assert max(values) == pytest.approx(most, rel=1e-3)


@pytest.mark.parametrize(
    ("score", "threshold", "max_norm", "says"),
    [
        ("S10", -1.0, 1.0, "every pair"),
        ("S7", -1.5, 1.0, "every pair"),
        ("S10", 1.01, 1.0, "no pair"),
        ("S8", 2.0, 1.0, "no pair"),
        ("S10", 901.0, 30.0, "no pair"),
        ("S10", 1.0, 1.0, "up to rounding"),
        ("S10", 1.0, 2.0**22, "up to rounding"),
        ("S9", 1.0, 5.0, "up to rounding"),
        ("S7", 0.99999, 1.0, "up to rounding"),
        ("S6", -0.1, 1.0, "never negative"),
        ("S2", -1e-9, 1.0, "never negative"),
        ("S6", 4.0, 1.0, "every pair"),
        ("S4", 2.0, 1.0, "every pair"),
        ("S1", 2.0, 1.0, "every pair"),
        ("S2", 8.0, 1.0, "every pair"),
        ("S3", 2.5, 1.0, "every pair"),
        ("S5", 4.0, 7.0, "every pair"),
        ("S1", 0.0, 1.0, "up to rounding"),
        ("S3", 1e-5, 1.0, "up to rounding"),
        ("S5", 0.0, 1.0, "up to rounding"),
        ("S6", 2.1, 1.0, "give t*t"),
        ("S5", 2.1, 9.0, "give t*t"),
        ("S6", 20.0, 3.0, "give t*t"),
        ("S4", 1.5, 1.0, "sqrt(s), or deal for S6"),
        ("S3", 1.5, 9.0, "sqrt(s), or deal for S5"),
    ],
)
def test_a_threshold_out_of_range_or_past_a_right_angle_is_told(score, threshold, max_norm, says):
    told = warning(score, threshold, max_norm)
    assert told is not None and says in told and f"{threshold:g}" in told and "\n" not in told


@pytest.mark.parametrize(
    ("score", "threshold", "max_norm"),
    [
        ("S10", 0.8, 1.0),
        ("S10", 0.0, 1.0),
        ("S10", -0.5, 1.0),
        ("S10", 0.8, 2.0**22),
        ("S10", 5e6, 2.0**22),
        ("S7", 0.999, 1.0),
        ("S8", 0.42, 3.0),
        ("S6", 0.0169, 1.0),
        ("S6", 0.0, 1.0),
        ("S6", 1.9, 1.0),
        ("S6", 500.0, 2.0**22),
        ("S4", 0.13, 1.0),
        ("S4", 0.0, 1.0),
        ("S4", 1.4, 1.0),
        ("S3", 0.5, 1.0),
        ("S5", 1e-6, 1.0),
        ("S2", 5.0, 1.0),
        ("S2", 0.0, 1.0),
        ("S1", 1.9, 1.0),
    ],
)
def test_ordinary_thresholds_are_not_warned_of(score, threshold, max_norm):
    assert warning(score, threshold, max_norm) is None


def test_without_a_threshold_or_a_number_there_is_nothing_to_say():
    assert warning("S10", None, reveal="score") is warning("S10", 7.0, reveal="score") is None
    assert warning("S10", math.nan) is warning("S6", math.inf) is None
    with pytest.raises(ValueError, match="finite"):
        Purpose("S10", DIM).program(math.nan)


@pytest.mark.parametrize("score", SCORES)
def test_only_the_squared_distances_carry_a_hint(score):
    hint = Purpose(score, DIM).hint
    assert (hint is not None) == (score in ("S5", "S6"))
    assert hint is None or hint.startswith(f"{score} is the squared distance")
