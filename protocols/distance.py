"""Differences and the squared Euclidean distance of masked vectors."""

from spdz import Value, dot


def difference(x: Value, y: Value) -> Value:
    """``x - y`` for vectors of one length; leading axes broadcast."""
    _check_lengths(x, y)
    return x - y


def squared_distance(x: Value, y: Value) -> Value:
    """``sum((x - y)**2)`` over the last axis; leading axes broadcast. No round.

    Where every x meets every y ((m, 1, N) against (1, k, N)) the square is expanded, so that N enters
    once a descriptor and the pairs cost one matrix product; field arithmetic loses nothing by it.
    """
    _check_lengths(x, y)
    if x.shape[:-1] == y.shape[:-1]:
        apart = x - y
        return dot(apart, apart)
    return squared_distance_of((x, dot(x, x)), (y, dot(y, y)))


def squared_distance_of(x: tuple[Value, ...], y: tuple[Value, ...]) -> Value:
    """:func:`squared_distance` of vectors with their squares ``dot(x, x)``: the last two of either tuple."""
    return x[-1] + y[-1] - 2 * dot(x[-2], y[-2])


def _check_lengths(x: Value, y: Value) -> None:
    if x.shape[-1:] != y.shape[-1:]:
        raise ValueError(f"a distance needs vectors of equal length, got shapes {x.shape} and {y.shape}")
