"""Where the time of a compiled comparison goes, in real trials of the sweep."""

import cProfile
import pstats
import time
from functools import partial

import pytest

import bench.sweep.measuring
import bench.sweep.parties
from bench.sweep.cells import Cell
from bench.sweep.measuring import Bench
from bench.sweep.parties import SecureWork
from bench.sweep.phases import COMPILED, PHASES, phase_of
from bench.sweep.standing import StandingPair
from protocols.scores import SCORES
from spdz import measure
from spdz.compiled.programs import Programs

OWN_CLOCK = partial(cProfile.Profile, time.thread_time)
MODELS = ("malicious", "semi-honest")


class OnOwnClock(SecureWork):
    """The same work; its profiler counts processor time alone, which other processes do not add to."""

    def __call__(self, index, line):
        bench.sweep.parties.cProfile.Profile = OWN_CLOCK
        return super().__call__(index, line)


class Named(SecureWork):
    """The same work; its phases are what was called, and how often."""

    def __call__(self, index, line):
        bench.sweep.parties.phases = called
        return super().__call__(index, line)


def called(profile):
    return {f"{file} {name}": row[1] for (file, _, name), row in pstats.Stats(profile).stats.items()}


def phases_of(work, folder, monkeypatch, cells):
    monkeypatch.setattr(bench.sweep.measuring, "SecureWork", work)
    with StandingPair() as pair:
        return {cell: Bench(pair, None, folder, 1, 1).measure(cell)[-1].phases for cell in cells}


def test_compiled_arithmetic_is_field_and_little_is_left_over(tmp_path, monkeypatch):
    cells = [Cell(64, score, model) for score in ("S5", "S10") for model in MODELS]
    for cell, found in phases_of(OnOwnClock, tmp_path, monkeypatch, cells).items():
        whole = sum(found.values())
        assert found["field"] > 0.03 * whole, (cell, found)
        assert all(found[phase] > 0 for phase in ("mask", "network")), (cell, found)
        assert bool(found["mac_check"]) == (cell.protocol == "malicious"), (cell, found)
        if cell.score == "S5":  # one that computes: a session's bookkeeping is the same for each
            assert found["aes"] > 0 and found["rest"] < 0.25 * whole, (cell, found)


@pytest.mark.parametrize("model", MODELS)
def test_what_was_computed_ahead_is_in_no_trial(tmp_path, monkeypatch, model):
    cell = Cell(64, "S5", model)
    names = phases_of(Named, tmp_path, monkeypatch, [cell])[cell]
    assert f"{COMPILED} direct" in names
    assert f"{COMPILED} ahead" not in names and not any("ahead" in name.split()[-1] for name in names)
    assert not any(name.endswith(("streams.py __init__", "prf.py expand", "fsync>")) for name in names)


def test_compiled_code_has_the_name_that_the_rules_know():
    program, shapes = SCORES["S10"].within(1.0), ((16,), (16,))
    recipe = measure(program, shapes, "malicious").recipe
    code = Programs(shapes, "malicious", 0, recipe).ready(program, again=True)[1]
    assert code is not None and code.code.ahead.__code__.co_filename == COMPILED
    assert phase_of((COMPILED, 3, "direct")) == "field" and "field" in PHASES
