"""Run a few gates on exact integers: what goes in and what comes out are whole numbers of any size."""

from fractions import Fraction
from inspect import isawaitable
from unittest.mock import patch

import numpy as np

from spdz import run_clear, run_local
from spdz.arithmetic.bound import Bound

SECURITIES = ["malicious", "semi-honest"]
LIMB = 30
WIDEST = (1 << 85) - 1
"""The largest bound that a comparison or truncation takes under a fresh mask: 86 bits with the sign."""


def integers(*rows):
    """An array of Python integers, however large."""
    return np.array(rows, dtype=object)


def _limbs(z):
    """Three limbs an integer, each exact in a descriptor's coordinate: shape S to (size, 3)."""
    flat = [int(one) for one in np.asarray(z, dtype=object).ravel()]
    low = (1 << LIMB) - 1
    rows = [(one >> 2 * LIMB, one >> LIMB & low, one & low) for one in flat]
    return np.array(rows, dtype=np.float64).reshape(-1, 3) / 65536


def _exact(raw, frac):
    return raw * Fraction(1, 1 << frac)


def exactly(program, x, y, security=None):
    """Run a program (in the clear if no security model is given); its result is made of exact fractions."""
    with patch("spdz.values.party_ring.decode", _exact):
        return run_clear(program, x, y) if security is None else run_local(program, x, y, security)


def run_gate(function, *operands, bound, security=None, frac=0, shared=False):
    """Open ``function(*values)`` for integers or arrays of them, with the costs.

    Args:
        function: Of as many values as there are operands; may be a coroutine function.
        operands: They belong to the parties in turn, beginning with party 0.
        bound: Public bound on all entries.
        security: None for the clear engine.
        frac: Fractional bits that the values are said to have.
        shared: Whether the values are shared (computed ones), else masked.
    """
    operands = [np.asarray(operand, dtype=object) for operand in operands]
    sides = [operands[::2], operands[1::2]]
    data = [np.concatenate([_limbs(one) for one in side] or [np.zeros((1, 3))]) for side in sides]

    async def program(engine, x, y):
        values = [[], []]
        for owner, source in enumerate((x, y)):
            start = 0
            for operand in sides[owner]:
                rows = source[start : start + operand.size]
                start += operand.size
                z = rows[..., 0] * (1 << 2 * LIMB) + rows[..., 1] * (1 << LIMB) + rows[..., 2]
                z = z.reshape(*operand.shape)
                z.bound, z.frac = Bound.of_entry(bound, z.shape), frac
                values[owner].append(engine.shared(z) if shared else z)
        ordered = [values[i % 2][i // 2] for i in range(len(operands))]
        result = function(*ordered)
        return await result if isawaitable(result) else result

    return exactly(program, *data, security)


def edges(bound, unit=1):
    """Integers that matter within a bound: its ends, zero, powers of two, and all their neighbours."""
    corners = {0, unit, bound, bound - unit, *(1 << k for k in range(0, bound.bit_length(), 7))}
    around = {corner + step for corner in corners for step in (-1, 0, 1)}
    return integers(*sorted({z for one in around for z in (one, -one) if abs(z) <= bound}))
