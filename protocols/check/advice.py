"""What to do about descriptors, in words: each sentence from a figure of theirs."""

from __future__ import annotations

from collections.abc import Iterator

from protocols.check.percent import percent
from protocols.check.standing import Form, Standing
from protocols.check.trials import RARE
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import MAX_NORM

_PLACES = 4
"""Shares are held against RARE as they are shown: the threshold that is suggested meets it by a hair."""
_FEW_BITS = 300
"""Fewer probe bits than this fit a usual mission's slots."""
_MANY = 0.25
"""More vanishing numbers than this are told."""
_GAIN = 1.5
"""Whitening is advised if it makes the effective dimension so many times larger."""
_SAME = 1.1
"""Effective dimensions that differ by a smaller factor are as good as equal."""


def advice(standing: Standing) -> Iterator[str]:
    """Sentences, the most urgent first.

    Args:
        standing: All the figures.
    """
    yield from _broken(standing)
    yield from _norms(standing)
    yield from _guessing(standing)
    yield from _whitening(standing)
    yield from _threshold(standing)
    yield from _numbers(standing)


def _broken(standing: Standing) -> Iterator[str]:
    if standing.unusable:
        yield (
            f"{standing.unusable} of {standing.count} rows hold NaN, infinity or huge numbers. A robot "
            "refuses them; find out where they come from."
        )
    if standing.zero:
        yield (
            f"{standing.zero} rows are all zero. Leave them out: under a distance a zero vector is near "
            "everything, and under a cosine it has none."
        )
    if standing.duplicates:
        yield (
            f"{standing.duplicates} rows equal an earlier one. Each takes a slot; a robot that stands still "
            "should bring a keyframe once."
        )


def _norms(standing: Standing) -> Iterator[str]:
    norms = standing.norms
    if norms.advised > MAX_NORM:
        yield f"norms reach {norms.most:g}; no tape takes more than {MAX_NORM:.0f}: divide the descriptors."
    elif norms.outside:
        yield (
            f"{norms.outside} rows are longer than {norms.max_norm:g}: deal with --max-norm "
            f"{norms.advised:g}, or bring them to norm 1 on the robot, which is cheaper."
        )
    elif norms.advised < norms.max_norm / 2:
        yield (
            f"no row is longer than {norms.most:.3g}: deal with --max-norm {norms.advised:g}, which stores "
            "less and leaves a prober less room."
        )
    if standing.score in ("S2", "S4", "S6"):
        yield (
            f"{standing.score} is a distance that does not normalise: deal with --min-norm just below "
            f"{norms.least:.3g}, or a short vector of a prober is near everything."
        )


def _guessing(standing: Standing) -> Iterator[str]:
    form = standing.as_is
    if form.equal:
        centred = standing.centred.equal
        helps = centred is not None and centred < form.equal / 2
        yield (
            f"an all-equal vector matches {percent(form.equal)} of them: anybody has a match without knowing "
            f"anything.{' Subtract a public mean before normalising.' if helps else ''}"
        )
    if form.foreign is not None and round(form.foreign, _PLACES) > RARE:
        yield (
            f"a descriptor of another place matches in {percent(form.foreign)} of the pairs, more than "
            f"{percent(RARE)}: to probe, nobody need guess a vector near yours.{_remedy(standing)}"
        )
    if standing.foreign_count is None:
        yield (
            "how often descriptors of another place match is not known: give some thousands with --foreign, "
            "of any public data set of the same kind."
        )
    if form.bits == 0:
        yield (
            "a vector that matches is a guess of cosine 0.9 by itself: all depends on how rarely a vector "
            "that is not yours matches."
        )
    elif form.bits is not None and form.bits < _FEW_BITS:
        yield (
            f"after a first match {form.bits:.0f} probe bits, and some 30 to begin with, give a guess of "
            f"cosine 0.9 (effective dimension {form.effective_dimension:.0f}). The slots of a mission seldom "
            "stop that. An agent's strikes do between its steps; one step may ask as many bits as slots, and "
            "a second's share of the budget, allow."
        )


def _remedy(standing: Standing) -> str:
    now, whitened = standing.as_is, standing.whitened
    fewer = now.foreign is not None and whitened.foreign is not None and whitened.foreign < now.foreign / 2
    if fewer and whitened.thresholds is not None:
        return " Whiten."
    return "" if now.thresholds is None else " Ask for a stricter threshold."


def _whitening(standing: Standing) -> Iterator[str]:
    now = standing.as_is
    for what, form in (("subtracting the mean", standing.centred), ("whitening", standing.whitened)):
        better = form.effective_dimension > _GAIN * now.effective_dimension
        if better or _fewer(now, form):
            yield f"{what} would make it {_change(standing, form)}."
    if (
        standing.whitened.effective_dimension > _GAIN * now.effective_dimension
        and standing.whitened.thresholds
    ):
        ends = " to ".join(f"{end:.4g}" for end in standing.whitened.thresholds)
        yield f"whitened descriptors need another threshold: {ends} would make sense for these."


def _fewer(now: Form, form: Form) -> bool:
    return any(
        before is not None and after is not None and before > RARE and after < before / 2
        for before, after in ((now.equal, form.equal), (now.foreign, form.foreign))
    )


def _change(standing: Standing, form: Form) -> str:
    """What is better and what is worse in another form; what stays as it is is left out."""
    now, better, worse = standing.as_is, list[str](), list[str]()
    ratio = form.effective_dimension / now.effective_dimension
    if not 1 / _SAME < ratio < _SAME:
        sizes = f"{form.effective_dimension:.0f} instead of {now.effective_dimension:.0f}"
        (better if ratio > 1 else worse).append(f"effective dimension {sizes}")
    for name, before, after in (
        ("an all-equal vector matches", now.equal, form.equal),
        ("foreign ones match", now.foreign, form.foreign),
    ):
        if before is not None and after is not None and percent(before) != percent(after):
            share = f"{percent(after)} instead of {percent(before)}"
            (better if after < before else worse).append(f"{name} {share}")
    parts = [("better", better), ("worse", worse)]
    return "; and ".join(f"{word}: {', '.join(changes)}" for word, changes in parts if changes)


def _threshold(standing: Standing) -> Iterator[str]:
    ends = standing.as_is.thresholds
    other = "descriptors of another place" if standing.foreign_count else "rows that are no neighbours"
    side = ">=" if SCORES[standing.score].similarity else "<="
    if ends is None:
        whitened = "Whitened they can be; or" if standing.whitened.thresholds else "Nor whitened:"
        yield (
            f"no threshold tells them apart: one pair in 10^4 of {other} is as near as half of the direct "
            f"neighbours. {whitened} use another descriptor, or keyframes so close that neighbours are alike."
        )
        return
    yield (
        f"a threshold from {ends[0]:.4g} to {ends[1]:.4g} makes sense ({standing.score} {side} it): past the "
        f"first at most one pair in 10^4 of {other} matches, at the second half of the direct neighbours "
        "still do."
    )
    if standing.threshold_given and standing.threshold is not None:
        lax = standing.threshold < ends[0] if side == ">=" else standing.threshold > ends[0]
        if lax:
            yield f"the threshold {standing.threshold:g} is laxer than that."


def _numbers(standing: Standing) -> Iterator[str]:
    if standing.vanished > _MANY:
        yield (
            f"{percent(standing.vanished)} of the numbers that are not zero are below 2^-17 and become zero: "
            "scale the descriptors up, and deal with a larger --max-norm."
        )
