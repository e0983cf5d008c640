"""Fixed point numbers sfix 64/16: x stands for the integer round(x * 2^16), signed, in 64 bits.

Inputs are checked where they enter. A product of two inputs is exact as long as each has its L2 norm within
the program's bound: by Cauchy-Schwarz every dot product is then below the product of the two bounds, at
most (2^38 + sqrt(n) / 2 + 1)^2, which leaves 2^50 of F_p's range unused for every practical n.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt, ldexp
from operator import mul
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.public import refuse_masked
from spdz.foundations.types import BigIntArray, FieldArray, FloatArray, IntArray

FRACTION_BITS = 16
"""Fractional bits of an input."""

_FLOAT64 = np.dtype(np.float64)
_ONE = float(1 << FRACTION_BITS)
_ONE_ARRAY = np.array(_ONE)  # quicker to multiply with

MAX_NORM = 2.0**22
"""The largest L2 norm that a program may allow: raw integers then stay below 2^39."""


@lru_cache(maxsize=256)
def norm_bound(max_norm: float, n: int) -> int:
    """The largest L2 norm of a quantised vector, in raw units of 2^-16.

    Rounding moves each coordinate by at most half a unit, so it lengthens a vector by at most sqrt(n) / 2:
    the bound is ceil(max_norm * 2^16) + ceil(sqrt(n) / 2), in exact arithmetic, the same on every machine.

    Args:
        max_norm: The largest L2 norm of a vector before it is quantised.
        n: Number of coordinates.

    Raises:
        ValueError: unless 0 < max_norm <= MAX_NORM and n >= 1.
    """
    if not 0 < max_norm <= MAX_NORM:
        raise ValueError(f"max_norm must be above 0 and at most {MAX_NORM:.0f}, not {max_norm}")
    if n < 1:
        raise ValueError(f"a vector needs at least one coordinate, not {n}")
    whole, rest = divmod(ldexp(max_norm, FRACTION_BITS), 1.0)  # exact: a power of two times a float
    return int(whole) + (rest > 0) + (isqrt(n - 1) + 2) // 2


def square_bounds(min_norm: float, max_norm: float, n: int) -> tuple[int, int]:
    """The least and the greatest square that the norm of a quantised vector can have, raw.

    Args:
        min_norm: The smallest L2 norm of a vector before it is quantised.
        max_norm: The largest.
        n: Number of coordinates.

    Raises:
        ValueError: unless 0 <= min_norm <= max_norm.
    """
    if not 0 <= min_norm <= max_norm:
        raise ValueError(f"min_norm lies between 0 and max_norm, not at {min_norm:g}")
    shortest = int(ldexp(min_norm, FRACTION_BITS)) - (isqrt(n - 1) + 2) // 2
    return max(shortest, 0) ** 2, norm_bound(max_norm, n) ** 2


def encode(x: npt.ArrayLike, *, max_norm: float, min_norm: float = 0.0, name: str = "descriptor") -> IntArray:
    """Check and quantise vectors: round(x * 2^16), ties to even.

    Args:
        x: Real floats or integers of shape S + (N,), N >= 1, no axis empty.
        max_norm: The largest L2 norm over the last axis.
        min_norm: The smallest.
        name: What to call the data in an error message. The messages hold positions, never values.

    Returns:
        Raw integers of the same shape, each row's L2 norm at most ``norm_bound(max_norm, N)``.

    Raises:
        ValueError: for anything that is not real, finite and within the norm.
    """
    real = _real_array(x, name)
    n = real.shape[-1]
    limit = norm_bound(max_norm, n) ** 2
    scaled, squares = _rounded(real)
    largest = squares if real.ndim == 1 else squares.max()
    # The squares and n - 1 sums err by less than n * 2^-52 relatively; NaN and infinity are not below.
    slack = n * 2.0**-52
    if not largest <= limit * (1 - slack):
        _explain_or_accept(real, scaled, np.asarray(squares), limit, slack, max_norm, name)
    raw = scaled.astype(np.int64)
    if min_norm:
        least, _ = square_bounds(min_norm, max_norm, n)
        _refuse_short(raw, np.argwhere(squares < least * (1 + slack)), least, min_norm, name)
    return raw


def encode_few(x: FloatArray, limit: int) -> list[int] | None:
    """The same of few numbers, in C order, as Python integers, which is quicker.

    Returns:
        None unless all are finite and the sum of the squares is at most ``limit``: :func:`encode` says why.
    """
    try:
        raw = [round(number * _ONE) for number in x.ravel().tolist()]
    except (ValueError, OverflowError):
        return None
    return raw if sum(map(mul, raw, raw)) <= limit else None


@np.errstate(over="ignore", invalid="ignore")  # as a decorator it takes half the time
def _rounded(real: FloatArray) -> tuple[FloatArray, Any]:
    """Raw integers as floats, and the square of each vector's norm."""
    scaled = real * _ONE_ARRAY
    np.rint(scaled, out=scaled)
    return scaled, scaled.dot(scaled) if real.ndim == 1 else np.vecdot(scaled, scaled)


def _refuse_short(raw: IntArray, rows: IntArray, least: int, min_norm: float, name: str) -> None:
    """Raise for the first of these rows whose square is less than the least, in exact arithmetic."""
    for row in rows:
        if sum(value * value for value in raw[tuple(row)].tolist()) < least:
            vector = f"the vector at {_position(row)}" if row.size else "the vector"
            raise ValueError(f"{name}: {vector} is shorter than {min_norm:g}, the smallest norm allowed here")


def _real_array(x: npt.ArrayLike, name: str) -> FloatArray:
    if type(x) is np.ndarray and x.dtype == _FLOAT64 and x.ndim and x.size:
        return x
    refuse_masked(x, name)
    try:
        array = np.asarray(x)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected a rectangular array of real numbers") from error
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name}: expected real numbers, got dtype {array.dtype}; convert them to float64")
    if array.ndim == 0:
        raise ValueError(f"{name}: expected a vector, got a single number; wrap it in a list")
    if array.size == 0:
        raise ValueError(f"{name}: expected at least one number, got an empty array of shape {array.shape}")
    if array.dtype == np.float64:
        return array
    with np.errstate(over="ignore"):
        return array.astype(np.float64)


def _explain_or_accept(
    real: FloatArray,
    scaled: FloatArray,
    squares: FloatArray,
    limit: int,
    slack: float,
    max_norm: float,
    name: str,
) -> None:
    """Raise for the first bad row; return if exact arithmetic finds all rows within the limit."""
    finite = np.isfinite(real)
    if not finite.all():
        where = _position(np.argwhere(~finite)[0])
        raise ValueError(f"{name}: the value at {where} is not finite (NaN or infinity); check its source")
    for row in np.argwhere(~(squares <= limit * (1 - slack))):
        square = squares[tuple(row)]
        # Within the slack of the limit, |coordinate| < 2^39, so that int64 holds it.
        if square <= limit * (1 + slack):
            coordinates = scaled[tuple(row)].astype(np.int64).tolist()
            if sum(value * value for value in coordinates) <= limit:
                continue
        vector = f"the vector at {_position(row)}" if row.size else "the vector"
        raise ValueError(
            f"{name}: {vector} has an L2 norm above {max_norm}, the largest that this program allows"
            f"{_excess(real[tuple(row)], max_norm)}; normalise it in float64, "
            "`x / np.linalg.norm(x, axis=-1, keepdims=True)` with `x = np.asarray(x, np.float64)`, "
            "or deal for a larger maximum norm"
        )


def _excess(vector: FloatArray, max_norm: float) -> str:
    """How much too long: 0.0914 % tells rounding in float16 from a vector that was never normalised."""
    with np.errstate(all="ignore"):
        largest = np.abs(vector).max()  # so that no square overflows
        ratio = float(largest / max_norm * np.linalg.norm(vector / largest))
    if ratio < 2:
        return f", by {100 * (ratio - 1):.3g} %"
    return f", by a factor of {ratio:.3g}" if np.isfinite(ratio) else ""


def _position(where: npt.NDArray[np.intp]) -> str:
    return f"index {where[0] if where.size == 1 else tuple(where.tolist())}"


@overload
def decode(raw: int, frac: int) -> float: ...
@overload
def decode(raw: BigIntArray, frac: int) -> FloatArray: ...
def decode(raw: int | BigIntArray, frac: int) -> float | FloatArray:
    """Integers with so many fractional bits as floats: raw / 2^frac, rounded once, to the nearest.

    Args:
        raw: A Python integer, or an object array of them of shape S.
        frac: Number of fractional bits.
    """
    one = 1 << frac
    if isinstance(raw, int):
        return raw / one
    return np.array([value / one for value in raw.ravel().tolist()], dtype=np.float64).reshape(raw.shape)


def decode_signed(a: FieldArray, frac: int) -> FloatArray:
    """Field elements of shape S, read as signed integers with so many fractional bits, as floats."""
    return decode(field.centered(a), frac)
