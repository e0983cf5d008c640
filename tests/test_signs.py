"""Authenticated signs and intervals: exhaustive for small numbers, and at the edges of wide ones."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from half_tree_helpers import Pads, cut, words

from spdz.arithmetic.field import P
from spdz.dcf.signs import (
    INTERVAL_BLOCKS,
    deal_interval,
    deal_sign,
    evaluate_interval,
    evaluate_sign,
    sign_levels,
    stored_blocks,
)
from spdz.foundations.types import Block


def sign_shares(pads: Pads, rho: list[int], c: list[int], bits: int, drop: int) -> list[Block]:
    batches = cut(len(rho), 5, 64)
    first0, corrections, top1 = deal_sign(
        words(rho), bits, drop, *pads.delta, pads.first1, pads.top0, batches
    )
    levels = sign_levels(bits, drop)
    assert stored_blocks(levels) == (1 + corrections.shape[1], corrections.shape[1] + 1)
    parts = zip(pads.delta, (first0, pads.first1), (pads.top0, top1), strict=True)
    return [
        evaluate_sign(words(c), bits, drop, delta, first, corrections, top, batches)
        for delta, first, top in parts
    ]


def bit(z: int, c: int, bits: int, drop: int) -> bool:
    """[z >= -e] with e from the dropped bits of c; above the range the top wraps and the bit is 0."""
    dropped, excess = c % (1 << drop), z - ((1 << (bits - 1)) - (1 << drop))
    return z >= dropped - ((1 << drop) - 1) and dropped >= excess


@pytest.mark.parametrize(("bits", "drop"), [(b, f) for b in range(2, 7) for f in range(b - 1)])
def test_all_numbers_under_all_masks(bits, drop):
    half = 1 << (bits - 1)
    cases = list(product(range(-half, half), range(2 * half)))
    # Bits of the mask above those of z play no part.
    rho = [mask | (i * i % 97) << bits for i, (_, mask) in enumerate(cases)]
    c = [z + half + mask for (z, _), mask in zip(cases, rho, strict=True)]
    pads = Pads(len(cases), seed=drop)
    expected = [bit(z, c, bits, drop) for (z, _), c in zip(cases, c, strict=True)]
    if drop == 0:
        assert expected == [z >= 0 for z, _ in cases]
    pads.check(sign_shares(pads, rho, c, bits, drop), expected)


@pytest.mark.parametrize("drop", [0, 1, 2])
def test_thresholds_are_taken_off_c(drop):
    """For all z and T of 4 bits z - T has 5; c - T is negative for some, as a 128-bit number."""
    bits, half = 5 + (drop > 0), 1 << (4 + (drop > 0))
    cases = list(product(range(-8, 8), range(-8, 8), range(0, 2 * half, 3)))
    pads = Pads(len(cases))
    c = [z - t + half + mask for z, t, mask in cases]
    c = [number - (1 << bits) * (i % 3) for i, number in enumerate(c)]
    assert min(c) < 0
    both = sign_shares(pads, [mask for *_, mask in cases], c, bits, drop)
    e = [(1 << drop) - 1 - number % (1 << drop) for number in c]
    pads.check(both, [z >= t - e for (z, t, _), e in zip(cases, e, strict=True)])


@pytest.mark.parametrize(
    ("bits", "drop"),
    [
        *[(2, 0), (17, 0), (34, 16), (63, 3), (64, 0), (65, 0), (65, 1), (66, 63), (66, 64)],
        *[(127, 0), (127, 62), (127, 63), (127, 64), (127, 65), (127, 125)],
    ],
)
def test_edges_of_wide_numbers(bits, drop):
    half, step = 1 << (bits - 1), 1 << drop
    least, greatest = -half, half - step
    values = {least, least + 1, -step - 1, -step, 1 - step, -2, -1, 0, 1, step, greatest - 1, greatest}
    masks = {0, 1, step - 1, step, half - 1, half, 2 * half - 1, P - 1, P // 3, P // 5 * 2}
    # c does not wrap in F_p: that is what a mask is picked for.
    cases = [
        (z, mask) for z, mask in product(values, masks) if least <= z <= greatest and 0 <= z + half + mask < P
    ]
    pads = Pads(len(cases))
    c = [z + half + mask for z, mask in cases]
    both = sign_shares(pads, [mask for _, mask in cases], c, bits, drop)
    pads.check(both, [bit(z, c, bits, drop) for (z, _), c in zip(cases, c, strict=True)])


@pytest.mark.parametrize(("bits", "drop"), [(1, 0), (128, 0), (5, 4), (5, -1), (2, 1)])
def test_signs_without_a_tree_are_refused(bits, drop):
    with pytest.raises(ValueError, match="no sign of"):
        sign_levels(bits, drop)


@pytest.mark.parametrize("p", [2, 3, 5, 7, 11, 13])
def test_interval_rule_in_small_fields(p):
    """The rule of the docstring on integers: all intervals, all masks, all numbers."""
    for lo, hi, s, rho in product(range(p), repeat=4):
        c = (s + rho) % p
        up, low = (c - lo) % p + 1, (c - hi) % p
        if lo <= hi:
            assert (rho < up) ^ (rho < low) ^ (low >= up) == (lo <= s <= hi)


@pytest.mark.parametrize(
    ("lo", "hi"),
    [
        (0, 0),
        (0, P - 1),
        (1, P - 1),
        (P - 1, P - 1),
        (0, P - 2),
        (5, 5),
        ((1 << 64) - 1, 1 << 64),
        (1 << 31, 1 << 33),
        ((1 << 63) + 1, (1 << 126) + 3),
    ],
)
def test_intervals_of_the_field(lo, hi):
    numbers = {0, 1, lo - 1, lo, lo + 1, hi - 1, hi, hi + 1, P - 1, P // 2}
    masks = {0, 1, lo, P - lo, P - lo - 1, P - hi, P - hi - 1, P - 1, P - 2, 1 << 64, (1 << 64) - 1, P // 7}
    cases = list(product(sorted(n % P for n in numbers), sorted(mask % P for mask in masks)))
    pads, batches = Pads(len(cases)), cut(len(cases), 50)
    rho, c = words([rho for _, rho in cases]), words([(s + rho) % P for s, rho in cases])
    first0, corrections = deal_interval(rho, *pads.delta, pads.first1, batches)
    assert INTERVAL_BLOCKS == (1 + corrections.shape[1], corrections.shape[1])
    both = [
        evaluate_interval(c, lo, hi, delta, first, corrections, batches)
        for delta, first in zip(pads.delta, (first0, pads.first1), strict=True)
    ]
    pads.check(both, [lo <= s <= hi for s, _ in cases])


def test_intervals_with_one_delta_for_all():
    pads, batches = Pads(4), cut(4, 4)
    pads.delta = tuple(np.broadcast_to(delta[:1], (4, 2)) for delta in pads.delta)
    rho, s = [0, 7, P - 1, P - 5], [3, 4, 10, 11]
    c = words([(x + y) % P for x, y in zip(rho, s, strict=True)])
    first0, corrections = deal_interval(words(rho), *pads.delta, pads.first1, batches)
    both = [
        evaluate_interval(c, 4, 10, delta[0], first, corrections, batches)
        for delta, first in zip(pads.delta, (first0, pads.first1), strict=True)
    ]
    pads.check(both, [False, True, True, False])


@pytest.mark.parametrize(("lo", "hi"), [(-1, 3), (4, 3), (0, P)])
def test_intervals_that_are_none_are_refused(lo, hi):
    with pytest.raises(ValueError, match="0 <= lo <= hi < p"):
        evaluate_interval(words([0]), lo, hi, *[words([0])] * 2, np.empty((1, 126, 2), np.uint64), [])
