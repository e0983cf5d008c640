"""What is found out about descriptors: the fields that the command prints and ``--json`` writes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Norms:
    """L2 norms of the rows that are numbers and not all zero.

    Attributes:
        least: The smallest.
        median: The median.
        most: The largest.
        max_norm: What they were held against.
        outside: How many a gallery or job of this ``max_norm`` would refuse.
        advised: What to deal for, as ``--max-norm``.
    """

    least: float
    median: float
    most: float
    max_norm: float
    outside: int
    advised: float


@dataclass(frozen=True, slots=True)
class Form:
    """How descriptors in one form stand: as they are, with a mean subtracted, or whitened.

    Shares are of pairs that match at the threshold; None where there is no threshold or nothing to try.

    Attributes:
        effective_dimension: :func:`protocols.check.spread.effective_dimension`.
        random: Random unit vectors of their norm.
        equal: An all-equal vector of their norm, of either sign.
        foreign: Descriptors of another place.
        own: Their own, of rows that are no neighbours. Places that were visited twice count.
        bits: Probe bits until a guess has cosine 0.9 (:func:`protocols.check.spread.bits_until`); None for L1
            scores.
        thresholds: Where a threshold makes sense, the laxer end first: from what one pair in 10^4 of
            different places reaches, to what half of the direct neighbours do; None where the first is past
            the second.
    """

    effective_dimension: float
    random: float | None
    equal: float | None
    foreign: float | None
    own: float | None
    bits: float | None
    thresholds: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Standing:
    """How descriptors stand.

    Attributes:
        count: Rows.
        dim: Numbers a row.
        unusable: Rows that hold NaN, infinity, or numbers beyond any norm.
        zero: Rows of norm 0.
        duplicates: Rows that equal an earlier one.
        norms: Their norms.
        score: The score function.
        threshold: Of a match, as given, or the laxest that makes sense as they are; None without either.
        threshold_given: Whether it was given.
        foreign_count: Rows of the foreign descriptors, or None.
        statistics_of: What mean and covariance were learnt from.
        as_is: As they are.
        centred: With the mean subtracted, and brought to their norm.
        whitened: Whitened (shrinkage 0.3), and brought to their norm.
        rounding: Largest change of a score by rounding coordinates to 2^-16, on pairs of the rows.
        vanished: Share of coordinates that are not zero and become zero by it.
        advice: What to do, in words.
    """

    count: int
    dim: int
    unusable: int
    zero: int
    duplicates: int
    norms: Norms
    score: str
    threshold: float | None
    threshold_given: bool
    foreign_count: int | None
    statistics_of: str
    as_is: Form
    centred: Form
    whitened: Form
    rounding: float
    vanished: float
    advice: tuple[str, ...]
