"""Array aliases and small shared types."""

from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

FieldArray: TypeAlias = npt.NDArray[np.uint64]
"""Elements of F_p, shape ``S + (2,)``: little-endian 64-bit words (low, high), always below p."""

Block: TypeAlias = npt.NDArray[np.uint64]
"""128-bit blocks (AES blocks, DCF seeds), shape ``S + (2,)``."""

IntArray: TypeAlias = npt.NDArray[np.int64]
"""Signed raw fixed-point integers, shape ``S``."""

BigIntArray: TypeAlias = npt.NDArray[np.object_]
"""Exact Python integers in an object array, shape ``S``."""

FloatArray: TypeAlias = npt.NDArray[np.float64]
"""Real numbers as a user gives and gets them."""

Shape: TypeAlias = tuple[int, ...]

Buffer: TypeAlias = bytes | bytearray | memoryview
"""What goes into a frame."""

Security: TypeAlias = Literal["malicious", "semi-honest"]
"""The two security models; malicious is the default everywhere."""

SECURITIES: tuple[Security, ...] = ("malicious", "semi-honest")


def check_security(security: str) -> None:
    """Refuse anything but the two models: a misspelt one must not become the weaker one.

    Raises:
        ValueError: naming both.
    """
    if security not in SECURITIES:
        raise ValueError(f"security must be one of {SECURITIES}, not {security!r}")


Json: TypeAlias = Any
"""A value that ``json`` can write."""
