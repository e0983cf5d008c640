"""Path reconstruction: where Alice was, from what she tells Bob.

The paper's attack (Fishberg, Jia and How, "CILC", section "Path reconstruction from GD broadcast"): compare
each broadcast descriptor with one's own, and place the sender at the mean of one's own places that match.
Here beside a stronger attack on the same broadcast, and both attackers' counterparts in the private exchange.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.attacks.motion import rebuilt_grids, step_likelihoods
from bench.attacks.tracking import Floor
from bench.attacks.world import World, distances
from bench.demo.places import DIFFERENT, SAME
from spdz.foundations.types import FloatArray

LOCALISED = DIFFERENT
"""A keyframe counts as localised if its estimate is within so many metres."""
_TEMPER, _LEAST, _MOST = 0.3, -2.0, 1.0
"""What a score counts for is scaled and kept between, in nats: overlapping submaps are not independent, and
corridors look alike. Chosen on this run; 1 to 2 nats and twice the motion's sharpness give the same track."""
_ON_PATH = 1.0
"""Cells within so many metres of the attacker's own path are compared with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """One attack's outcome.

    Attributes:
        attack: Its name.
        source: ``"broadcast"``, ``"exchange"`` or ``"nothing"``: what it was fed with.
        knows: What the attacker knows of Alice.
        positions: ``(n_alice, 2)``, metres; NaN where it makes no claim.
    """

    attack: str
    source: str
    knows: str
    positions: FloatArray = field(repr=False)


@dataclass(frozen=True, slots=True)
class PathRow:
    """How good a reconstruction is. Errors are metres, over the keyframes that it claims to localise.

    Attributes:
        attack: The attack.
        source: What it was fed with.
        knows: What the attacker knows of Alice.
        keyframes: Alice's.
        claimed: Keyframes that it gives a position for.
        localised: Keyframes that it gives a position for within 4 m.
        share: Of all keyframes that are localised.
        median_m: Median error; None if it claims none.
        mean_m: Mean error; None if it claims none.
        unseen: Keyframes more than 4 m from Bob's own path.
        unseen_localised: Of these, localised ones.
        unseen_median_m: Median error over these, of those that it gives a position for; None if for none.
    """

    attack: str
    source: str
    knows: str
    keyframes: int
    claimed: int
    localised: int
    share: float
    median_m: float | None
    mean_m: float | None
    unseen: int
    unseen_localised: int
    unseen_median_m: float | None


def reconstructions(world: World) -> list[Reconstruction]:
    """Every attack on the paths, from what knows most to what knows nothing."""
    broadcast = world.alice.descriptors @ world.dense.descriptors.T
    matches = exchanged_matches(world)
    opened = np.asarray(matches.any(axis=1))
    revealed = np.where(opened[:, None], broadcast, -np.inf)
    at_matches = mean_of_matches(matches, world.bob.positions)
    every, count = f"all {len(world.alice)} descriptors, in their order", int(matches.sum())
    bits = f"which pairs of keyframes match ({count}), and the order"
    seen = f"that, and the {int(opened.sum())} descriptors that matches reveal"
    middle = np.broadcast_to(world.dense.positions.mean(axis=0), world.alice.positions.shape)
    return [
        Reconstruction(
            "the paper's, of matching scans",
            "broadcast",
            every,
            mean_of_matches(broadcast >= world.threshold, world.dense.positions),
        ),
        Reconstruction("matches, and steps between grids", "broadcast", every, track(world)),
        Reconstruction("the paper's, of matching keyframes", "exchange", bits, at_matches),
        Reconstruction(
            "revealed scans, straight lines between",
            "exchange",
            seen,
            joined(best_scan(revealed, world.dense.positions, world.threshold)),
        ),
        Reconstruction("the middle of Bob's own path", "nothing", "nothing", middle),
    ]


def exchanged_matches(world: World) -> npt.NDArray[np.bool_]:
    """The bits of the private exchange: ``(n_alice, n_bob)``, keyframes with keyframes."""
    return np.asarray(world.alice.descriptors @ world.bob.descriptors.T >= world.threshold)


def mean_of_matches(matches: npt.NDArray[np.bool_], positions: FloatArray) -> FloatArray:
    """The paper's rule: ``(m, n)`` matches with n own places; ``(m, 2)``, NaN without a match."""
    count = matches.sum(axis=1, keepdims=True)
    total = matches @ positions
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def best_scan(scores: FloatArray, positions: FloatArray, threshold: float) -> FloatArray:
    """The own place of the largest score, ``(m, 2)``; NaN where that is below the threshold."""
    good = scores.max(axis=1) >= threshold
    return np.where(good[:, None], positions[scores.argmax(axis=1)], np.nan)


def joined(positions: FloatArray) -> FloatArray:
    """Straight lines between the positions that are known, in the order of keyframes."""
    known = np.isfinite(positions[:, 0])
    if not known.any():
        return positions
    at = np.arange(len(positions))
    return np.stack([np.interp(at, at[known], positions[known, axis]) for axis in (0, 1)], axis=1)


def track(world: World) -> FloatArray:
    """All that a broadcast tells: own scans that match, and the steps that descriptors in a row give away."""
    own = _rotate(world.dense.positions, -world.public.walls)
    floor = Floor.around(own)
    # Cells near Bob's path are as likely as the score with his nearest place says; of others he knows
    # nothing.
    place, apart = floor.nearest(own)
    scores = world.alice.descriptors @ world.dense.descriptors.T
    nats = np.clip(_TEMPER * _evidence(world, scores), _LEAST, _MOST)
    likely = [np.where(apart < _ON_PATH, np.exp(one)[place], 1.0) for one in nats]
    rebuilt = rebuilt_grids(world.alice.descriptors, world.dense.grids, world.public.background)
    return _rotate(floor.track(step_likelihoods(rebuilt), likely), world.public.walls)


def _evidence(world: World, scores: FloatArray) -> FloatArray:
    """Log-likelihood ratio of same place against another, of scores; from Bob's own and the public map."""
    public = world.public.background.describe(world.public.grids)
    known = world.dense.descriptors @ public.T
    apart = distances(world.dense.positions, world.public.positions)
    (same, spread), (other, width) = (
        (known[where].mean(), known[where].std()) for where in (apart < SAME, apart > DIFFERENT)
    )
    nats = ((scores - other) / width) ** 2 / 2 - ((scores - same) / spread) ** 2 / 2 + np.log(width / spread)
    return np.asarray(nats)


def _rotate(points: FloatArray, angle: float) -> FloatArray:
    turned = (points[:, 0] + 1j * points[:, 1]) * np.exp(1j * angle)
    return np.stack([turned.real, turned.imag], axis=1)


def judged(found: Reconstruction, world: World) -> PathRow:
    """Hold a reconstruction against the truth."""
    error = np.linalg.norm(found.positions - world.alice.positions, axis=1)
    claimed, right = np.isfinite(error), error <= LOCALISED
    return PathRow(
        attack=found.attack,
        source=found.source,
        knows=found.knows,
        keyframes=len(error),
        claimed=int(claimed.sum()),
        localised=int(right.sum()),
        share=round(float(right.mean()), 3),
        median_m=_rounded(np.median, error[claimed]),
        mean_m=_rounded(np.mean, error[claimed]),
        unseen=int(world.unseen.sum()),
        unseen_localised=int((right & world.unseen).sum()),
        unseen_median_m=_rounded(np.median, error[claimed & world.unseen]),
    )


def _rounded(statistic: Callable[[FloatArray], Any], errors: FloatArray) -> float | None:
    return round(float(statistic(errors)), 2) if len(errors) else None
