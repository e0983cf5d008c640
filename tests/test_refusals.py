"""What one gets wrong first in a program of one's own is refused in words, in every reading."""

import numpy as np
import pytest

from protocols import Score, is_candidate
from spdz import (
    absolute,
    beaver_dot,
    beaver_multiply,
    divide,
    dot,
    l1_normalised,
    l2_normalised,
    largest,
    mask,
    maximum,
    measure,
    multiply,
    nonnegative,
    parallel,
    power,
    reciprocal,
    reciprocal_sqrt,
    round_exactly,
    run_clear,
    run_local,
    sign,
    sqrt,
    truncate,
)

X, Y = np.array([0.5, -1.0, 2.0]), np.array([1.0, 0.5, -0.5])
SHAPES = (X.shape, Y.shape)


def formula(function):
    """A program of a function that may have to be awaited."""

    async def program(engine, x, y):
        result = function(x, y)
        return await result if hasattr(result, "__await__") else result

    return program


def returned(function):
    """A program that returns what the function gives, awaitable or not."""

    async def program(engine, x, y):
        return function(x, y)

    return program


def refused(program, says, kind=TypeError):
    for run in (
        lambda: measure(program, SHAPES, "malicious"),
        lambda: run_local(program, X, Y),
        lambda: run_clear(program, X, Y),
    ):
        with pytest.raises(kind, match=says):
            run()


# -- what a program or a score returns --------------------------------------------------------------------

RETURNED = {
    "no return": (returned(lambda x, y: None), "must return one value, not NoneType: a `return` is missing"),
    "two": (returned(lambda x, y: (x, y)), "must return one value, not tuple"),
    "a list": (formula(lambda x, y: mask(dot(x, y))), r"not list: .*`\[z\] = await spdz.mask\(z\)`"),
    "a number": (returned(lambda x, y: 0.5), "must return one value, not float$"),
    "no await, nonnegative": (returned(lambda x, y: nonnegative(x)), "not coroutine: an `await` is missing"),
    "no await, sqrt": (returned(lambda x, y: sqrt(dot(x, y))), "not coroutine: .*maximum, sqrt"),
    "no async": (lambda engine, x, y: dot(x, y), "is an `async def`: this one returned Value"),
}


@pytest.mark.parametrize("name", RETURNED)
def test_a_program_is_told_what_it_should_return(name):
    program, says = RETURNED[name]
    refused(program, f"a program .*{says}")


@pytest.mark.parametrize("similarity", [True, False])
@pytest.mark.parametrize("name", RETURNED)
def test_a_score_is_told_so_too_whether_it_is_opened_or_compared(name, similarity):
    program, says = RETURNED[name]
    score = Score("mine", "", similarity=similarity, formula=program)
    for whole in (score, is_candidate(score, 0.5)):
        refused(whole, f"a score .*{says}")


@pytest.mark.parametrize(
    "other", [returned(lambda x, y: dot(x, y)), "S10", None], ids=["function", "name", "none"]
)
def test_only_a_score_has_candidates(other):
    with pytest.raises(TypeError, match=r"is_candidate takes a score, not .*formula=function"):
        is_candidate(other, 0.5)


# -- what gates are given ---------------------------------------------------------------------------------

GATES = {
    "absolute": absolute,
    "beaver_dot": lambda z: beaver_dot(z, z),
    "beaver_multiply": lambda z: beaver_multiply(z, z),
    "divide": lambda z: divide(z, z, largest=1.0),
    "dot": lambda z: dot(z, z),
    "l1_normalised": l1_normalised,
    "l2_normalised": l2_normalised,
    "largest": largest,
    "mask": mask,
    "maximum": lambda z: maximum(z, z),
    "multiply": lambda z: multiply(z, z),
    "nonnegative": nonnegative,
    "power": lambda z: power(z, alpha=0.5),
    "reciprocal": reciprocal,
    "reciprocal_sqrt": reciprocal_sqrt,
    "round_exactly": lambda z: round_exactly(z, frac=3),
    "sign": sign,
    "sqrt": sqrt,
    "truncate": lambda z: truncate(z, frac=3),
}
SECOND = {
    "beaver_dot": beaver_dot,
    "beaver_multiply": beaver_multiply,
    "divide": lambda x, z: divide(x, z, largest=1.0),
    "dot": dot,
    "l2_normalised": l2_normalised,
    "mask": mask,
    "maximum": maximum,
    "multiply": multiply,
}
SLIPS = {
    "a list": (lambda x: [x], r"not list: .*`\[z\] = await spdz.mask\(z\)`"),
    "a tuple": (lambda x: (x, x), "not tuple: "),
    "nothing": (lambda x: None, "not NoneType: a `return` is missing"),
    "a coroutine": (absolute, "not coroutine: an `await` is missing"),
}
PUBLIC = {"int": 2, "float": 0.5, "ndarray": np.ones(3), "float64": np.float64(2), "list": [1.0, 2.0, 3.0]}


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("gate", GATES)
def test_a_gate_says_what_it_takes_and_what_slip_it_got(gate, slip):
    make, says = SLIPS[slip]
    refused(formula(lambda x, y: GATES[gate](make(x))), f"^{gate} takes secret values, {says}")


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("gate", SECOND)
def test_so_it_does_for_a_second_operand(gate, slip):
    make, says = SLIPS[slip]
    refused(formula(lambda x, y: SECOND[gate](x, make(y))), f"^{gate} takes secret values, {says}")
    refused(formula(lambda x, y: SECOND[gate](make(x), y)), f"^{gate} takes secret values, {says}")


@pytest.mark.parametrize("kind", PUBLIC)
@pytest.mark.parametrize("gate", GATES)
def test_a_public_number_is_no_operand_of_a_gate(gate, kind):
    says = f"^{gate} takes secret values, not {kind}"
    refused(formula(lambda x, y: GATES[gate](PUBLIC[kind])), says)
    if gate in SECOND and gate != "maximum":
        refused(formula(lambda x, y: SECOND[gate](x, PUBLIC[kind])), says)


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_no_public_number(slip):
    make, says = SLIPS[slip]
    for function in (
        lambda x, slip: x + slip,
        lambda x, slip: slip + x,
        lambda x, slip: x - slip,
        lambda x, slip: slip - x,
        lambda x, slip: x * slip,
        lambda x, slip: slip * x,
    ):
        refused(returned(lambda x, y, f=function: f(x, make(y))), f"^a (sum|product) takes .*{says}")


def test_what_runs_in_parallel_is_not_awaited_before():
    async def program(engine, x, y):
        return await parallel(dot(x, y), nonnegative(x))

    with pytest.raises(TypeError, match=r"not awaited yet, such as nonnegative.*not Value"):
        measure(program, SHAPES, "malicious")


@pytest.mark.parametrize("product", [dot, multiply])
@pytest.mark.parametrize(
    "computed",
    [
        lambda x, y: dot(x, y)[None],
        multiply,
        beaver_multiply,
        lambda x, y: absolute(x),
        lambda x, y: sign(x - y),
        maximum,
        lambda x, y: sqrt(x),
        lambda x, y: reciprocal(x),
    ],
)
def test_a_computed_value_is_masked_before_it_is_multiplied(product, computed):
    """In the clear as well, so that a program that passes there is one that runs."""

    async def square(engine, x, y, remask=False):
        z = computed(x, y)
        z = await z if hasattr(z, "__await__") else z
        if remask:
            [z] = await mask(z)
        return product(z, z)

    async def masked_square(engine, x, y):
        return await square(engine, x, y, remask=True)

    masked_square.max_norm = square.max_norm = 4.0

    refused(square, r"masked again first: `\[z\] = await spdz.mask\(z\)`")
    assert np.allclose(run_clear(masked_square, X, Y).value, run_local(masked_square, X, Y).value, rtol=1e-4)


# -- operators and NumPy ------------------------------------------------------------------------------------

REFUSED = {
    "x / 2": (lambda x, y: x / 2, "reciprocal"),
    "x / y": (lambda x, y: x / y, "await spdz.divide"),
    "x // 2": (lambda x, y: x // 2, "reciprocal"),
    "1 / x": (lambda x, y: 1 / x, "await spdz.reciprocal"),
    "array / x": (lambda x, y: np.ones(3) / x, "await spdz.reciprocal"),
    "x > y": (lambda x, y: x > y, "nonnegative.*await spdz.maximum"),
    "array < x": (lambda x, y: np.ones(3) < x, "nonnegative"),
    "max(x, y)": (max, "await spdz.maximum"),
    "x == y": (lambda x, y: x * (x == y), "sign"),
    "x != 0": (lambda x, y: y + (x != 0), "sign"),
    "array == x": (lambda x, y: np.ones(3) == x, "sign"),
    "x if y": (lambda x, y: x if dot(x, y) else y, "branch"),
    "x * y": (lambda x, y: x * y, "spdz.multiply"),
    "x ** 2": (lambda x, y: (x - y) ** 2, r"spdz.multiply\(d, d\)`, .*`spdz.dot\(d, d\)"),
    "x @ y": (lambda x, y: x @ y, r"spdz.dot\(x, y\)"),
    "array @ x": (lambda x, y: np.ones(3) @ x, r"\(x \* numbers\).sum\(\)"),
    "abs(x)": (lambda x, y: abs(x), "await spdz.absolute"),
    "np.sqrt": (lambda x, y: np.sqrt(x), r"numpy.sqrt .*`await spdz.sqrt\(x\)`"),
    "np.abs": (lambda x, y: np.abs(x), "await spdz.absolute"),
    "np.maximum": (lambda x, y: np.maximum(x, 0), "await spdz.maximum"),
    "np.maximum, public first": (lambda x, y: np.maximum(0, x), "await spdz.maximum"),
    "np.square": (lambda x, y: np.square(x), "spdz.multiply"),
    "np.exp": (lambda x, y: np.exp(x), "numpy.exp does not work on secret values: use dot"),
    "np.sum": (lambda x, y: np.sum(x), r"x.sum\(axis\)"),
    "np.add.reduce": (lambda x, y: np.add.reduce(x), "numpy.add does not"),
    "np.dot": (lambda x, y: np.dot(x, y), "spdz.dot"),
    "np.linalg.norm": (lambda x, y: np.linalg.norm(x), r"await spdz.sqrt\(spdz.dot\(x, x\)\)"),
    "np.mean": (lambda x, y: np.mean(x), "numpy.mean does not"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_operation_that_a_secret_value_lacks_is_refused_with_what_to_write(name):
    function, says = REFUSED[name]
    refused(returned(function), says)


@pytest.mark.parametrize("function", [np.asarray, lambda x: np.array([x, x])])
def test_a_secret_value_becomes_no_array(function):
    refused(returned(lambda x, y: function(x)), "cannot become an array", ValueError)


def test_an_array_holds_no_secret_value():
    def add_up(x, y):
        total = np.zeros(3)
        total += x
        return total

    refused(returned(add_up), "total = total")


NUMBERS = [
    2,
    0.5,
    np.int64(2),
    np.float64(0.5),
    np.float32(0.5),
    np.array(2),
    np.arange(3),
    np.ones((2, 1)),
    [1, 2, 3],
]


@pytest.mark.parametrize("number", NUMBERS, ids=repr)
def test_public_numbers_of_all_kinds_are_added_and_multiplied_from_either_side(number):
    for function in (
        lambda z: number + z,
        lambda z: z + number,
        lambda z: number - z,
        lambda z: z - number,
        lambda z: number * z,
        lambda z: z * number,
        lambda z: np.add(number, z),
        lambda z: np.subtract(z, number),
    ):
        program = returned(lambda x, y, f=function: f(x))
        assert np.array_equal(run_local(program, X, Y).value, function(X))
