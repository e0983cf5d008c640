"""Programs in exact numbers: a reading that shares no code with the engine, and how far others may be off.

A :class:`Number` is an array of fractions and, entry by entry, the largest error that a run of the engine may
have: 0 as long as every step is exact, so that equality is asked for. Where a comparison decides within its
operand's error, or a reciprocal is taken of what could be 0, the error says so (1, or infinity).
"""

from fractions import Fraction
from math import inf, isqrt, log2

import numpy as np

UP = 1 + 1e-9
"""Errors are floats, rounded up by this."""

RELATIVE = {"sqrt": 2.0**-18, "reciprocal_sqrt": 2.0**-17, "reciprocal": 2.0**-16}
"""Of roots and reciprocals, as documented."""


def fractions(numbers, frac=None):
    """Public numbers as exact fractions, rounded to so many fractional bits (ties to even) if given."""
    array = np.asarray(numbers)
    if array.dtype.kind == "b":
        array = array.astype(np.int8)
    flat = [
        Fraction(int(one)) if isinstance(one, (int, np.integer)) else Fraction(*one.as_integer_ratio())
        for one in array.ravel().tolist()
    ]
    if frac is not None:
        flat = [Fraction(round(one * (1 << frac)), 1 << frac) for one in flat]
    result = np.empty(len(flat), dtype=object)
    result[:] = flat
    return result.reshape(array.shape)


def is_whole(numbers):
    return np.asarray(numbers).dtype.kind != "f"


class Number:
    """Exact numbers, their errors, and their fractional bits (None where only the engine knows)."""

    __array_ufunc__ = None

    def __init__(self, exact, error, frac):
        self.exact = np.asarray(exact, dtype=object)
        error = np.asarray(error, dtype=np.float64) * UP
        self.error = np.broadcast_to(np.where(np.isnan(error), inf, error), self.exact.shape)
        self.frac = frac

    @property
    def shape(self):
        return self.exact.shape

    @property
    def ndim(self):
        return self.exact.ndim

    @property
    def size(self):
        """The largest magnitude with its error, as floats do."""
        return float((magnitudes(self) + self.error).max(initial=0.0)) * UP

    def _public(self, other):
        frac = self.frac if self.frac is None or is_whole(other) else max(self.frac, 16)
        return Number(fractions(other, frac), 0.0, frac)

    def __add__(self, other):
        if not isinstance(other, Number):
            other = self._public(other)
        frac = None if None in (self.frac, other.frac) else max(self.frac, other.frac)
        return Number(self.exact + other.exact, self.error + other.error, frac)

    __radd__ = __add__

    def __neg__(self):
        return Number(-self.exact, self.error, self.frac)

    def __sub__(self, other):
        if not isinstance(other, Number):
            other = self._public(other)
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, factor):
        bits = 0 if is_whole(factor) else 16
        exact = fractions(factor, bits)
        return Number(
            self.exact * exact,
            spread(self.error, np.abs(exact.astype(np.float64))),
            None if self.frac is None else self.frac + bits,
        )

    __rmul__ = __mul__

    def plus_raw(self, raw):
        return Number(self.exact + fractions(raw) / (1 << self.frac), self.error, self.frac)

    def rescaled(self, frac):
        return Number(self.exact, self.error, frac)

    def broadcast(self, shape):
        return Number(np.broadcast_to(self.exact, shape), np.broadcast_to(self.error, shape), self.frac)

    def sum(self, axis=-1):
        return Number(self.exact.sum(axis=axis), self.error.sum(axis=axis), self.frac)

    def reshape(self, *shape):
        return Number(self.exact.reshape(shape), self.error.reshape(shape), self.frac)

    def __getitem__(self, key):
        return Number(self.exact[key], self.error[key], self.frac)


def magnitudes(z):
    return np.abs(z.exact.astype(np.float64))


def spread(a, b):
    """A product of magnitudes and errors: 0 times any error, an endless one too, is 0."""
    with np.errstate(invalid="ignore"):
        return np.where((np.equal(a, 0)) | (np.equal(b, 0)), 0.0, np.multiply(a, b))


def _entrywise(function, *numbers, frac):
    """``function(number, error, ..) -> (number, error)`` of every entry, broadcasting."""
    arrays = np.broadcast_arrays(*(part for z in numbers for part in (z.exact, z.error)))
    results = [function(*entry) for entry in zip(*(one.ravel().tolist() for one in arrays), strict=True)]
    exact = np.empty(len(results), dtype=object)
    exact[:] = [Fraction(one) for one, _ in results]
    error = np.array([error for _, error in results], dtype=np.float64)
    return Number(exact.reshape(arrays[0].shape), error.reshape(arrays[0].shape), frac)


# -- gates ----------------------------------------------------------------------------------------------


async def mask(*values, fresh=False):
    return list(values)


def multiply(*factors, entry=None, norm=None):
    product = factors[0]
    for factor in factors[1:]:
        error = (
            spread(magnitudes(product), factor.error)
            + spread(magnitudes(factor), product.error)
            + spread(product.error, factor.error)
        )
        frac = None if None in (product.frac, factor.frac) else product.frac + factor.frac
        product = Number(product.exact * factor.exact, error, frac)
    return product


def dot(x, y):
    return multiply(x, y).sum()


async def beaver_multiply(x, y):
    return multiply(x, y)


async def beaver_dot(x, y):
    return dot(x, y)


async def nonnegative(z, bound=None):
    return _entrywise(lambda v, e: (v >= 0, -e <= v < e), z, frac=0)


async def sign(z):
    return _entrywise(lambda v, e: ((v > 0) - (v < 0), 2 if abs(v) <= e and e else 0), z, frac=0)


async def absolute(z):
    return Number(np.abs(z.exact), z.error, z.frac)


async def maximum(x, y):
    if not isinstance(x, Number):
        x, y = y, x
    if not isinstance(y, Number):
        y = x._public(y)
    frac = None if None in (x.frac, y.frac) else max(x.frac, y.frac)
    return _entrywise(lambda v, e, w, f: (max(v, w), max(e, f)), x, y, frac=frac)


async def largest(z):
    return Number(np.asarray(z.exact.max(axis=-1)), z.error.max(axis=-1), z.frac)


def _cut(z, frac):
    """Off by less than a unit, unless it has no bits to cut."""

    def cut(v, e):
        return v, e + (e > 0 or (v * (1 << frac)).denominator > 1) * 2.0**-frac

    return z if z.frac == frac else _entrywise(cut, z, frac=frac)


def _nearest(z, frac):
    def nearest(v, e):
        rounded = Fraction((v * (1 << frac) + Fraction(1, 2)).__floor__(), 1 << frac)
        return rounded, e and e + 2.0**-frac

    return z if z.frac == frac else _entrywise(nearest, z, frac=frac)


async def truncate(*values, frac):
    return [_cut(z, frac) for z in values]


async def round_exactly(*values, frac):
    return [_nearest(z, frac) for z in values]


# -- functions ------------------------------------------------------------------------------------------


def root(v):
    """The square root, good to 2^-200 of it; 0 of what is not above 0."""
    if v <= 0:
        return Fraction(0)
    shift = 200 + max(0, int(-log2(v)) + 2)
    return Fraction(isqrt((v.numerator << 2 * shift) // v.denominator), 1 << shift)


def _sqrt(v, e):
    exact = root(v)
    if e == inf:
        return exact, inf
    ends = [float(root(v + step * Fraction(e))) for step in (-1, 1)] if e else [float(exact)]
    return exact, max(abs(end - float(exact)) for end in ends) + RELATIVE["sqrt"] * max(ends)


def _reciprocal(v, e, *, positive=False):
    if not e:
        exact = 1 / v if v and (v > 0 or not positive) else Fraction(0)
        return exact, RELATIVE["reciprocal"] * abs(float(exact))
    if e < v or (e < -v and not positive):
        smallest = float(abs(v)) - e
        return 1 / v, e / smallest / float(abs(v)) + RELATIVE["reciprocal"] / smallest
    return Fraction(0), 0.0 if positive and v < -e else inf


def _reciprocal_sqrt(v, e):
    if v <= -e or (not e and not v):
        return Fraction(0), 0.0
    if v <= e:
        return Fraction(0), inf
    exact, far = 1 / root(v), 1 / float(root(v - Fraction(e)))
    return exact, far - float(exact) + RELATIVE["reciprocal_sqrt"] * far


async def sqrt(u):
    return _entrywise(_sqrt, u, frac=None)


async def reciprocal(u, *, positive=False):
    return _entrywise(lambda v, e: _reciprocal(v, e, positive=positive), u, frac=None)


async def reciprocal_sqrt(u):
    return _entrywise(_reciprocal_sqrt, u, frac=None)


async def by_power(u, alpha):
    function = {"1/2": sqrt, "-1/2": reciprocal_sqrt, "-1": reciprocal}[str(Fraction(alpha))]
    return await function(u)


async def divide(x, y, *, largest, frac=24, positive=False):
    def quotient(v, e, w, f):
        inverse, error = _reciprocal(w, f, positive=positive)
        if error == inf:
            return Fraction(0), inf
        total = abs(float(v)) * error + float(spread(e, abs(float(inverse)) + error))
        return v * inverse, total + 2.0**-frac if v * inverse or total else 0.0

    return _entrywise(quotient, x, y, frac=frac)


def _normalised(z, norm, relative):
    exact, errors = np.empty(z.shape, dtype=object), np.empty(z.shape)
    for row in np.ndindex(z.shape[:-1]):
        values, error = z.exact[row], z.error[row].sum()
        length = norm(values)
        exact[row] = [one / length if length else Fraction(0) for one in values]
        if float(length) <= error:
            errors[row] = inf if error else 0.0
            continue
        shortest = float(length) - error
        for i, one in enumerate(values):
            moved = (z.error[row][i] + abs(float(one)) * error / float(length)) / shortest
            errors[row][i] = moved + relative * abs(float(one)) / shortest + (2.0**-24 if one or moved else 0)
    return Number(exact, errors, 24)


async def l2_normalised(*vectors):
    return [_normalised(z, lambda row: root((row**2).sum()), 2.0**-17) for z in vectors]


async def l1_normalised(*vectors):
    return [_normalised(z, lambda row: np.abs(row).sum(), 2.0**-16) for z in vectors]


async def cosine(x, y):
    of_x, of_y = [await reciprocal_sqrt(dot(z, z)) for z in (x, y)]
    result = multiply(dot(x, y), of_x, of_y)
    slack = np.where(result.exact == 0, result.error, result.error + 2.0**-19)  # of cuts to 22 bits
    return Number(result.exact, slack, None)


# -- several --------------------------------------------------------------------------------------------


async def parallel(*protocols):
    return [await protocol for protocol in protocols]


def concatenate(*values):
    frac = None if any(z.frac is None for z in values) else max(z.frac for z in values)
    exact, error = (
        np.concatenate(parts) for parts in zip(*((z.exact, z.error) for z in values), strict=True)
    )
    return Number(exact, error, frac)


def split(value, shapes):
    results, start = [], 0
    for shape in shapes:
        rows = int(np.prod(shape)) // int(np.prod(value.shape[1:]))
        results.append(value[start : start + rows].reshape(*shape))
        start += rows
    return results
