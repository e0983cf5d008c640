"""Which thresholds make sense for a score, and which do not do what their user wants."""

from __future__ import annotations

from math import isfinite, sqrt

from protocols.question import Question
from protocols.scores import SCORES

_ROUNDING = 2.0**-13
"""How far the score of two equal descriptors may be from the ideal one: a few units of 2^-16, with room."""
_FLOORS = {"S1": _ROUNDING, "S3": _ROUNDING, "S5": 2.0**-22}
"""Distances that equal descriptors may have, of the scores that normalise inside."""
_USEFUL_STEPS = 1024
"""Steps of the resolution that a score's range should have."""
_FEWEST_STEPS = 8
"""Steps of the resolution that should lie between a threshold and the score of equal descriptors."""


def threshold_warning(purpose: Question, threshold: float | None) -> str | None:
    """Why a threshold will not do what its user wants, or None.

    Warned of are thresholds that every pair or no pair can pass, that equal descriptors pass only by luck,
    and that confuse a distance with its square. Of the last kind only those can be told by the number that
    are past a right angle: descriptors of norm at most R that have nothing in common (x . y = 0) are at
    most sqrt(2) R apart, and 2 R^2 squared. A threshold above that calls all of them the same place, which
    nobody wants whatever R is.

    Args:
        purpose: What the tape is for.
        threshold: In the score's units; None where scores are opened.
    """
    if threshold is None or purpose.reveal == "score" or not isfinite(threshold):
        return None
    return _out_of_place(purpose, threshold) or _too_coarse(purpose, threshold)


def is_hopeless(purpose: Question, threshold: float | None) -> bool:
    """Whether every pair or no pair can pass a threshold."""
    if threshold is None or purpose.reveal == "score":
        return False
    least, most = purpose.score_range
    if SCORES[purpose.score].similarity:
        return threshold <= least or threshold > most * (1 + _ROUNDING)
    return threshold < 0 or threshold >= most


def resolution_warning(purpose: Question) -> str | None:
    """Why a resolution is too coarse for any threshold, or None."""
    least, most = purpose.score_range
    if purpose.reveal == "score" or purpose.resolution is None:
        return None
    steps = (most - least) * 2.0**purpose.resolution
    if steps >= _USEFUL_STEPS:
        return None
    return (
        f"a resolution of 2^-{purpose.resolution} cuts {purpose.score}, which is from {least:g} to {most:g} "
        f"({_of_norm(purpose)}), into {steps:.3g} steps: deal for a finer one"
    )


def _too_coarse(purpose: Question, threshold: float) -> str | None:
    """A comparison with a resolution may move the threshold by half a step, either way."""
    if purpose.resolution is None:
        return None
    step, (least, most) = 2.0**-purpose.resolution, purpose.score_range
    alike, unlike = (most, least) if SCORES[purpose.score].similarity else (least, most)
    given = (
        f"the threshold {threshold:g} is compared in steps of 2^-{purpose.resolution} = {step:.2g}, and is"
    )
    if (room := abs(threshold - alike)) < _FEWEST_STEPS * step:
        return (
            f"{given} {room / step:.2g} of them from {alike:g}, where equal descriptors are: pairs near it "
            "are decided either way; deal for a finer --resolution, or exact"
        )
    if abs(threshold - unlike) < step:
        return f"{given} less than one of them from {unlike:g}: it lets every pair match, or all but chance"
    return None


def _out_of_place(purpose: Question, threshold: float) -> str | None:
    name, (least, most) = purpose.score, purpose.score_range
    given = f"the threshold {threshold:g}"
    if SCORES[name].similarity:
        if threshold <= least:
            return f"{given} lets every pair match: no {name} is below {least:g}"
        if threshold > most * (1 + _ROUNDING):
            return f"{given} lets no pair match: no {name} is above {most:g} ({_of_norm(purpose)})"
        if threshold >= most * (1 - _ROUNDING) or (name == "S10" and threshold == 1):
            return (
                f"{given} is met by equal descriptors up to rounding only, which may give 0.9999 or 1.00001 "
                "times the largest score: give a little less"
            )
        return None
    if threshold < 0:
        return f"{given} lets no pair match: a distance is never negative"
    if threshold >= most:
        return f"{given} lets every pair match: no {name} is above {most:g} ({_of_norm(purpose)})"
    if threshold < _FLOORS.get(name, 0):
        return f"{given} is met by equal descriptors up to rounding only: give at least {_FLOORS[name]:.1g}"
    unrelated = {"S3": most / sqrt(2), "S4": most / sqrt(2), "S5": most / 2, "S6": most / 2}
    if threshold > unrelated.get(name, most):
        other = f"S{int(name[1:]) + 2}"
        what = purpose.hint or f"{name} is not squared: for a threshold s of squared distances give sqrt(s)"
        return (
            f"{given} lets descriptors match that have nothing in common: at a right angle {name} is at most "
            f"{unrelated[name]:.4g}. {what}{'' if purpose.hint else f', or deal for {other}'}"
        )
    return None


def _of_norm(purpose: Question) -> str:
    if purpose.score in ("S2", "S4", "S6", "S10"):
        return f"of descriptors of norm at most {purpose.max_norm:g}, as is dealt for"
    return "by its definition"
