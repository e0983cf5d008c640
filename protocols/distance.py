"""Squared Euclidean distance on masked values."""

from spdz import Value, dot


def squared_distance(x: Value, y: Value) -> Value:
    """``sum((x - y)**2)`` over the last axis; leading axes broadcast. No round.

    Where every x meets every y ((m, 1, N) against (1, k, N)) the square is expanded, so that N enters
    once a descriptor and the pairs cost one matrix product; field arithmetic loses nothing by it.
    """
    if x.shape[-1:] != y.shape[-1:]:
        raise ValueError(f"a distance needs vectors of equal length, got shapes {x.shape} and {y.shape}")
    if x.shape[:-1] == y.shape[:-1]:
        difference = x - y
        return dot(difference, difference)
    return dot(x, x) + dot(y, y) - 2 * dot(x, y)
