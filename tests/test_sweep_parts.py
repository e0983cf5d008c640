"""The parts of the sweep: its cells, its baselines, and where a comparison's time goes."""

import cProfile
import math
import pstats
import re
from pathlib import Path

import numpy as np
import pytest

import spdz
from bench.exact import exact_score, raw
from bench.inputs import draw
from bench.sweep.baseline import compiled, find_compiler
from bench.sweep.cells import PRINTED, PROTOCOLS, SIZES, TRIALS, cells
from bench.sweep.machine import machine, source_digest
from bench.sweep.phases import COMPILED, PHASES, RULES, phase_of, phases, scaled
from bench.sweep.plain import PLAIN
from bench.sweep.stands import PAPER_TRIALS, STANDS_FOR, STATEMENT
from protocols.scores import SCORES
from spdz.local import run_local

ROOT = Path(spdz.__file__).parent.parent


# What is measured


def test_the_whole_sweep_is_the_papers():
    todo = list(cells(list(SCORES), SIZES, PROTOCOLS))
    assert len(todo) == len(set(todo)) == 10 * 9 * 4
    stands = sum(len(names) for names in STANDS_FOR.values())
    assert stands * len(SIZES) * len(SCORES) * TRIALS == PAPER_TRIALS
    assert set(STANDS_FOR) == set(PROTOCOLS)
    assert all(name in STATEMENT for names in STANDS_FOR.values() for name in names if name != "Baseline")


def test_quick_measures_what_the_papers_table_prints():
    todo = list(cells(list(SCORES), SIZES, PROTOCOLS, quick=True))
    assert len(todo) == 4 * 24 and {cell.n for cell in todo} == set(SIZES)
    assert all(cell.score in PRINTED[cell.n] for cell in todo)


def test_what_is_compared_is_measured_side_by_side():
    found = [(cell.score, cell.protocol) for cell in cells(["S2", "S10"], [16], ["cpp", "malicious"])]
    assert found == [("S2", "malicious"), ("S2", "cpp"), ("S10", "malicious"), ("S10", "cpp")]


# The baselines


def pairs(n):
    x, y = draw("unit", 3, n, 5)
    return np.rint(x * 65536) / 65536, np.rint(y * 65536) / 65536


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("n", [16, 300])
def test_numpy_computes_the_scores(score, n):
    for x, y in zip(*pairs(n), strict=True):
        assert PLAIN[score](x, y) == pytest.approx(float(exact_score(score, raw(x), raw(y))), abs=1e-12)


@pytest.mark.skipif(find_compiler() is None, reason="no C++ compiler")
def test_cpp_computes_the_scores_and_takes_longer_for_longer_vectors():
    quickest = {}
    with compiled(find_compiler()) as baseline:
        for score in SCORES:
            for n in (16, 1500):
                x, y = pairs(n)
                values, seconds = baseline.measure(score, x, y)
                exact = [float(exact_score(score, raw(a), raw(b))) for a, b in zip(x, y, strict=True)]
                assert values == pytest.approx(exact, abs=1e-12)
                quickest[score, n] = min(seconds)
    assert not baseline.program.exists()
    assert all(quickest[score, 1500] > 5 * quickest[score, 16] > 0 for score in SCORES)


def test_a_compiler_that_is_not_there_is_none(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert find_compiler() is None


# Where the time goes


def test_every_rule_is_about_something_that_exists():
    for place, phase in RULES:
        path, _, function = place.partition(":")
        assert (place == COMPILED or (ROOT / path).exists()) and phase in PHASES
        assert not function or f"def {function}(" in (ROOT / path).read_text()


def test_modules_count_for_what_they_are_for():
    def of(place, function="f"):
        return phase_of((str(ROOT / place), 1, function))

    assert of("spdz/channels/tcp.py") == "network"
    assert of("spdz/arithmetic/prf.py") == "aes" and of("spdz/arithmetic/field.py") == "field"
    assert of("spdz/rounds/mac_check.py") == "mac_check"
    assert of("spdz/rounds/mac_check.py", "drive") == "rest"
    assert (
        of("spdz/compiled/kernels.py", "words_of") == of("spdz/compiled/kernels.py", "mask_words") == "mask"
    )
    assert of("spdz/compiled/kernels.py", "element_of") == "network"
    assert of("spdz/compiled/kernels.py", "element_limbs") == "field"
    assert of("spdz/session/session.py") == of("protocols/scores.py") == "rest"
    assert phase_of(("~", 0, "<method 'sendto'>")) is None
    assert phase_of(("~", 0, "<method 'update' of 'cryptography.x'>")) == "aes"
    assert phase_of((np.__file__, 1, "f")) is None


def test_what_is_foreign_counts_for_whoever_called_it():
    """A function of the channel's that only sleeps or adds arrays is all network."""
    source = "import numpy, time\ndef f():\n    time.sleep(0.03)\n    numpy.median(numpy.zeros(100_000))\n"
    scope: dict = {}
    exec(compile(source, str(ROOT / "spdz/channels/frames.py"), "exec"), scope)
    profile = cProfile.Profile()
    profile.runcall(scope["f"])
    found = phases(profile)
    assert tuple(found) == PHASES and found["network"] > 0.03
    assert found["network"] > 0.99 * sum(found.values())


def test_a_comparisons_time_is_all_accounted_for():
    profile = cProfile.Profile()
    x, y = pairs(16)
    profile.runcall(run_local, SCORES["S1"], x[0], y[0], "malicious")
    found = phases(profile)
    own = sum(row[2] for row in pstats.Stats(profile).stats.values())
    assert sum(found.values()) == pytest.approx(own, rel=1e-6)
    assert all(found[phase] > 0 for phase in ("mask", "field", "aes", "mac_check", "rest"))


def test_scaled_phases_sum_to_the_whole():
    assert scaled({"mask": 1.0, "rest": 3.0}, 2.0) == {"mask": 0.5, "rest": 1.5}
    assert scaled({"mask": 0.0}, 2.0) == {"mask": 0.0}


# What it ran on


def test_the_machine_is_told():
    told = machine()
    assert list(told) == ["cpu", "cores", "system", "python", "numpy", "spdz"] and all(told.values())
    assert re.fullmatch("[0-9a-f]{12}", source_digest()) and math.isfinite(told["cores"])
