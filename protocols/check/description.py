"""How a user's own descriptors stand: their norms, and how easily they are guessed, matched and told apart.

A candidate bit hides a descriptor only as far as it cannot be guessed (threat model, section on probes). That
is a property of the descriptors, not of the protocol, and this measures it before a mission: on the user's
own file, in the clear, on one machine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from protocols.catalog import Purpose
from protocols.check.advice import advice
from protocols.check.clear_scores import score_table
from protocols.check.spread import MOST_ROWS, SHRINKAGE, Whitening, evenly, thinned
from protocols.check.standing import Norms, Standing
from protocols.check.trials import Trials
from protocols.scores import SCORES
from protocols.thresholds import is_hopeless, threshold_warning
from spdz.arithmetic.fixed_point import FRACTION_BITS, MAX_NORM, norm_bound
from spdz.foundations.types import FloatArray

NEIGHBOURS = 5
"""Rows at most so far apart may show one place; they are not counted as two."""
_TINY, _HUGE = 2.0**-100, 2.0**60
"""Numbers that no fixed-point number stands for, and whose squares are still floats."""
_L1_ROWS = 300
"""Rows that are compared where a score is no matrix product."""


def describe(
    descriptors: npt.ArrayLike,
    *,
    foreign: npt.ArrayLike | None = None,
    score: str = "S10",
    threshold: float | None = None,
    max_norm: float = 1.0,
    neighbours: int = NEIGHBOURS,
    seed: int = 1,
) -> Standing:
    """Say how descriptors stand.

    Args:
        descriptors: ``(n, N)``, in the order in which they were taken.
        foreign: ``(m, N)``, of another place, the more the better: they stand for what anybody has.
        score: ``"S1"`` to ``"S10"``.
        threshold: Of a match, in the score's units.
        max_norm: What would be dealt for.
        neighbours: Rows at most so far apart may show one place.
        seed: Of the random vectors.

    Raises:
        ValueError: for what is no array of enough descriptors, an unknown score, or a threshold that no pair
            or every pair passes.
    """
    if score not in SCORES:
        raise ValueError(f"unknown score {score!r}; known scores are {', '.join(SCORES)}")
    if threshold is not None and not np.isfinite(threshold):
        raise ValueError(f"expected a finite threshold, got {threshold}")
    rows = _table(descriptors, "descriptors")
    finite, zero = _usable(rows)
    good, fewest = rows[finite & ~zero], 4 * neighbours + 8
    if len(good) < fewest:
        raise ValueError(
            f"expected at least {fewest} descriptors that are finite and not all zero (8, and 4 for each of "
            f"--neighbours {neighbours}), got {len(good)} of {len(rows)}: give the descriptors of a whole "
            "drive, in the order in which they were taken, or fewer neighbours"
        )
    others = None if foreign is None else _foreign(foreign, rows.shape[1])
    most = _L1_ROWS if score in ("S1", "S2") else MOST_ROWS
    index = evenly(len(good) - 1, most)
    kept, following = good[index], good[index + 1]
    norms = _norms(good, max_norm)
    _reachable(score, threshold, rows.shape[1], max(max_norm, norms.advised))
    trials = Trials(score, norms.median, thinned(neighbours, len(good), len(kept)), seed)
    theirs = None if others is None else others[evenly(len(others), most)]
    useful = trials.thresholds(kept, following, theirs)
    at = threshold if threshold is not None or useful is None else useful[0]
    # What learns the statistics is not what is judged by them: few rows look white under their own.
    half = len(kept) // 2
    public, judged, after, strangers = kept[:half], kept[half:], following[half:], theirs
    source = "the first half of the descriptors themselves, and judged on the second"
    if theirs is not None and len(theirs) >= fewest:
        public, strangers = theirs[: len(theirs) // 2], theirs[len(theirs) // 2 :]
        judged, after = kept, following
        source = "the first half of the foreign descriptors, and the second half tried against these"
    forms = [trials.form(kept, following, theirs, at)]
    for shrinkage in (None, SHRINKAGE):
        changed = Whitening.fit(public, shrinkage)
        forms.append(
            trials.form(
                changed.applied(judged, norms.median),
                changed.applied(after, norms.median),
                None if strangers is None else changed.applied(strangers, norms.median),
                at,
            )
        )
    standing = Standing(
        count=len(rows),
        dim=rows.shape[1],
        unusable=int((~finite).sum()),
        zero=int(zero.sum()),
        duplicates=len(good) - len(np.unique(good, axis=0)),
        norms=norms,
        score=score,
        threshold=at,
        threshold_given=threshold is not None,
        foreign_count=None if others is None else len(others),
        statistics_of=source,
        as_is=forms[0],
        centred=forms[1],
        whitened=forms[2],
        rounding=_rounding(score, kept[evenly(len(kept), _L1_ROWS)]),
        vanished=_vanished(good),
        advice=(),
    )
    return replace(standing, advice=tuple(advice(standing)))


def _table(array: npt.ArrayLike, name: str) -> FloatArray:
    """An array of real rows, as float64.

    Raises:
        ValueError: if it is none.
    """
    rows = np.asarray(array)
    if rows.dtype.kind not in "iuf":
        raise ValueError(f"{name}: expected integers or floats, got an array of type {rows.dtype}")
    if rows.ndim != 2 or 0 in rows.shape:
        raise ValueError(
            f"{name}: expected an array of shape (n, N), one descriptor a row, got shape {rows.shape}"
        )
    return rows.astype(np.float64)


def _usable(rows: FloatArray) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Which rows are numbers, and which of these have norm 0."""
    sizes = np.abs(rows)  # NaN is not below
    finite = np.asarray((sizes < _HUGE).all(axis=1))
    return finite, np.asarray(finite & (sizes < _TINY).all(axis=1))


def _foreign(array: npt.ArrayLike, dim: int) -> FloatArray:
    rows = _table(array, "foreign descriptors")
    if rows.shape[1] != dim:
        raise ValueError(
            f"foreign descriptors: expected {dim} numbers a row as the own ones have, got {rows.shape[1]}: "
            "give descriptors of the same kind, of another place"
        )
    finite, zero = _usable(rows)
    good = rows[finite & ~zero]
    if not len(good):
        raise ValueError("foreign descriptors: none of them is finite and not all zero")
    return good


def _reachable(score: str, threshold: float | None, dim: int, max_norm: float) -> None:
    """Refuse a threshold that a dealer refuses, of norms that are dealt for.

    Raises:
        ValueError: if every pair or no pair can pass it.
    """
    purpose = Purpose(score, dim, max_norm=min(max_norm, MAX_NORM))
    if is_hopeless(purpose, threshold):
        raise ValueError(threshold_warning(purpose, threshold))


def _norms(rows: FloatArray, max_norm: float) -> Norms:
    """Norms, held against what a robot would refuse: the norm of the quantised vector."""
    dim = rows.shape[1]
    quantised = np.linalg.norm(np.rint(rows * (1 << FRACTION_BITS)), axis=1)
    sizes = np.linalg.norm(rows, axis=1)
    most = float(sizes.max())
    outside = int((quantised > norm_bound(max_norm, dim)).sum())
    return Norms(
        least=float(sizes.min()),
        median=float(np.median(sizes)),
        most=most,
        max_norm=max_norm,
        outside=outside,
        advised=_advised(most, float(quantised.max()), dim),
    )


def _advised(most: float, quantised: float, dim: int) -> float:
    """The largest norm, or 1 where that serves; of others three digits, rounded up."""
    if quantised <= norm_bound(1.0, dim) and most > 0.5:
        return 1.0
    step = 10.0 ** (np.floor(np.log10(most)) - 2)
    return float(f"{np.ceil(most / step) * step:.3g}")


def _rounding(score: str, rows: FloatArray) -> float:
    """The largest change of a score by quantising both descriptors."""
    rounded = np.rint(rows * (1 << FRACTION_BITS)) / (1 << FRACTION_BITS)
    return float(np.abs(score_table(score, rows, rows) - score_table(score, rounded, rounded)).max())


def _vanished(rows: FloatArray) -> float:
    """Share of the coordinates that are not zero and are quantised to zero."""
    present = rows != 0
    return float((present & (np.rint(rows * (1 << FRACTION_BITS)) == 0)).sum() / max(present.sum(), 1))
