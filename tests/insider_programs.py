"""Programs that between them open everything that the engine can open."""

from fractions import Fraction
from functools import cache

import numpy as np
from insider import Dealt

from protocols import is_candidate
from protocols.scores import SCORES
from protocols.textbook import TEXTBOOK, dot_with_scalar_triples
from spdz import (
    Stock,
    absolute,
    beaver_dot,
    beaver_multiply,
    decided,
    divide,
    dot,
    l1_normalised,
    l2_normalised,
    largest,
    mask,
    maximum,
    multiply,
    nonnegative,
    parallel,
    power,
    reciprocal,
    reciprocal_sqrt,
    round_exactly,
    sign,
    sqrt,
    truncate,
)

X, Y = np.array([0.6, -0.8, 0.25]), np.array([0.5, 1.0, -0.25])
STOCK = Stock(inputs=(9, 9), scalar_triples=9, vector_triples={3: 2})
NORM = 2.0


async def of_nonnegative(engine, x, y):
    return await nonnegative(multiply(x, y))


async def of_sign(engine, x, y):
    return await sign(multiply(x, y))


async def of_absolute(engine, x, y):
    return await absolute(multiply(x, y))


async def of_maximum(engine, x, y):
    return await maximum(multiply(x, y), multiply(x, x))


async def of_largest(engine, x, y):
    return await largest(multiply(x, y))


async def of_mask(engine, x, y):
    product, square = await mask(multiply(x, y), dot(x, x))
    return multiply(product, square)


async def of_multiply(engine, x, y):
    return multiply(x, y, x)


async def of_dot(engine, x, y):
    return dot(x, y)


async def of_truncate(engine, x, y):
    (z,) = await truncate(multiply(x, y), frac=20)
    return multiply(z, x)


async def of_round_exactly(engine, x, y):
    (z,) = await round_exactly(multiply(x, y), frac=12)
    return z


async def of_beaver_multiply(engine, x, y):
    return await beaver_multiply(x, y - x)


async def of_beaver_dot(engine, x, y):
    return await beaver_dot(x, await beaver_multiply(x, y))


async def of_sqrt(engine, x, y):
    """The refined root and the plain one."""
    large, small = await parallel(sqrt(dot(x, x) * 9), sqrt(dot(y, y)))
    return large + small


async def of_reciprocal_sqrt(engine, x, y):
    return await reciprocal_sqrt(dot(x, x) + dot(y, y))


async def of_reciprocal(engine, x, y):
    return await reciprocal(dot(x, y))


async def of_divide(engine, x, y):
    return await divide(dot(x, y), dot(x, x), largest=8.0, positive=True)


async def of_power(engine, x, y):
    (root,) = await power(dot(x, x) + dot(y, y), alpha=Fraction(1, 2))
    (mantissa,) = await truncate(root.mantissa, frac=22)
    return multiply(mantissa, root.scale)


async def of_l2_normalised(engine, x, y):
    u, v = await l2_normalised(x, y)
    return dot(u, v)


async def of_l1_normalised(engine, x, y):
    u, v = await l1_normalised(x, y)
    return multiply(u, v)


async def side_by_side(engine, x, y):
    """Lanes within lanes, some of which end before others."""

    async def masked():
        (product,) = await mask(dot(x, y))
        return await absolute(product)

    async def two():
        u, v = await parallel(beaver_dot(x, y), sqrt(dot(y, y)))
        return u + v

    (p, q), r = await parallel(parallel(masked(), two()), beaver_multiply(x, y))
    return await nonnegative(r + p - q)


async def bits_of_inputs(engine, x, y):
    """Nothing is opened before; two bytes of bits."""
    return await nonnegative(x.reshape(3, 1) - y.reshape(1, 3))


async def counted(engine, x, y):
    """Bits that are not opened themselves."""
    return (await nonnegative(multiply(x, y))).sum()


async def of_decided(engine, x, y):
    """Comparisons that are opened masked, and compared once more; nothing is opened before the first."""
    (larger,) = await decided(await nonnegative(x - y))
    (count,) = await mask(larger * 2 + x)
    (again,) = await decided(await nonnegative(count - 1))
    return again + larger


GATES_AND_FUNCTIONS = {
    "absolute": of_absolute,
    "beaver_dot": of_beaver_dot,
    "beaver_multiply": of_beaver_multiply,
    "decided": of_decided,
    "divide": of_divide,
    "dot": of_dot,
    "l1_normalised": of_l1_normalised,
    "l2_normalised": of_l2_normalised,
    "largest": of_largest,
    "mask": of_mask,
    "maximum": of_maximum,
    "multiply": of_multiply,
    "nonnegative": of_nonnegative,
    "power": of_power,
    "reciprocal": of_reciprocal,
    "reciprocal_sqrt": of_reciprocal_sqrt,
    "round_exactly": of_round_exactly,
    "sign": of_sign,
    "sqrt": of_sqrt,
    "truncate": of_truncate,
}
for program in (*GATES_AND_FUNCTIONS.values(), side_by_side, bits_of_inputs, counted):
    program.max_norm = NORM

PROGRAMS = (
    GATES_AND_FUNCTIONS
    | {"side by side": side_by_side, "bits of inputs": bits_of_inputs, "counted": counted}
    | {name: score.within(NORM) for name, score in SCORES.items()}
    | {
        f"{name} candidate": is_candidate(score.within(NORM), -0.9 if score.similarity else 0.9)
        for name, score in SCORES.items()
    }
    | {f"textbook {name}": score.within(NORM) for name, score in TEXTBOOK.items()}
    | {"textbook scalar triples": dot_with_scalar_triples}
)
ON_A_STOCK = {
    f"{name} on a stock": PROGRAMS[name]
    for name in ("beaver_multiply", "beaver_dot", "textbook S6", "textbook S10", "textbook scalar triples")
}
ALL = PROGRAMS | ON_A_STOCK


@cache
def dealt(name):
    """The job of one program of ALL, on X and Y."""
    return Dealt(ALL[name], (X, Y), stock=STOCK if name in ON_A_STOCK else None)
