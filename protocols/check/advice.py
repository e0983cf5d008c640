"""What to do about descriptors, in words: each sentence from a figure of theirs."""

from __future__ import annotations

from collections.abc import Iterator

from protocols.check.standing import Form, Standing
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import MAX_NORM

RARE = 1e-4
"""Share of foreign pairs that may match: what "a probe must guess" needs."""
_FEW_BITS = 300
"""Fewer probe bits than this fit a usual mission's slots."""
_STRIKES = 22
"""What three strikes in 300 slots leave, in bits: log2 of all answers with at most three matches."""
_MANY = 0.25
"""More vanishing numbers than this are told."""
_GAIN = 1.5
"""Whitening is advised if it makes the effective dimension so many times larger."""


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
        yield (
            f"an all-equal vector matches {form.equal:.0%} of them: anybody has a match without knowing "
            "anything. Subtract a public mean before normalising."
        )
    if form.foreign is not None and form.foreign > RARE:
        whitened = standing.whitened.foreign
        helps = whitened is not None and whitened < form.foreign / 2
        yield (
            f"a descriptor of another place matches in {form.foreign:.2g} of the pairs, more than 10^-4: to "
            "probe, nobody need guess a vector near yours. "
            f"{'Whiten' if helps else 'Ask for a stricter threshold'}."
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
        stops = "counting matches that nobody follows up does" if form.bits > _STRIKES else "nor do strikes"
        yield (
            f"after a first match {form.bits:.0f} probe bits, and some 30 to begin with, give a guess of "
            f"cosine 0.9 (effective dimension {form.effective_dimension:.0f}). The slots of a mission seldom "
            f"stop that; {stops}."
        )


def _whitening(standing: Standing) -> Iterator[str]:
    now = standing.as_is
    for what, form in (("subtracting the mean", standing.centred), ("whitening", standing.whitened)):
        better = form.effective_dimension > _GAIN * now.effective_dimension
        if better or _fewer(now, form):
            yield f"{what} {_change(now, form)}."
    if (
        standing.whitened.effective_dimension > _GAIN * now.effective_dimension
        and standing.whitened.thresholds
    ):
        ends = " to ".join(f"{end:.3g}" for end in standing.whitened.thresholds)
        yield f"whitened descriptors need another threshold: {ends} would make sense for these."


def _fewer(now: Form, form: Form) -> bool:
    return any(
        before is not None and after is not None and before > RARE and after < before / 2
        for before, after in ((now.equal, form.equal), (now.foreign, form.foreign))
    )


def _change(now: Form, form: Form) -> str:
    changes = [
        f"the effective dimension from {now.effective_dimension:.0f} to {form.effective_dimension:.0f}"
    ]
    for name, before, after in (
        ("all-equal", now.equal, form.equal),
        ("foreign", now.foreign, form.foreign),
        ("own", now.own, form.own),
    ):
        if before and after is not None:
            changes.append(f"{name} matches from {before:.2g} to {after:.2g}")
    return f"would change {', '.join(changes)}"


def _threshold(standing: Standing) -> Iterator[str]:
    ends = standing.as_is.thresholds
    other = "descriptors of another place" if standing.foreign_count else "rows that are no neighbours"
    side = ">=" if SCORES[standing.score].similarity else "<="
    if ends is None:
        yield (
            f"no threshold tells them apart: one pair in 10^4 of {other} is as near as half of the direct "
            "neighbours. Whiten, or use another descriptor."
        )
        return
    yield (
        f"a threshold from {ends[0]:.3g} to {ends[1]:.3g} makes sense ({standing.score} {side} it): past the "
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
            f"{standing.vanished:.0%} of the numbers that are not zero are below 2^-17 and become zero: "
            "scale the descriptors up, and deal with a larger --max-norm."
        )
