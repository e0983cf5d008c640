"""Scan reconstruction: what Alice saw, from her descriptors, by a regression that Bob fits on his own scans.

Ridge regression (Hoerl and Kennard, Technometrics 1970) from the descriptor to the occupancy of the cells
around the place. Bob makes descriptors of his own scans, in four quarter turns each, and so has as many
examples as he likes. The paper does the same to camera images, with a convolutional decoder.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.attacks.paths import exchanged_matches
from bench.attacks.world import CELLS, Places, World, quarter_turned
from bench.demo.scan_context import Background, quarter_turns
from spdz.foundations.types import FloatArray

RIDGE = 1.0
"""What is added to the eigenvalues of the descriptors' second moments; best on the attacker's own last
quarter."""
_CUTS = np.arange(0.05, 0.6, 0.025)
"""From what predicted occupancy a cell counts as occupied: the best of these on the attacker's own scans."""
_TRIED = 7
"""The cut is chosen on every seventh cell: enough, and quicker."""


@dataclass(frozen=True, slots=True, eq=False)
class Decoder:
    """A fitted regression.

    Attributes:
        mean: ``(CELLS * CELLS,)``: occupancy of the attacker's own scans on the whole.
        weights: ``(1200, CELLS * CELLS)``.
        cut: Predicted occupancy from which a cell counts as occupied.
    """

    mean: FloatArray = field(repr=False)
    weights: FloatArray = field(repr=False)
    cut: float

    @staticmethod
    def fit(own: Places, background: Background, turns: int = 4) -> Decoder:
        """Fit on the attacker's own places, in so many quarter turns each.

        The cut is chosen on the last quarter of them, by a fit on the others.
        """
        x = background.describe(np.concatenate([quarter_turns(grid, turns) for grid in own.grids]))
        y = np.concatenate([quarter_turned(seen, turns) for seen in own.occupancy])
        y = y.reshape(len(x), -1).astype(np.float64)
        held = len(x) * 3 // 4
        trial = Decoder(*_ridge(x[:held], y[:held, ::_TRIED]), 0.0)
        guessed, truth = trial.occupancy(x[held:]), y[held:, ::_TRIED] > 0
        cut = max(_CUTS, key=lambda cut: float(np.median(overlap(guessed >= cut, truth))))
        return Decoder(*_ridge(x, y), float(cut))

    def occupancy(self, descriptors: FloatArray) -> FloatArray:
        """Predicted occupancy: ``(n, CELLS * CELLS)``."""
        return np.asarray(self.mean + descriptors @ self.weights)


def _ridge(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and weights; by the dual problem where there are fewer examples than numbers in a descriptor."""
    mean = y.mean(axis=0)
    if len(x) < x.shape[1]:
        return mean, x.T @ np.linalg.solve(x @ x.T + RIDGE * np.eye(len(x)), y - mean)
    return mean, np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ (y - mean))


def overlap(first: npt.NDArray[np.bool_], second: npt.NDArray[np.bool_]) -> FloatArray:
    """Intersection over union of occupied cells, row by row."""
    union = (first | second).sum(axis=1)
    return np.asarray((first & second).sum(axis=1) / np.maximum(union, 1))


def correlation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Pearson correlation, row by row; 0 where a row is constant."""
    a, b = (rows - rows.mean(axis=1, keepdims=True) for rows in (first, second))
    size = np.sqrt((a * a).sum(axis=1) * (b * b).sum(axis=1))
    return np.asarray(np.divide((a * b).sum(axis=1), size, out=np.zeros(len(a)), where=size > 0))


@dataclass(frozen=True, slots=True)
class ScanRow:
    """How good rebuilt scans are; medians over Alice's keyframes.

    Attributes:
        attack: What is guessed.
        source: ``"broadcast"``, ``"exchange"`` or ``"nothing"``: what it was fed with.
        keyframes: Alice's.
        fed: Keyframes of which it has the descriptor.
        overlap: Intersection over union of occupied cells (0.5 m).
        correlation: Of predicted occupancy with the true one.
        overlap_unseen: The overlap where Bob has never been.
    """

    attack: str
    source: str
    keyframes: int
    fed: int
    overlap: float
    correlation: float
    overlap_unseen: float


@dataclass(frozen=True, slots=True, eq=False)
class Rebuilt:
    """Scans as they are and as they were guessed.

    Attributes:
        rows: The figures.
        true: ``(n_alice, CELLS, CELLS)``.
        guessed: ``(n_alice, CELLS, CELLS)``, predicted occupancy from the broadcast.
        constant: ``(CELLS, CELLS)``, what every scan has: the best guess without a descriptor.
        revealed: ``(n_alice,)``: of which keyframes the private exchange reveals the descriptor.
    """

    rows: list[ScanRow]
    true: npt.NDArray[np.bool_] = field(repr=False)
    guessed: FloatArray = field(repr=False)
    constant: FloatArray = field(repr=False)
    revealed: npt.NDArray[np.bool_] = field(repr=False)


def rebuild(world: World, seed: int, turns: int = 4) -> Rebuilt:
    """Fit on Bob's scans and rebuild Alice's.

    Args:
        world: Who attacks whom.
        seed: Of the permutation that the baseline uses.
        turns: Quarter turns of each of Bob's scans that are examples.
    """
    decoder = Decoder.fit(world.dense, world.public.background, turns)
    true = world.alice.occupancy.reshape(len(world.alice), -1)
    constant = np.tile(decoder.mean, (len(true), 1))
    guessed = decoder.occupancy(world.alice.descriptors)
    revealed = np.asarray(exchanged_matches(world).any(axis=1))
    shuffled = guessed[np.random.default_rng(seed).permutation(len(guessed))]
    # What most cells hold decides of a constant where it is cut: where that is best on Bob's own scans.
    own = world.dense.occupancy.reshape(len(world.dense), -1)
    flat = max(_CUTS, key=lambda cut: float(np.median(overlap(decoder.mean[None] >= cut, own))))
    unseen, everything = world.unseen, len(true)

    def row(attack: str, source: str, fed: int, guess: FloatArray, cut: float | FloatArray) -> ScanRow:
        shared = overlap(guess >= cut, true)
        alike = float(np.median(correlation(guess, true.astype(np.float64))))
        return ScanRow(
            attack,
            source,
            everything,
            fed,
            round(float(np.median(shared)), 3),
            round(alike, 3),
            round(float(np.median(shared[unseen])), 3),
        )

    told = np.where(revealed[:, None], guessed, constant)
    cuts = np.where(revealed[:, None], decoder.cut, flat)
    return Rebuilt(
        [
            row("ridge regression", "broadcast", everything, guessed, decoder.cut),
            row("regression if revealed, else constant", "exchange", int(revealed.sum()), told, cuts),
            row("the constant", "nothing", 0, constant, flat),
            row("rebuilt scans of other keyframes", "nothing", 0, shuffled, decoder.cut),
        ],
        world.alice.occupancy,
        guessed.reshape(-1, CELLS, CELLS),
        decoder.mean.reshape(CELLS, CELLS),
        revealed,
    )
