"""Comparisons are dealt where they are used: every reading must come to the same place, whatever the use.

Random programs of comparisons and of what one does with their bits, read by the meter, the dealer, both
parties and in the clear, and held to the exact numbers of NumPy. SPDZ_COMPARISONS is how many are run
(default 60 in either security mode).
"""

import os
import random

import numpy as np
import pytest

from spdz import mask, maximum, measure, multiply, nonnegative, parallel, run_clear, run_local
from spdz.readings.meter import Meter
from spdz.values.value import concatenate

COUNT = int(os.environ.get("SPDZ_COMPARISONS", "60"))
MOST = 1000
"""No number of a program is larger: all of them stay far from the engine's bounds."""

X, Y = np.array([0.5, -0.25, 0.0, -1.0]), np.array([0.5, 0.75, -0.5, -1.0])
SECURITIES = pytest.mark.parametrize("security", ["malicious", "semi-honest"])


async def product(engine, a, b):
    first, second = await mask(a, b)
    return multiply(first, second)


async def bit_again(engine, a):
    return await nonnegative(a - 1)


async def used_in_a_lane(engine, a, b):
    async def lane():
        (masked,) = await mask(b - a)
        return masked * 2

    first, second = await parallel(lane(), nonnegative(a + b))
    return first + second


async def larger(engine, a, b):
    return await maximum(a, b)


def at_once(function):
    async def waiting(engine, *values):
        return function(engine, *values)

    return waiting


SOURCES = {
    "x": (lambda x, y: nonnegative(x), lambda x, y: x >= 0),
    "x within a bound": (lambda x, y: nonnegative(x, 1 << 20), lambda x, y: x >= 0),
    "x - y": (lambda x, y: nonnegative(x - y), lambda x, y: x >= y),
    "a threshold": (lambda x, y: nonnegative(0.5 - y), lambda x, y: y <= 0.5),
    "a product": (lambda x, y: nonnegative(multiply(x, y)), lambda x, y: x * y >= 0),
}
"""Comparisons: of masked values, of which nothing has been opened, and of computed ones."""

USES = {
    "sum": (at_once(lambda e, a, b: a + b), lambda a, b: a + b),
    "difference": (at_once(lambda e, a, b: a - b), lambda a, b: a - b),
    "sum with itself": (at_once(lambda e, a: a + a), lambda a: 2 * a),
    "negated": (at_once(lambda e, a: -a), lambda a: -a),
    "not": (at_once(lambda e, a: 1 - a), lambda a: 1 - a),
    "scaled": (at_once(lambda e, a: a * 3), lambda a: 3 * a),
    "plus 0": (at_once(lambda e, a: a + 0), lambda a: a),
    "indexed": (at_once(lambda e, a: a[::-1]), lambda a: a[::-1]),
    "reshaped": (at_once(lambda e, a: a.reshape(2, 2).reshape(4)), lambda a: a),
    "joined": (at_once(lambda e, a, b: concatenate(a[:2], b)[:4]), lambda a, b: np.append(a[:2], b[:2])),
    "joined alone": (at_once(lambda e, a: concatenate(a)), lambda a: a),
    "bounded": (at_once(lambda e, a: a.bounded(a.bound)), lambda a: a),
    "as it is": (at_once(lambda e, a: a.rescaled(a.frac).broadcast(a.shape)), lambda a: a),
    "shared": (at_once(lambda e, a: e.shared(a)), lambda a: a),
    "shared in vain": (at_once(lambda e, a: (e.shared(a), a)[1]), lambda a: a),
    "broadcast": (at_once(lambda e, a: a.broadcast((3, 4))[1]), lambda a: a),
    "total": (at_once(lambda e, a: a.sum() + a), lambda a: a.sum() + a),
    "product": (product, lambda a, b: a * b),
    "compared": (bit_again, lambda a: a >= 1),
    "used in a lane": (used_in_a_lane, lambda a, b: 2 * (b - a) + (a + b >= 0)),
    "larger": (larger, np.maximum),
}
ENDS = {
    "itself": (lambda a: a, lambda a: a),
    "one entry": (lambda a: a[1], lambda a: a[1]),
    "total": (lambda a: a.sum(), lambda a: a.sum()),
    "table": (lambda a: a.reshape(2, 2), lambda a: a.reshape(2, 2)),
}
ARITIES = {name: secure.__code__.co_argcount - 1 for name, (secure, _) in USES.items()}
ARITIES |= {
    name: exact.__code__.co_argcount for name, (_, exact) in USES.items() if hasattr(exact, "__code__")
}


class Program:
    """A drawn program: comparisons, of which two may be made in lanes, uses of their bits, and one result."""

    def __init__(self, seed):
        pick = random.Random(seed)
        self.seed = seed
        self.sources = [pick.choice(list(SOURCES)) for _ in range(pick.randint(1, 4))]
        self.in_lanes = pick.random() < 0.4
        self.steps = []
        numbers = [np.asarray(SOURCES[name][1](X, Y), dtype=int) for name in self.sources]
        for _ in range(pick.choice([0, 0, 1, 2, 3, 4, 5])):
            name = pick.choice(list(USES))
            of = [pick.randrange(len(numbers)) for _ in range(ARITIES[name])]
            number = np.asarray(USES[name][1](*(numbers[i] for i in of)), dtype=int)
            if np.abs(number).max() <= MOST:
                self.steps.append((name, of))
                numbers.append(number)
        self.result = pick.choice([len(numbers) - 1, pick.randrange(len(numbers))])
        self.end = pick.choice(["itself", *ENDS])
        self.exact = ENDS[self.end][1](numbers[self.result])

    def __str__(self):
        return f"{self.seed}: {self.sources} {self.in_lanes} {self.steps} {self.result} {self.end}"

    async def __call__(self, engine, x, y):
        comparisons = [SOURCES[name][0](x, y) for name in self.sources]
        if self.in_lanes:
            values = await parallel(*comparisons)
        else:
            values = [await one for one in comparisons]
        self.seen[(type(engine).__name__, getattr(engine, "index", None))] = list(values)
        for name, of in self.steps:
            values.append(await USES[name][0](engine, *(values[i] for i in of)))
        return ENDS[self.end][0](values[self.result])

    seen = {}  # noqa: RUF012


def hold(program, security):
    """Run a program in every reading and compare."""
    program.seen = {}
    plan = measure(program, (X.shape, Y.shape), security)
    secure, clear = run_local(program, X, Y, security), run_clear(program, X, Y)
    for result in (secure, clear):
        np.testing.assert_array_equal(np.asarray(result.value, dtype=float), program.exact, str(program))
    assert type(secure.value) is type(clear.value), str(program)
    assert np.asarray(secure.value).dtype == np.asarray(clear.value).dtype, str(program)
    for party, stats in enumerate(secure.stats):
        assert stats.rounds == plan.rounds, str(program)
        assert stats.field_elements_sent == plan.elements_sent[party], str(program)
        assert stats.correlations == plan.correlations, str(program)
    meter, *others = [
        [value.undecided for value in program.seen[key]]
        for key in (("Meter", None), ("DealtJob", None), ("Party", 0), ("Party", 1))
    ]
    assert all(other == meter for other in others), str(program)
    return plan, meter


@SECURITIES
@pytest.mark.parametrize("chunk", range(6))
def test_random_uses_of_comparisons_are_right_in_every_reading(security, chunk):
    for seed in range(chunk, COUNT, 6):
        hold(Program(f"{security} {seed}"), security)


def single(source, *steps, end="itself"):
    """A program of one comparison and uses of the latest value."""
    program = Program("none")
    program.sources, program.in_lanes, program.steps, program.end = [source], False, [], end
    number = np.asarray(SOURCES[source][1](X, Y), dtype=int)
    for i, name in enumerate(steps):
        program.steps.append((name, [i] * ARITIES[name]))
        number = np.asarray(USES[name][1](*[number] * ARITIES[name]), dtype=int)
    program.result, program.exact = len(steps), ENDS[end][1](number)
    return program


@SECURITIES
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("use", USES)
def test_every_use_of_every_comparison(use, source, security):
    """All that nothing but the result needs is opened as bits; all else has shares in the field."""
    plan, (undecided,) = hold(single(source, use), security)
    assert undecided == (use == "as it is")
    assert (plan.correlations["opened sign"] > 0) == (use in ("as it is", "compared"))


@SECURITIES
@pytest.mark.parametrize("end", ENDS)
def test_every_way_to_end_with_a_comparison(end, security):
    plan, _ = hold(single("a product", end=end), security)
    kind, other = ("opened sign", "comparison")[:: 1 if end == "itself" else -1]
    assert plan.correlations[kind] == 4 and not plan.correlations[other]


@SECURITIES
def test_what_nothing_uses_is_not_dealt(security):
    program = single("x")
    program.sources = ["x", "x - y", "a threshold"]
    program.result, program.exact = 1, X >= Y
    plan, undecided = hold(program, security)
    assert plan.correlations["opened sign"] == 4 and not plan.correlations["comparison"]
    assert undecided == [True] * 3


@SECURITIES
def test_two_comparisons_of_one_value_have_keys_of_their_own(security):
    async def program(engine, x, y):
        (z,) = await mask(multiply(x, y))
        used, opened = await nonnegative(z), await nonnegative(z)
        meter = isinstance(engine, Meter)
        before = engine.correlations["comparison"] if meter else 0
        total = used + used
        assert not meter or engine.correlations["comparison"] == before + 4
        assert opened.undecided and not used.undecided and total.shape == (4,)
        return opened

    plan, secure = measure(program, (X.shape, Y.shape), security), run_local(program, X, Y, security)
    assert plan.correlations["opened sign"] == plan.correlations["comparison"] == 4
    assert list(secure.value) == list(X * Y >= 0)
