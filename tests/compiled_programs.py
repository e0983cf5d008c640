"""Programs of every gate and form that compiled code is tried on, for vectors of 10 entries or more."""

import numpy as np

from spdz import absolute, beaver_dot, beaver_multiply, dot, mask, multiply, nonnegative, round_exactly
from spdz.rounds.coroutine import check
from spdz.values.value import concatenate


async def _dots_and_sums(engine, x, y):
    """Both of few numbers and of many: a sum of arrays and Python's own."""
    return dot(x[:10], y[:10]) + multiply(x, y).sum() + (x[:3] - y[:3]).sum()


async def _public_numbers(engine, x, y):
    n = x.shape[0]
    scaled = x * np.arange(n) - y * (np.arange(n) - 3) + 2.5
    return scaled * (1 << 20) + np.array([2**40, *range(n - 1)])


async def _negations(engine, x, y):
    return -(x * -3) - y * -7 - 1 + (-x) * 2 + -(y[::-1])


async def _long_factors(engine, x, y):
    """Words that outgrow 62 bits."""
    barely = x * 255 + y * 255 + x[::-1] * 255 - y * (1 << 9)
    return barely + x * (1 << 22) - y * (1 << 38) + x * 5


async def _nothing_secret(engine, x, y):
    return dot(x, y) * 0 + 1.5


async def _less_than_nothing(engine, x, y):
    return dot(x, y) * 0 - dot(x, y) + (0 - dot(x, x))


async def _nothing_at_all(engine, x, y):
    return x[1:1].sum() + (await absolute(x[:0] - y[:0])).sum() + dot(x, y)


async def _one_coordinate(engine, x, y):
    return x[-1] * 3 - y[0]


async def _a_vector(engine, x, y):
    return x - y


async def _bits(engine, x, y):
    return await nonnegative(x - y)


async def _a_used_bit(engine, x, y):
    return 1 - (await nonnegative(dot(x, y)))


async def _itself(engine, x, y):
    (m,) = await mask(x, fresh=True)
    return multiply(m, m).sum() + dot(x, x)


async def _outer(engine, x, y):
    return multiply(x[:9].reshape(-1, 1), y[:8].reshape(1, -1)).sum().sum()


async def _other_axes(engine, x, y):
    a, b = x[:6].reshape(2, 3), y[:6].reshape(2, 3)
    return multiply(a, b).sum(0) + a.sum(0) - b[:, ::-1].sum(0)


async def _checked_on_its_way(engine, x, y):
    (z,) = await mask(dot(x, y))
    if engine.malicious:
        await check()
    return multiply(z, x[0])


async def _rows(engine, x, y):
    return dot(x[:6].reshape(2, 3), y[:6].reshape(2, 3)) * 2


async def _turned(engine, x, y):
    return concatenate(x[::-1], y[::2], x[:1])[1:]


async def _rounded(engine, x, y):
    (z,) = await round_exactly(dot(x, y), frac=3)
    return z


async def _rounded_each(engine, x, y):
    (z,) = await round_exactly(x - y, frac=3)
    return z


async def _differences(engine, x, y):
    """Of words that may be negative: of masks, of their differences, and of what is public."""
    z = (x - y) - (y[::-1] - x)
    return dot(z, x) - dot(z * -3, y - 1)


async def _beaver(engine, x, y):
    return await beaver_dot(x, y) + (await beaver_multiply(x, y)).sum()


PROGRAMS = {name: one for name, one in globals().items() if name[0] == "_" and getattr(one, "__code__", None)}
"""By name."""

SHORT, LONG = 1.0, 2.0**22
"""Norms for which inputs have masks of short words, or of whole elements."""

for one in PROGRAMS.values():
    one.max_norm = SHORT
