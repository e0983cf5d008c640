"""Compiled code against the ordinary reading: programs of every gate and form, and what is not compiled."""

import os
from collections import Counter
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import pytest
from compiled_helpers import SECURITIES, deal, hold_honest, unit_vectors
from compiled_programs import LONG, PROGRAMS, SHORT
from random_programs import draw

import spdz
from protocols.scores import S4, S6, S10, SCORES
from spdz import dot, nonnegative
from spdz.compiled import arithmetic, shapes
from spdz.compiled.slots import NotCompiled
from spdz.gates.decision import decided
from spdz.gates.interval import inside
from spdz.values import input_mask
from spdz.values.columns import columns

COUNT = int(os.environ.get("SPDZ_RANDOM_PROGRAMS", "120"))
SEED = int(os.environ.get("SPDZ_RANDOM_SEED", "1"))


@pytest.mark.parametrize("few", [64, 2])
def test_random_programs_are_compiled_as_they_are_read(few):
    """With few = 2 almost all numbers are arrays."""
    ends = Counter()
    with patch.object(shapes, "FEW", few), patch("spdz.compiled.record.FEW", few):
        for index in range(COUNT):
            program = draw(SEED, index)
            if program.x.ndim > 1 or program.y.ndim > 1:
                continue
            try:
                job = deal(program, (program.x, program.y), program.security)
                codes = job.codes
            except ValueError:  # such a program is not dealt for
                ends["refused"] += 1
                continue
            assert codes
            hold_honest(job)
            ends["compiled"] += 1
    assert ends["compiled"] > COUNT // 3 and ends["refused"] < COUNT // 10, ends


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("n", [10, 70])
def test_a_program_is_compiled_as_it_is_read(name, n):
    for norm in (SHORT, LONG):
        with patch.object(PROGRAMS[name], "max_norm", norm):
            for security in SECURITIES:
                hold_honest(deal(PROGRAMS[name], unit_vectors(n), security))


@pytest.mark.parametrize("n", [5, 70])
@pytest.mark.parametrize("length", [2.0**-14, 8.0, 2.0**22])
def test_norms_from_the_smallest_to_the_largest(n, length):
    """A mask is short or long as norm and length ask."""
    forms = set()
    for score in (S4, S6, S10):
        program = score.within(length)
        for security in SECURITIES:
            job = deal(program, unit_vectors(n, length=length), security)
            hold_honest(job)
            forms.add(input_mask.job_bits((n,), job.plan.inputs[0].norm) == input_mask.LONG)
    assert forms == {length == 2.0**22}


def test_vectors_of_two_lengths():
    async def program(engine, x, y):
        return dot(x[:5], y[:5]) + x.sum() - y.sum()

    for shape in ((5, 70), (70, 5), (70, 71)):
        x, y = (unit_vectors(n)[0] for n in shape)
        for security in SECURITIES:
            hold_honest(deal(program, (x, y), security))


# -- what is not compiled ---------------------------------------------------------------------------------


async def _columns(engine, x, y):
    return dot(columns(x, 1, 3), columns(y, 1, 3))


async def _decided(engine, x, y):
    (bits,) = await decided(await nonnegative(x - y))
    return bits.sum()


async def _inside(engine, x, y):
    await inside(dot(x, x), 0, 1 << 40)
    return dot(x, y)


def _looking(what):
    async def program(engine, x, y):
        if engine.index == 0:  # a party, and neither meter nor dealer
            what((x - y).parts[0])
        return dot(x, y)

    return program


LOOKS = {
    "bool": bool,
    "equal": lambda number: number == 0,
    "below": lambda number: number < 5,
    "index": lambda number: number[0],
    "minus": lambda number: -number,
    "array": np.asarray,
    "or": lambda number: number | 1,
    "float": float,
    "in": lambda number: 0 in number,
    "attribute": lambda number: number.sum(),
}


@pytest.mark.parametrize("program", [_columns, _decided, _inside], ids=lambda one: one.__name__)
@pytest.mark.parametrize("n", [4, 70])
def test_what_looks_at_numbers_on_its_way_is_not_compiled(program, n):
    for security in SECURITIES:
        job = deal(program, unit_vectors(n), security)
        for index in (0, 1):
            with pytest.raises(NotCompiled):
                job.code(index)


@pytest.mark.parametrize("name", LOOKS)
def test_no_operation_of_a_number_that_is_not_there_goes_unnoticed(name):
    plan_of = deal(S10.within(1.0), unit_vectors(4))
    with pytest.raises(NotCompiled):
        spdz.compiled.record.compiled(_looking(LOOKS[name]), plan_of.plan, 0, "malicious")


def test_a_proof_of_norms_is_not_compiled_where_there_is_one():
    job = deal(S10.within(1.0, min_norm=0.5, prove=True), unit_vectors(5), "malicious")
    with pytest.raises(NotCompiled):
        job.code(0)
    hold_honest(deal(S10.within(1.0, min_norm=0.5, prove=True), unit_vectors(5), "semi-honest"))


@pytest.mark.parametrize("score", SCORES.values(), ids=list(SCORES))
def test_several_vectors_are_not_compiled(score):
    x, y = (np.stack([one, one]) for one in unit_vectors(3))
    with pytest.raises(NotCompiled, match="single vectors"):
        deal(score.within(1.0), (x, y), "semi-honest").code(0)


def test_a_dot_product_too_long_for_short_limbs_is_left_to_the_field():
    """Beyond ``kernels.LONGEST`` entries a sum of products of limbs might not be exact."""
    with patch.object(arithmetic.kernels, "LONGEST", 100):
        for n, joins in ((100, True), (101, False)):
            job = deal(S10.within(1.0), unit_vectors(n), "malicious")
            assert ("product_" in job.codes[0].code.source) == joins
            hold_honest(job)


@dataclass(frozen=True)
class _Named:
    """A kernel's name says nothing."""

    __name__: str


def test_a_name_hides_no_builtin_and_no_variable():
    trace = spdz.compiled.trace.Trace()
    kinds = ("sum", "min", "lambda", "v1", "data", "pad", "P", "run0", "Check", "a b", "", "sum")
    named = [trace.named(_Named(kind)) for kind in kinds]
    assert len(set(named)) == len(kinds)
    assert all(one.isidentifier() and one not in kinds and not hasattr(__builtins__, one) for one in named)
