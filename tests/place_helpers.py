"""Places of several descriptors for tests, and what is decided of them, by plain NumPy."""

from collections.abc import Mapping

import numpy as np

from protocols import Part, PlacePurpose

LIDAR = Part("lidar", "S10", 7, 4)
CAMERA = Part("camera", "S10", 5)
MIXED = (Part("lidar", "S10", 7, 2), Part("depth", "S6", 4, max_norm=2.0, min_norm=0.5), Part("key", "S8", 3))
THRESHOLDS = {"lidar": 0.35, "camera": 0.1, "depth": 3.0, "key": 0.3}


def thresholds(purpose: PlacePurpose) -> Mapping[str, float]:
    return {part.name: THRESHOLDS[part.name] for part in purpose.parts}


def terms(purpose: PlacePurpose, security="malicious"):
    return purpose.terms(thresholds(purpose), security)


def places(purpose: PlacePurpose, count: int, seed=0) -> np.ndarray:
    """Places of the largest norms."""
    rng, columns = np.random.default_rng([count, seed]), []
    for part in purpose.parts:
        for _ in range(part.turns):
            turn = rng.standard_normal((count, part.dim))
            columns.append(part.max_norm * turn / np.linalg.norm(turn, axis=1, keepdims=True))
    return np.concatenate(columns, axis=1)


def cuts(purpose: PlacePurpose):
    """Part, turn and columns, written out."""
    at = 0
    for part in purpose.parts:
        for turn in range(part.turns):
            yield part, turn, slice(at, at + part.dim)
            at += part.dim


def decisions(purpose: PlacePurpose, x, y, limits: Mapping[str, float]) -> np.ndarray:
    """What is to be opened: (R, C) booleans, from quantised places in Python integers."""
    x, y = (np.rint(np.asarray(one) * 65536).astype(np.int64).astype(object) for one in (x, y))
    firsts = {part.name: x[:, cut] for part, turn, cut in cuts(purpose) if turn == 0}
    found = {part.name: np.zeros((len(x), len(y)), dtype=bool) for part in purpose.parts}
    for part, _, cut in cuts(purpose):
        mine, theirs, limit = firsts[part.name], y[:, cut], limits[part.name]
        if part.score == "S10":
            met = mine @ theirs.T >= limit * 2**32
        elif part.score == "S6":
            met = ((mine[:, None] - theirs[None]) ** 2).sum(axis=2) <= limit * 2**32
        else:
            norms = [np.sqrt((one**2).sum(axis=1).astype(float)) for one in (mine, theirs)]
            met = (mine @ theirs.T).astype(float) / np.outer(*norms) >= limit
        found[part.name] |= np.asarray(met, dtype=bool)
    combine = np.any if purpose.rule == "any" else np.all
    return np.asarray(combine(list(found.values()), axis=0))


def signs_of(numbers: int) -> np.ndarray:
    """All vectors of so many coordinates +1 and -1."""
    bits = np.arange(1 << numbers)[:, None] >> np.arange(numbers) & 1
    return 2.0 * bits - 1
