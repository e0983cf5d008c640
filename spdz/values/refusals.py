"""What a secret value does not do, each refused with what to write instead.

A secret value looks like an array and is none: operators and NumPy's functions would need its numbers. These
are the mistakes that one makes first. The meter finds them, before anything is dealt or sent.
"""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any, NoReturn

import numpy as np

_OPERATORS: dict[object, tuple[str, str]] = {
    np.add: ("__add__", "__radd__"),
    np.subtract: ("__sub__", "__rsub__"),
    np.multiply: ("__mul__", "__rmul__"),
    np.true_divide: ("__truediv__", "__rtruediv__"),
    np.matmul: ("__matmul__", "__rmatmul__"),
    np.less: ("__lt__", "__gt__"),
    np.less_equal: ("__le__", "__ge__"),
    np.greater: ("__gt__", "__lt__"),
    np.greater_equal: ("__ge__", "__le__"),
    np.equal: ("__eq__", "__eq__"),
    np.not_equal: ("__ne__", "__ne__"),
}
"""NumPy's name of an operator between an array and something else, and ours, with the value left or right."""

_INSTEAD = {
    "absolute": "await spdz.absolute(x)",
    "amax": "await spdz.largest(x)",
    "clip": "await spdz.maximum(x, low)",
    "dot": "spdz.dot(x, y)",
    "inner": "spdz.dot(x, y)",
    "max": "await spdz.largest(x)",
    "maximum": "await spdz.maximum(x, y)",
    "mean": "x.sum() * (1 / n)",
    "minimum": "-await spdz.maximum(-x, -y)",
    "negative": "-x",
    "norm": "await spdz.sqrt(spdz.dot(x, x))",
    "power": "spdz.multiply(x, x)",
    "reciprocal": "await spdz.reciprocal(x)",
    "reshape": "x.reshape(...)",
    "sign": "await spdz.sign(x)",
    "sqrt": "await spdz.sqrt(x)",
    "square": "spdz.multiply(x, x)",
    "sum": "x.sum(axis)",
    "vdot": "spdz.dot(x, y)",
    "vecdot": "spdz.dot(x, y)",
}
"""For functions of NumPy, by name."""


class Secret:
    """The base of a secret value: the operations that it lacks."""

    __slots__ = ()

    def __truediv__(self, divisor: object) -> NoReturn:
        raise TypeError(
            "a secret value cannot be divided: multiply by the reciprocal of a public number; the quotient "
            "of two secret ones is `await spdz.divide(x, y, largest=...)`"
        )

    __floordiv__ = __mod__ = __truediv__

    def __rtruediv__(self, dividend: object) -> NoReturn:
        raise TypeError("nothing can be divided by a secret value: multiply by `await spdz.reciprocal(x)`")

    def __pow__(self, exponent: object) -> NoReturn:
        raise TypeError(
            "a secret value has no `**`: its square is `spdz.multiply(d, d)`, the sum of its squares "
            "`spdz.dot(d, d)`, its square root `await spdz.sqrt(d)`"
        )

    def __matmul__(self, other: object) -> NoReturn:
        raise TypeError(
            "a secret value has no `@`: use `spdz.dot(x, y)` for two secret values, `(x * numbers).sum()` "
            "for a secret and a public one"
        )

    __rmatmul__ = __matmul__

    def __abs__(self) -> NoReturn:
        raise TypeError("the magnitude of a secret value is `await spdz.absolute(x)`")

    def __lt__(self, other: object) -> bool:
        raise TypeError(
            "compare secret values by `await spdz.nonnegative(x - y)`, which gives a secret bit; the larger "
            "of two is `await spdz.maximum(x, y)`"
        )

    __le__ = __gt__ = __ge__ = __lt__

    def __eq__(self, other: object) -> bool:
        """Refused, so that no public False stands for a secret; :func:`spdz.sign` is 0 for equal values."""
        raise TypeError(
            "compare secret values by `await spdz.sign(x - y)`, which is a secret 0 for equal ones"
        )

    __ne__ = __eq__
    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        raise TypeError("a program cannot branch on a secret value: only its result is opened")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """``array + value`` and the like are ours; all else is refused."""
        if ufunc in _OPERATORS and method == "__call__":
            if options:
                raise TypeError("a public array cannot hold a secret value: write `total = total + value`")
            (x, y), (left, right) = inputs, _OPERATORS[ufunc]
            return getattr(x, left)(y) if isinstance(x, Secret) else getattr(y, right)(x)
        raise TypeError(_without_numpy(ufunc.__name__))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> NoReturn:
        raise TypeError(_without_numpy(function.__name__))

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        # A ValueError, since this is also how `masked_array + value` ends
        # (spdz.arithmetic.public.refuse_masked).
        raise ValueError(
            "a secret value cannot become an array: its numbers are not here (and a masked array must be "
            "filled in, `x.filled(0)`, before it meets one)"
        )


def _without_numpy(name: str) -> str:
    instead = f"`{_INSTEAD[name]}`" if name in _INSTEAD else "dot, multiply, sqrt, maximum, ... of spdz"
    return f"numpy.{name} does not work on secret values: use {instead}"


def described(found: object) -> str:
    """What stands where a secret value should, with the slip that most likely put it there."""
    name = type(found).__name__
    if isinstance(found, Coroutine):
        found.close()  # else Python warns as well that it was never awaited
        return f"{name}: an `await` is missing, as before nonnegative, maximum, sqrt and beaver_dot"
    if found is None:
        return f"{name}: a `return` is missing"
    if isinstance(found, (list, tuple)):
        return f"{name}: mask, truncate and l2_normalised return a list, so write `[z] = await spdz.mask(z)`"
    return name


def not_secret(gate: str, found: object) -> TypeError:
    """What to raise where a gate is given something else than a secret value."""
    advice = "" if _is_slip(found) else "; public numbers join by `+`, `-`, `*`: `(x * weights).sum()`"
    return TypeError(f"{gate} takes secret values, not {described(found)}{advice}")


def expect_secret(gate: str, *operands: object) -> None:
    """Raise :class:`TypeError`, in words, unless all operands of a gate are secret values."""
    for operand in operands:
        if not isinstance(operand, Secret):
            raise not_secret(gate, operand)


def refuse_slips(gate: str, operand: object) -> None:
    """Raise :class:`TypeError` for what is neither a secret value nor meant as public numbers."""
    if _is_slip(operand):
        raise not_secret(gate, operand)


def _is_slip(found: object) -> bool:
    held = found if isinstance(found, (list, tuple)) else ()
    return found is None or isinstance(found, Coroutine) or any(isinstance(one, Secret) for one in held)
