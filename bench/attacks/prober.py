"""A robot that chooses its vectors to find another one's: adaptive probing with unit vectors, bit by bit.

Every probe v has norm 1, as the proof of norm demands, and brings the one bit [v . y >= t] about a hidden
unit vector y. The prober (its steps are numbered in the code):

1. begins with a vector r that matches, v . y >= t;
2. turns r towards another direction until it finds, by bisection, a unit vector p with p . y = t: on the
edge;
3. asks from there. For any unit e orthogonal to p the probe cos(f) p + sin(f) e matches exactly if
   e . y >= t tan(f / 2). So *any* coordinate of y can be compared with *any* number, and nothing else need be
   known of y: what bounded vectors lose against unbounded ones is this search, some 28 bits;
4. takes for e the axes of what it knows beforehand (a mean and a covariance, or nothing: then any axes), and
   bisects those coordinates first whose answer is expected to tell most.

With nothing known beforehand the first bit a coordinate is its sign, and d signs of a random vector fix a
share 2/pi = 0.64 of its square: the rule cos^2 = t^2 + 0.64 (1 - t^2) bits / d. One-bit compressed sensing
(Jacques et al., "Robust 1-bit compressive sensing via binary stable embeddings", IEEE Trans. Inf. Theory
2013) is the same without the adaption.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from functools import cache
from math import atan, ceil, cos, exp, pi, sin, sqrt
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.fixed_point import FRACTION_BITS, encode
from spdz.foundations.types import FloatArray

_NORMAL = NormalDist()
_EDGE_BITS, _LENGTH_BITS = 18, 10
"""Bits of steps 2 and of what the first match is known to be better than the edge by."""
_DEEPEST = 11
"""Bits of one coordinate at most."""
_KNOWN, _NOTHING = 1e-9, 1e-300
"""A variance that is not worth a bit; a norm of a guess that says nothing."""
_TILT = 0.1
"""A coordinate is compared with no number nearer to 0 than so many standard deviations: the nearer, the less
a probe leaves the edge, and the more of its answer is the comparison's resolution."""


class Oracle:
    """The other robot, as a prober sees it: one bit a probe, decided on integers as the engine decides.

    Args:
        hidden: ``(n,)``, its unit vector.
        threshold: Of the inner product.
        generator: Of the resolution's dither, which in the engine is random as the mask is.
        resolution: Fractional bits of the score that a comparison looks at.
    """

    def __init__(
        self, hidden: FloatArray, threshold: float, generator: np.random.Generator, resolution: int = 16
    ) -> None:
        self._raw = encode(hidden[None], max_norm=1.0)[0].astype(np.float64)
        self._threshold = ceil(threshold * (1 << 2 * FRACTION_BITS))
        self._dropped = 2 * FRACTION_BITS - resolution
        self._generator = generator
        self.answers: list[bool] = []

    def __call__(self, probe: FloatArray) -> bool:
        """Whether a unit vector matches.

        Raises:
            ValueError: the probe is longer than 1, as a gallery's own robot would be told.
        """
        raw = encode(probe[None], max_norm=1.0)[0].astype(np.float64)
        # Exact: |v . y| of quantised unit vectors is below 2^33. The dither moves the threshold by half a
        # step.
        moved = int(self._generator.integers(0, 1 << self._dropped)) - (1 << self._dropped >> 1)
        self.answers.append(bool(raw @ self._raw >= self._threshold - moved))
        return self.answers[-1]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What a prober knows beforehand: y is about normal with this mean and covariance.

    Attributes:
        mean: ``(n,)``.
        covariance: ``(n, n)``.
    """

    mean: FloatArray = field(repr=False)
    covariance: FloatArray = field(repr=False)

    @staticmethod
    def nothing(dim: int) -> Prior:
        """Any direction is as likely as any other."""
        return Prior(np.zeros(dim), np.eye(dim) / dim)

    @staticmethod
    def of(vectors: FloatArray, unknown: float = 0.02) -> Prior:
        """From vectors ``(m, n)`` of the same kind.

        Args:
            vectors: What is known.
            unknown: Share of the variance that is left to what they do not span.
        """
        covariance, dim = np.cov(vectors.T), vectors.shape[1]
        spread = unknown * np.trace(covariance) * np.eye(dim) / dim
        return Prior(vectors.mean(axis=0), (1 - unknown) * covariance + spread)

    def given(self, axes: FloatArray, values: FloatArray) -> Prior:
        """The same, once some coordinates are known.

        Args:
            axes: ``(n, k)``, orthonormal.
            values: ``(k,)``, the coordinates along them.
        """
        across = self.covariance @ axes
        gain = across @ np.linalg.pinv(axes.T @ across, rcond=1e-9)
        mean = self.mean + gain @ (values - axes.T @ self.mean)
        mean = mean + axes @ (values - axes.T @ mean)
        left = self.covariance - gain @ across.T
        # What rounding leaves along the axes is taken out on both sides, without a product of two matrices.
        left = left - axes @ (axes.T @ left)
        left = left - (left @ axes) @ axes.T
        return Prior(mean, (left + left.T) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class Probing:
    """What a prober got.

    Attributes:
        cosines: ``(bits,)``: cosine of the best guess with y after each bit.
        answers: ``(bits,)``: the bits.
    """

    cosines: FloatArray = field(repr=False)
    answers: npt.NDArray[np.bool_] = field(repr=False)

    def bits_until(self, cosine: float) -> int | None:
        """Bits until the guess has this cosine, or None."""
        reached = np.flatnonzero(self.cosines >= cosine)
        return int(reached[0]) + 1 if len(reached) else None

    def cosine_at_match(self, number: int) -> float | None:
        """The cosine when the so-and-so-many-th probe has matched; None if fewer do."""
        matched = np.flatnonzero(self.answers)
        return float(self.cosines[matched[number - 1]]) if len(matched) >= number else None


def probe(
    hidden: FloatArray,
    first: FloatArray,
    prior: Prior,
    threshold: float,
    bits: int,
    generator: np.random.Generator,
) -> Probing:
    """Spend so many bits on a hidden unit vector.

    Args:
        hidden: ``(n,)``, the unit vector.
        first: ``(n,)``, a unit vector that matches it.
        prior: What is known beforehand.
        threshold: Of a match.
        bits: Probes to spend.
        generator: Of directions and of the dither.
    """
    prober = _Prober(hidden, threshold, Oracle(hidden, threshold, generator))
    # That the first one matches tells something only where the prior did not expect it.
    expected = float(first @ prior.mean) >= threshold
    prober.guess = prior.mean if expected else prior.given(first[:, None], np.array([threshold])).mean
    prober.find_edge(first, _orthogonal(generator.standard_normal(len(hidden)), first))
    known = np.stack([prober.edge, prober.beside], axis=1)
    prober.bisect(prior.given(known, np.array([threshold, prober.find_length()])), bits)
    return Probing(np.array(prober.cosines[:bits]), np.array(prober.oracle.answers[:bits]))


class _Prober:
    """The prober's state; the hidden vector is known to it only to say how good each guess is.

    Attributes:
        oracle: What it asks.
        guess: ``(n,)``, its best guess so far, of any norm.
        cosines: Of the guess with the hidden vector, after each bit.
        edge: ``(n,)``, a unit vector whose product with the hidden one is the threshold.
        beside: ``(n,)``, the unit vector orthogonal to it in the plane in which it was found.
    """

    def __init__(self, hidden: FloatArray, threshold: float, oracle: Oracle) -> None:
        self._hidden, self._threshold = hidden, threshold
        self.oracle, self.cosines = oracle, list[float]()
        self.guess = self.edge = self.beside = np.zeros(len(hidden))

    def find_edge(self, first: FloatArray, away: FloatArray) -> None:
        """Step 2: the edge, on the way from a match over an orthogonal direction to the match's opposite."""
        low, high = 0.0, pi
        for _ in range(_EDGE_BITS):
            middle = (low + high) / 2
            low, high = (
                (middle, high) if self._ask(cos(middle) * first + sin(middle) * away) else (low, middle)
            )
        angle = (low + high) / 2
        self.edge = cos(angle) * first + sin(angle) * away
        self.beside = cos(angle) * away - sin(angle) * first

    def find_length(self) -> float:
        """The coordinate beside the edge, which no prior tells: how far within it the first match was."""
        high = sqrt(1 - self._threshold**2)
        low = -high
        for _ in range(_LENGTH_BITS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._above(self.beside, middle) else (low, middle)
        return (low + high) / 2

    def bisect(self, left: Prior, bits: int) -> None:
        """Step 4: the coordinates along the axes of what is left to know, until so many bits are spent."""
        variances, axes = np.linalg.eigh(left.covariance)
        self.guess, centre = left.mean.copy(), axes.T @ left.mean
        cells = [(-v * _gain(0, 0), i, 0, 0) for i, v in enumerate(variances) if v > _KNOWN]
        heapq.heapify(cells)
        while len(self.cosines) < bits and cells:
            _, i, depth, cell = heapq.heappop(cells)
            deviation, before = sqrt(variances[i]), _cell(depth, cell)[0]
            cut = centre[i] + deviation * _NORMAL.inv_cdf((2 * cell + 1) / 2 ** (depth + 1))
            depth, cell = depth + 1, 2 * cell + self._above(axes[:, i], cut, _TILT * deviation)
            self.guess += axes[:, i] * deviation * (_cell(depth, cell)[0] - before)
            self.cosines[-1] = self._cosine()  # of the guess that the bit has led to
            if depth < _DEEPEST:
                heapq.heappush(cells, (-variances[i] * _gain(depth, cell), i, depth, cell))

    def _above(self, axis: FloatArray, number: float, least: float = 1e-3) -> bool:
        """Step 3: whether ``axis . y`` is at least a number."""
        if number < 0:
            return not self._above(-axis, -number, least)
        tilt = 2 * atan(max(number, least) / self._threshold)
        return self._ask(cos(tilt) * self.edge + sin(tilt) * axis)

    def _ask(self, vector: FloatArray) -> bool:
        matches = self.oracle(vector)
        self.cosines.append(self._cosine())
        return matches

    def _cosine(self) -> float:
        return float(self.guess @ self._hidden / max(float(np.linalg.norm(self.guess)), _NOTHING))


def _orthogonal(vector: FloatArray, to: FloatArray) -> FloatArray:
    rest = vector - (vector @ to) * to
    return np.asarray(rest / np.linalg.norm(rest))


@cache
def _cell(depth: int, cell: int) -> tuple[float, float]:
    """Mean and variance of a standard normal number within one of 2^depth cells of equal chance."""
    chance = 2.0**-depth
    low = _NORMAL.inv_cdf(cell * chance) if cell else 0.0
    high = _NORMAL.inv_cdf((cell + 1) * chance) if cell + 1 < 2**depth else 0.0
    at_low = _density(low) if cell else 0.0
    at_high = _density(high) if cell + 1 < 2**depth else 0.0
    mean = (at_low - at_high) / chance
    return mean, 1 + (low * at_low - high * at_high) / chance - mean**2


@cache
def _gain(depth: int, cell: int) -> float:
    """By how much one more bit lowers that variance."""
    halves = _cell(depth + 1, 2 * cell)[1] + _cell(depth + 1, 2 * cell + 1)[1]
    return _cell(depth, cell)[1] - halves / 2


def _density(at: float) -> float:
    return exp(-at * at / 2) / sqrt(2 * pi)
