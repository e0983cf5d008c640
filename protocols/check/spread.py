"""How spread descriptors are and how fast they are guessed: effective dimension, probe bits, whitening."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, fields
from os import PathLike
from zipfile import BadZipFile

import numpy as np

from protocols.check.clear_scores import unit
from spdz.foundations.types import FloatArray, IntArray

SHRINKAGE = 0.3
"""What whitening adds to each variance, as a fraction of the mean variance."""
MOST_ROWS = 2000
"""Rows that pairs are made of; of more, these are taken evenly."""
_NO_VARIANCE = 1e-30
"""Variance that vectors of floats have by rounding alone, or less."""
_A_SIGN = 0.64
"""Share of a normal number's square that its sign fixes: 2 / pi."""


def effective_dimension(vectors: FloatArray, neighbours: int = 0) -> float:
    """In how many directions vectors differ: the participation ratio of their covariance's eigenvalues.

    That is (sum of the eigenvalues)^2 / (sum of their squares): N if all N are equal, k if k are and the
    others are zero. The eigenvalues of a few vectors' covariance would give less than there is (never more
    than there are vectors), so both sums are estimated without bias, the second from products of different
    vectors: (tr S)^2 / tr(S^2), with tr(S^2) the mean of ((x_i - m) . (x_j - m))^2.

    Args:
        vectors: ``(n, N)``, in the order in which they were taken.
        neighbours: Pairs of rows at most so far apart are left out: they may show one place.

    Returns:
        Between 1 and N; N too if the vectors do not differ at all, which has no direction.

    Raises:
        ValueError: if no pair is left.
    """
    rows = vectors[evenly(len(vectors), MOST_ROWS)]
    gap = thinned(neighbours, len(vectors), len(rows))
    apart = np.abs(np.subtract.outer(np.arange(len(rows)), np.arange(len(rows)))) > gap
    if not apart.any():
        raise ValueError(
            f"expected more than {neighbours + 1} descriptors, got {len(vectors)}: of so few there are no "
            "two that are no neighbours"
        )
    centred = rows - rows.mean(axis=0)
    trace = float((centred * centred).sum()) / (len(rows) - 1)
    # The mean that was subtracted holds a share 1 / n of each vector: their products lie about -trace / n.
    square = float(((centred @ centred.T)[apart] ** 2).mean()) - (trace / len(rows)) ** 2
    dimension = float(rows.shape[1])
    return dimension if square <= 0 else min(max(trace**2 / square, 1.0), dimension)


def evenly(count: int, most: int) -> IntArray:
    """At most so many of ``count`` indices, taken evenly."""
    return np.asarray(np.linspace(0, count - 1, min(count, most)).round(), dtype=np.int64)


def thinned(neighbours: int, count: int, kept: int) -> int:
    """How far apart neighbours are at most where only so many of ``count`` rows were kept."""
    return -(-neighbours * kept // max(count, 1))


def bits_until(cosine: float, threshold: float, dimension: float) -> float:
    """Probe bits until the best guess of a descriptor has a cosine with it, after a first match.

    The rule cos^2 = t^2 + 0.64 (1 - t^2) bits / d: a probe that matches at t fixes a share t^2 of the vector,
    and each further bit the sign of one of d coordinates. ``python -m bench attacks --only probes`` holds it
    against a prober; it counts no bits to find a first match and the edge of it (some 30).

    Args:
        cosine: Between -1 and 1.
        threshold: Cosine of the first match.
        dimension: Effective dimension.
    """
    if cosine <= threshold or threshold >= 1:
        return 0.0
    left = max(threshold, 0.0) ** 2
    return max(cosine**2 - left, 0.0) * dimension / (_A_SIGN * (1 - left))


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """Public statistics that descriptors are changed by before they are normalised, the same on all robots.

    Whitening by the inverse square root of S + e I, with e a share of the mean variance: what descriptors
    have in common counts little, what is special counts much. Kept as the axes in which S is not zero, of
    which there are no more than rows.

    Attributes:
        mean: ``(N,)``, to subtract.
        axes: ``(N, r)``, orthonormal.
        gains: ``(r,)``, what lengths along them are multiplied by.
        rest: What all other lengths are multiplied by.
    """

    mean: FloatArray = field(repr=False)
    axes: FloatArray = field(repr=False)
    gains: FloatArray = field(repr=False)
    rest: float

    @staticmethod
    def fit(vectors: FloatArray, shrinkage: float | None = SHRINKAGE) -> Whitening:
        """Learn from public vectors ``(n, N)``, n >= 2; without ``shrinkage`` the mean alone.

        Raises:
            ValueError: for another shape, NaN or infinity.
        """
        if vectors.ndim != 2 or len(vectors) < 2 or not np.isfinite(vectors).all():
            raise ValueError(
                f"expected at least two finite vectors to learn from, shape (n, N), got shape {vectors.shape}"
                f"{'' if np.isfinite(vectors).all() else ' with NaN or infinity'}"
            )
        mean, dim = vectors.mean(axis=0), vectors.shape[1]
        if shrinkage is None:
            return Whitening(mean, np.empty((dim, 0)), np.empty(0), 1.0)
        _, lengths, axes = np.linalg.svd(vectors - mean, full_matrices=False)
        variances = lengths**2 / len(vectors)
        least = max(shrinkage * float(variances.sum()) / dim, _NO_VARIANCE)
        return Whitening(mean, axes.T, (variances + least) ** -0.5, least**-0.5)

    def applied(self, vectors: FloatArray, norm: float) -> FloatArray:
        """Change vectors ``(n, N)`` and bring them to a norm; one that equals the mean stays zero.

        Raises:
            ValueError: if they have not N numbers each.
        """
        if vectors.ndim != 2 or vectors.shape[1] != len(self.mean):
            raise ValueError(
                f"expected vectors of shape (n, {len(self.mean)}), as was learnt from, got {vectors.shape}"
            )
        centred = vectors - self.mean
        along = (centred @ self.axes) * (self.gains - self.rest)
        return unit(self.rest * centred + along @ self.axes.T) * norm

    def save(self, path: str | PathLike[str]) -> None:
        """Write a file ``.npz``, to be copied to all robots."""
        np.savez(path, mean=self.mean, axes=self.axes, gains=self.gains, rest=np.float64(self.rest))

    @staticmethod
    def load(path: str | PathLike[str]) -> Whitening:
        """Read what :meth:`save` wrote.

        Raises:
            OSError: the file cannot be read.
            ValueError: it is damaged, or another kind of file.
        """
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
                mean, axes, gains, rest = (
                    np.asarray(file[one.name], np.float64) for one in fields(Whitening)
                )
        except (ValueError, KeyError, IndexError, EOFError, TypeError, BadZipFile, zlib.error) as error:
            raise ValueError(f"{path}: expected a file that Whitening.save has written: {error}") from error
        if (mean.ndim, gains.ndim, rest.shape, axes.shape) != (1, 1, (), (mean.size, gains.size)) or not all(
            np.isfinite(one).all() for one in (mean, axes, gains, rest)
        ):
            raise ValueError(f"{path}: expected finite mean, axes, gains and rest, of shapes that fit")
        return Whitening(mean, axes, gains, float(rest))
