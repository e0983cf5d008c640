"""What a slot says of its numbers is so: form and shape, how long they are, whether they are reduced."""

from collections import Counter
from math import prod
from unittest.mock import patch

import numpy as np
import pytest
from compiled_helpers import SECURITIES, deal, hold_honest, unit_vectors
from compiled_programs import PROGRAMS
from random_programs import draw

from protocols.scores import SCORES
from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.compiled import order, shapes, source


class Claims:
    """Has every line of the code that is compiled meanwhile hold its number to what its slot says."""

    def __init__(self):
        self.seen = Counter()

    def __enter__(self):
        write, line = source.written, order.line

        def written(trace, result):
            trace.names["claimed"] = self.claimed
            return write(trace, result)

        def checked(one):
            slot = one.target
            if slot is None or slot.form == "other":
                return line(one)
            told = f"{slot.form!r}, {slot.shape}, {slot.bits}, {slot.reduced}"
            return f"{line(one)}; claimed({slot.name}, {told})"

        self.patches = (
            patch("spdz.compiled.record.written", written),
            patch.object(source, "line", checked),
            patch.object(order, "line", checked),
        )
        for one in self.patches:
            one.start()
        return self

    def __exit__(self, *error):
        for one in self.patches:
            one.stop()

    def claimed(self, number, form, shape, bits, reduced):
        self.seen[form] += 1
        if form == "many":
            assert number.dtype == np.uint64 and number.shape == (*shape, 2)
            assert field.is_canonical(number)
            return
        if form == "words":
            assert np.asarray(number).dtype == np.int64 and np.shape(number) == shape
            numbers, most = np.asarray(number).ravel().tolist(), 1 << 63
        else:
            numbers, most = [number] if form == "one" else number, P
        assert len(numbers) == prod(shape)
        for one in numbers:
            assert type(one) is int and abs(one) < 1 << bits, (one, bits)
            assert not reduced or 0 <= one < most


def largest(n):
    """One coordinate as large as can be, and the rest nothing."""
    x, y = np.zeros((2, n))
    x[n // 2], y[n // 3] = 1.0, -1.0
    return x, y


@pytest.mark.parametrize("name", PROGRAMS)
def test_of_every_program(name):
    for n in (10, 70):
        for security, data in zip(SECURITIES, (largest(n), unit_vectors(n)), strict=True):
            with Claims() as claims:
                job = deal(PROGRAMS[name], data, security)
                hold_honest(job)
            assert claims.seen


@pytest.mark.parametrize("score", SCORES.values(), ids=list(SCORES))
def test_of_every_score(score):
    for n in (3, 70):
        for security in SECURITIES:
            with Claims() as claims:
                hold_honest(deal(score.within(1.0), largest(n), security))
            assert claims.seen["one"] and claims.seen["few" if n == 3 else "words"]


@pytest.mark.parametrize("few", [64, 2])
def test_of_random_programs(few):
    with Claims() as claims, patch.object(shapes, "FEW", few), patch("spdz.compiled.record.FEW", few):
        for index in range(60):
            program = draw(3, index)
            if program.x.ndim == program.y.ndim == 1:
                hold_honest(deal(program, (program.x, program.y), program.security))
    assert set(claims.seen) >= {"one", "few", "many"}
