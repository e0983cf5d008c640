"""Poses in the plane, as arrays whose last axis is x, y (metres) and theta (radians): the group SE(2).

The pose of B in A turns B's coordinates into A's: ``compose(a_b, b_c) == a_c``.
"""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import FloatArray

Pose: TypeAlias = tuple[float, float, float]


def wrap(angle: npt.ArrayLike) -> FloatArray:
    """The same angles, from -pi up to pi."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def apply(pose: npt.ArrayLike, points: FloatArray) -> FloatArray:
    """Points of a frame, ``(..., 2)``, in the frame in which its pose is ``pose``, ``(3,)``."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y))


def compose(first: npt.ArrayLike, second: npt.ArrayLike) -> FloatArray:
    """The pose of C in A, from that of B in A and that of C in B; ``(..., 3)`` each, which broadcast."""
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    cosine, sine = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + cosine * b[..., 0] - sine * b[..., 1]
    y = a[..., 1] + sine * b[..., 0] + cosine * b[..., 1]
    return np.stack(np.broadcast_arrays(x, y, wrap(a[..., 2] + b[..., 2])), axis=-1)


def inverse(pose: npt.ArrayLike) -> FloatArray:
    """The pose of A in B, from that of B in A; ``(..., 3)``."""
    a = np.asarray(pose, dtype=np.float64)
    cosine, sine = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = -cosine * a[..., 0] - sine * a[..., 1]
    y = sine * a[..., 0] - cosine * a[..., 1]
    return np.stack([x, y, wrap(-a[..., 2])], axis=-1)


def between(first: npt.ArrayLike, second: npt.ArrayLike) -> FloatArray:
    """The pose of C in B, from those of B and C in A; ``(..., 3)`` each, which broadcast."""
    return compose(inverse(first), second)


def chain(start: npt.ArrayLike, steps: FloatArray) -> FloatArray:
    """Dead reckoning: the poses that n - 1 steps, ``(n - 1, 3)``, lead to from the first; ``(n, 3)``.

    Headings are not wrapped: a robot that turned twice has turned by 4 pi.
    """
    x, y, theta = np.asarray(start, dtype=np.float64)
    heading = np.concatenate([[0.0], np.cumsum(steps[:, 2])]) + theta
    moves = (steps[:, 0] + 1j * steps[:, 1]) * np.exp(1j * heading[:-1])
    position = np.concatenate([[0.0], np.cumsum(moves)]) + (x + 1j * y)
    return np.stack([position.real, position.imag, heading], axis=1)
