"""Probing with unit vectors: how many bits it takes, by kind of descriptor; and what strikes leave of it.

Four kinds: the demo's polar grids as they are (non-negative), the same with the public map's mean subtracted,
the demo's descriptors (whitened), and isotropic ones, as a perfect descriptor would be. Each with what a
prober finds in the public map beforehand, and without. Bits are decided in the clear, on integers, by the
engine's rule.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import comb, log2, sqrt

import numpy as np

from bench.attacks.prober import Prior, Probing, probe
from bench.attacks.world import World
from bench.demo.scan_context import DIMENSION, quarter_turns
from protocols.check.spread import bits_until, effective_dimension
from spdz.foundations.types import FloatArray

COSINES = (0.90, 0.95, 0.99)
"""Where bits are counted until."""
CHECKPOINTS = (40, 140, 400, 580, 800, 1563, 3100)
"""Bits after which the cosine is told."""
ISOTROPIC = 1536
"""Dimension of the isotropic descriptors."""
STRIKES, SLOTS = 3, 300
"""Unexplained matches after which a robot stops; slots that a mission deals."""
_RANDOM = 1000
"""Random unit vectors that are tried for each target."""


@dataclass(frozen=True, slots=True)
class ProbeRow:
    """How a kind of descriptor stands against a prober; medians over the targets.

    Attributes:
        descriptors: The kind.
        prior: What the prober knows beforehand.
        dimension: Coordinates.
        effective_dimension: ``protocols.check.spread.effective_dimension`` of what the prober's prior was
            made of.
        threshold: Of a match.
        first: How the prober came by its first match.
        targets: Hidden vectors.
        bits_090: Bits until the best guess has cosine 0.90 with the hidden vector; None if more were needed.
        bits_095: The same for 0.95.
        bits_099: The same for 0.99.
        rule_090: What the rule cos^2 = t^2 + 0.64 (1 - t^2) bits / d says for 0.90.
        cosine_before: Cosine of the best guess before any probe: the prior's mean; 0 without one.
        cosine_after: Cosines after some numbers of bits.
        equal: Share of the victim's vectors that an all-equal vector matches.
        foreign: Share of pairs of a public place, in any turn, and a victim's place that match.
        random: Share of random unit vectors' pairs that match.
        third_match: Cosine when the third probe has matched: where strikes end it.
    """

    descriptors: str
    prior: str
    dimension: int
    effective_dimension: float
    threshold: float
    first: str
    targets: int
    bits_090: int | None
    bits_095: int | None
    bits_099: int | None
    rule_090: int
    cosine_before: float
    cosine_after: dict[int, float]
    equal: float
    foreign: float | None
    random: float
    third_match: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """A kind of descriptor.

    Attributes:
        name: Its name.
        victim: ``(n, N)``, the victim's.
        public: ``(m, N)``, of other places, known to all; None where there are none.
        blind: Whether a prober that knows nothing beforehand is tried as well.
    """

    name: str
    victim: FloatArray = field(repr=False)
    public: FloatArray | None = field(repr=False)
    blind: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """A row and what it was made of, for the picture."""

    row: ProbeRow
    probings: list[Probing] = field(repr=False)


def kinds(world: World, generator: np.random.Generator) -> list[Kind]:
    """The four kinds."""
    public = np.concatenate([quarter_turns(grid, 4) for grid in world.public.grids])
    background, flat = world.public.background, (-1, DIMENSION)

    def made(name: str, describe: Callable[[FloatArray], FloatArray], blind: bool = True) -> Kind:
        return Kind(name, describe(world.alice.grids), describe(public), blind)

    return [
        made("raw Scan Context", lambda grids: _unit(grids.reshape(flat))),
        made("public mean subtracted", lambda grids: _unit(grids.reshape(flat) - background.mean), False),
        made("the demo's, whitened", background.describe),
        Kind("isotropic", _unit(generator.standard_normal((8, ISOTROPIC))), None),
    ]


def measure(world: World, seed: int, targets: int, bits: int) -> Iterator[Curves]:
    """Probe every kind.

    Args:
        world: Who is probed: Alice's keyframes.
        seed: Of everything random.
        targets: Hidden vectors of each kind.
        bits: Probes that each of them gets; twice as many of isotropic ones.
    """
    for kind in kinds(world, np.random.default_rng([seed, 0])):
        if kind.public is not None:
            yield _measured(
                kind, "the public map", Prior.of(kind.public), world.threshold, seed, targets, bits
            )
        if kind.blind:
            prior = Prior.nothing(kind.victim.shape[1])
            yield _measured(kind, "nothing", prior, world.threshold, seed, targets, bits)


def most_information(strikes: int, slots: int) -> float:
    """Bits that probes can tell of a vector if all stops at so many matches: log2 of the outcomes."""
    return log2(sum(comb(slots, matches) for matches in range(strikes + 1)))


def _measured(
    kind: Kind, name: str, prior: Prior, threshold: float, seed: int, targets: int, bits: int
) -> Curves:
    victim, dim = kind.victim, kind.victim.shape[1]
    chosen = np.linspace(0, len(victim) - 1, min(targets, len(victim))).round().astype(np.int64)
    equal = np.full(dim, 1 / sqrt(dim))
    probings = []
    for target in chosen:
        generator = np.random.default_rng([seed, 2, int(target)])
        hidden = victim[target]
        first = equal if equal @ hidden >= threshold else _first(hidden, threshold, kind.public, generator)
        spent = bits if kind.public is not None else 2 * bits
        probings.append(probe(hidden, first, prior, threshold, spent, generator))
    until = [_median([one.bits_until(cosine) for one in probings]) for cosine in COSINES]
    third = [one.cosine_at_match(STRIKES) for one in probings]
    effective = float(dim) if kind.public is None else effective_dimension(kind.public, neighbours=4)
    random = _unit(np.random.default_rng([seed, 1]).standard_normal((_RANDOM * targets, dim)))
    middle = median_curve(probings)
    row = ProbeRow(
        descriptors=kind.name,
        prior=name,
        dimension=dim,
        effective_dimension=round(effective, 1),
        threshold=threshold,
        first="an all-equal vector" if (victim @ equal >= threshold).all() else "given, past the threshold",
        targets=len(chosen),
        bits_090=until[0],
        bits_095=until[1],
        bits_099=until[2],
        rule_090=round(bits_until(COSINES[0], threshold, effective if name != "nothing" else dim)),
        cosine_before=round(float(np.median(victim @ _unit(prior.mean))), 3) if prior.mean.any() else 0.0,
        cosine_after={n: round(float(middle[n - 1]), 3) for n in CHECKPOINTS if n <= len(middle)},
        equal=_share(equal[None], victim, threshold),
        foreign=None if kind.public is None else _share(kind.public, victim, threshold),
        random=_share(random, victim, threshold),
        third_match=None if None in third else round(float(np.median(np.array(third, dtype=float))), 3),
    )
    return Curves(row, probings)


def median_curve(probings: list[Probing]) -> FloatArray:
    """The median of cosines after each bit, as far as all probings go."""
    everything = min(len(one.cosines) for one in probings)
    return np.asarray(np.median([one.cosines[:everything] for one in probings], axis=0))


def _share(vectors: FloatArray, victim: FloatArray, threshold: float) -> float:
    """Share of the pairs of two sets of vectors that match."""
    return round(float((vectors @ victim.T >= threshold).mean()), 6)


def _first(
    hidden: FloatArray, threshold: float, public: FloatArray | None, generator: np.random.Generator
) -> FloatArray:
    """A match that is given: beside the hidden vector, at the threshold and a hair more."""
    other = generator.standard_normal(len(hidden)) if public is None else generator.choice(public)
    other = _unit(other - (other @ hidden) * hidden)
    cosine = threshold + 1e-3
    return cosine * hidden + sqrt(1 - cosine**2) * other


def _median(bits: list[int | None]) -> int | None:
    """The median, if more than half are known."""
    known = sorted(n for n in bits if n is not None)
    at = len(bits) // 2
    return known[at] if at < len(known) else None


def _unit(rows: FloatArray) -> FloatArray:
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))
