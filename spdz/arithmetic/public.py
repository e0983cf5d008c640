"""Public numbers as exact raw integers: what a program adds to secret values, multiplies them by, or claims.

A number with f fractional bits is rounded once to ``round(number * 2^f)``, ties to even, whatever type it
comes in: Python and NumPy scalars, lists, arrays of any real dtype (True and False are 1 and 0). One number
becomes a Python integer; several become an int64 array if all are below 2^62, so that neither a negation nor
a sum of two can wrap, and else an object array of Python integers.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, inf
from operator import index
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import BigIntArray, IntArray

Raw: TypeAlias = int | IntArray | BigIntArray
"""Public raw integers: one, or an array of them."""

_SAFE = 1 << 62


def refuse_masked(x: object, name: str) -> None:
    """Raise for a masked array, or a sequence of them: ``np.asarray`` would use the numbers that it hides.

    Raises:
        ValueError: with what to do.
    """
    if _is_masked(x):
        raise ValueError(
            f"{name}: a masked array (numpy.ma) has numbers that do not count, and a secret value has none: "
            "fill them in (`x.filled(0)`) or leave them out first"
        )


def _is_masked(x: object) -> bool:
    if isinstance(x, (list, tuple)):
        return any(_is_masked(one) for one in x)
    return isinstance(x, np.ma.MaskedArray)


def is_whole(number: npt.ArrayLike) -> bool:
    """Whether public numbers are integers by their type, so that nothing need be rounded."""
    return isinstance(number, int) or _numbers(number).dtype.kind != "f"


def rounded(number: npt.ArrayLike, frac: int) -> Raw:
    """Public numbers with so many fractional bits.

    Raises:
        ValueError: unless they are real, finite and not masked.
    """
    if isinstance(number, int):
        return int(number) << frac
    array = _numbers(number)
    if array.dtype.kind == "f" and array.dtype.itemsize <= 8:
        with np.errstate(over="ignore"):
            scaled = np.rint(np.ldexp(array.astype(np.float64), frac))  # exact, unless it overflows
        if np.abs(scaled).max(initial=0) < _SAFE:
            return _whole(scaled.astype(np.int64))
    elif array.dtype.kind in "biu" and magnitude(array) < _SAFE >> frac:
        return _whole(array.astype(np.int64) << frac)
    exact = np.empty(array.size, dtype=object)
    exact[:] = [round(_fraction(one) * (1 << frac)) for one in array.ravel().tolist()]
    return _whole(exact.reshape(array.shape))


def integers(raw: npt.ArrayLike) -> Raw:
    """Public raw integers; ValueError for anything else."""
    if not is_whole(raw):
        raise ValueError("raw numbers are integers: add real ones with +, which knows the fractional bits")
    return rounded(raw, 0)


def magnitude(raw: Raw | npt.NDArray[Any]) -> int:
    """The largest magnitude, 0 of none; not by ``np.abs``, which leaves int64's least number negative."""
    if isinstance(raw, int):
        return abs(raw)
    return max(int(raw.max()), -int(raw.min())) if raw.size else 0


def limit(number: float, frac: int, name: str) -> int:
    """A bound that a caller gives, in raw units, rounded up.

    Raises:
        ValueError: unless it is finite and not negative.
    """
    if not 0 <= number < inf:
        raise ValueError(f"{name} must be finite and not negative, as a bound on a magnitude is")
    return ceil(_fraction(number) * (1 << frac))


def fraction_bits(frac: int) -> int:
    """A number of fractional bits as a Python integer; ValueError unless it is one and not negative."""
    try:
        count = index(frac)
    except TypeError as error:
        raise ValueError(f"frac must be a whole number of bits, not {type(frac).__name__}") from error
    if count < 0:
        raise ValueError(f"frac must be 0 or more fractional bits, not {count}: `x * 2**-k` drops whole bits")
    return count


def _numbers(number: npt.ArrayLike) -> npt.NDArray[Any]:
    refuse_masked(number, "public numbers")
    array = np.asarray(number)
    kind = array.dtype.kind
    real = all(isinstance(one, (int, np.integer)) for one in array.flat) if kind == "O" else kind in "biuf"
    if not real or (kind == "f" and not np.isfinite(array).all()):
        raise ValueError("public numbers must be real and finite")
    return array


def _fraction(number: Any) -> Fraction:
    whole = isinstance(number, (int, np.integer))
    return Fraction(index(number)) if whole else Fraction(*number.as_integer_ratio())


def _whole(raw: npt.NDArray[Any]) -> Raw:
    """One Python integer, int64 where all are safe, or Python integers."""
    if raw.ndim == 0:
        return int(raw.item())
    return raw.astype(np.int64 if magnitude(raw) < _SAFE else object, copy=False)
