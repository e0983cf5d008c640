"""Authenticated signs and intervals of masked numbers, from the half-tree: XOR shares of bit * Delta.

**Sign.** For a signed number z of b bits, c = z + 2^(b-1) + rho as integers is public and rho is dealt
(:mod:`spdz.gates.masking`). Only c mod 2^b and rho mod 2^b matter; to compare z with a threshold T, take c -
T for c (mod 2^128 will do). With top the bit b - 1 and low the bits below it,

    [z >= 0] = top(c) ^ top(rho) ^ [low(c) < low(rho)],

as z + 2^(b-1) = c - rho mod 2^b has its top bit set if and only if z >= 0, and the last term is the borrow
into it. A tree gives [a < x], so a = NOT low(rho) is dealt and x = NOT low(c) evaluated: [a < x] = [low(c) <
low(rho)]. top(rho) Delta is one more XOR-shared block T_i, ``top``, a random block of party 0's. Party i's
share is S_i = D_i ^ T_i ^ top(c) Delta_i.

**Resolution.** With ``drop`` = f the lowest f bits of c and rho are left out, which saves f levels. The bit
is then

    [z >= -e], e = 2^f - 1 - (c mod 2^f), for -2^(b-1) <= z <= 2^(b-1) - 2^f,

with e public and, as c is, uniform; a threshold that is 2^(f-1) higher centres it. (c >> f) - (rho >> f) is
(z + 2^(b-1) - c mod 2^f) / 2^f rounded up. For a z above that range it can be 2^(b-f), which wraps to 0: the
bit is then 0.

**Interval.** For c = S + rho mod p with rho uniform in F_p and 0 <= lo <= hi < p, S is in [lo, hi] if and
only if rho is on the arc from low = c - hi up to c - lo (mod p). With up = (c - lo mod p) + 1 <= p, as
integers,

    [lo <= S <= hi] = [rho < up] ^ [rho < low] ^ [low >= up]:

one tree of 127 levels with a = rho, evaluated at up and at low. The last term is public; it is 1 where the
arc passes 0. (low = up where it is the whole circle, lo = 0 and hi = p - 1.)

**Cost.** Sign: b - 1 - f levels, and as many blocks at either party (:func:`stored_blocks`). Interval: 127
blocks at party 0, 126 at party 1 (:data:`INTERVAL_BLOCKS`).

**Security.** That of the tree (:mod:`spdz.dcf.half_tree`); party 1's ``top`` is masked by party 0's random
block. c must have been opened and checked before a bit is sent. Only the lowest bit of a share may be sent.
With the bit opened as v, sigma_i = S_i ^ (v Delta_i) must be the same 128 bits at both parties.

Sources: as for the tree; the sign of a masked number from Boyle et al., "Function secret sharing for
mixed-mode and fixed-point secure computation", EUROCRYPT 2021.
"""

from __future__ import annotations

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.arithmetic.prf import Batches
from spdz.dcf.format import Words, check_blocks
from spdz.dcf.half_tree import deal_tree, evaluate_tree
from spdz.foundations.types import Block, FieldArray

INTERVAL_LEVELS = 127
"""Levels of the tree for an interval of F_p."""

INTERVAL_BLOCKS = (INTERVAL_LEVELS, INTERVAL_LEVELS - 1)
"""Blocks of 16 bytes stored for an interval at party 0 (``first``, words) and at party 1 (words)."""


def sign_levels(bits: int, drop: int) -> int:
    """Levels of the tree for the sign of a number of ``bits`` bits without its lowest ``drop``.

    Raises:
        ValueError: if nothing is left below the sign, or a number is too long for F_p.
    """
    if not (0 <= drop < bits - 1 and bits <= 127):
        raise ValueError(f"no sign of {bits} bits without the lowest {drop}: 0 <= drop < bits - 1 <= 126")
    return bits - 1 - drop


def stored_blocks(levels: int) -> tuple[int, int]:
    """Blocks of 16 bytes stored for a sign at party 0 (``first``, words) and at party 1 (words, ``top``)."""
    return levels, levels


def deal_sign(
    rho: FieldArray,
    bits: int,
    drop: int,
    delta0: Block,
    delta1: Block,
    first1: Block,
    top0: Block,
    batches: Batches,
) -> tuple[Block, Block, Block]:
    """Deal n keys.

    Args:
        rho: The secret masks, shape (n, 2).
        bits: b, 2 to 127.
        drop: f, the lowest bits left out: at most b - 2.
        delta0: Party 0's Delta_0, lowest bit 0; broadcast to (n, 2).
        delta1: Party 1's Delta_1, lowest bit 1; broadcast to (n, 2).
        first1: Random blocks of party 1's, shape (n, 2).
        top0: Random blocks of party 0's, shape (n, 2).
        batches: They cover the n keys.

    Returns:
        ``first`` of party 0, shape (n, 2); the words of both, shape (n, b - 2 - f, 2); ``top`` of party 1,
        shape (n, 2).

    Raises:
        ValueError: for shapes or widths that do not fit, a lowest bit of Delta_i that is not i.
    """
    levels = sign_levels(bits, drop)
    check_blocks("rho", rho, (len(rho),))
    check_blocks("top0", top0, (len(rho),))
    first0, words = deal_tree(_cut(~rho, drop, levels), levels, delta0, delta1, first1, batches)
    top1 = top0 ^ (_mask(rho, bits - 1) & (delta0 ^ delta1))
    return first0, words, top1


def evaluate_sign(
    c: Block,
    bits: int,
    drop: int,
    delta: Block,
    first: Block,
    words: Block,
    top: Block,
    batches: Batches,
) -> Block:
    """Shares of [z >= 0] Delta (of [z >= -e] Delta if bits are dropped).

    Args:
        c: Public, z + 2^(bits-1) + rho mod 2^bits; higher bits are not looked at. Shape (n, 2).
        bits: As it was dealt.
        drop: As it was dealt.
        delta: The party's Delta_i, broadcast to (n, 2).
        first: The party's, shape (n, 2).
        words: Shape (n, bits - 2 - drop, 2).
        top: The party's, shape (n, 2).
        batches: They cover the n keys.

    Returns:
        S_i, shape (n, 2).

    Raises:
        ValueError: for shapes or widths that do not fit.
    """
    levels = sign_levels(bits, drop)
    check_blocks("c", c, (len(first),))
    check_blocks("top", top, (len(first),))
    result = evaluate_tree(delta, first, words, _cut(~c, drop, levels), levels, batches)
    result ^= top
    result ^= _mask(c, bits - 1) & delta
    return result


def deal_interval(
    rho: FieldArray, delta0: Block, delta1: Block, first1: Block, batches: Batches
) -> tuple[Block, Block]:
    """Deal n keys for any interval: ``rho`` below p; the rest as in :func:`spdz.dcf.half_tree.deal_tree`."""
    return deal_tree(rho, INTERVAL_LEVELS, delta0, delta1, first1, batches)


def evaluate_interval(
    c: FieldArray, lo: int, hi: int, delta: Block, first: Block, words: Block, batches: Batches
) -> Block:
    """Shares of [lo <= S <= hi] Delta.

    Args:
        c: Public, S + rho mod p, shape (n, 2).
        lo: The least number inside.
        hi: The greatest.
        delta: The party's Delta_i, broadcast to (n, 2).
        first: The party's, shape (n, 2).
        words: Shape (n, 126, 2).
        batches: They cover the n keys.

    Returns:
        I_i, shape (n, 2).

    Raises:
        ValueError: for shapes that do not fit, or unless 0 <= lo <= hi < p.
    """
    if not 0 <= lo <= hi < P:
        raise ValueError(f"an interval needs 0 <= lo <= hi < p, not {lo} and {hi}")
    check_blocks("c", c, (len(first),))
    up = field.sub(c, field.from_int(lo))
    up[:, 0] += np.uint64(1)
    up[:, 1] += up[:, 0] == 0  # at most p in all, so this word stays below 2^63
    low = field.sub(c, field.from_int(hi))
    below_up = (low[:, 1] < up[:, 1]) | ((low[:, 1] == up[:, 1]) & (low[:, 0] < up[:, 0]))
    points = np.stack([up, low], axis=1)
    of_up, of_low = evaluate_tree(delta, first, words, points, INTERVAL_LEVELS, batches).swapaxes(0, 1)
    inside: Block = of_up ^ of_low ^ np.where(below_up[:, None], np.uint64(0), delta)
    return inside


def _cut(numbers: Block, drop: int, count: int) -> Block:
    """``count`` bits of 128-bit numbers from bit ``drop`` on."""
    moved = np.zeros(numbers.shape, dtype=np.uint64)
    skipped, offset = divmod(drop, 64)
    np.right_shift(numbers[..., skipped:], np.uint64(offset), out=moved[..., : 2 - skipped])
    if skipped == 0 and offset:
        moved[..., 0] |= numbers[..., 1] << np.uint64(64 - offset)
    moved &= np.array([(1 << min(64, max(0, count - first))) - 1 for first in (0, 64)], dtype=np.uint64)
    return moved


def _mask(numbers: Block, bit: int) -> Words:
    """All ones where a bit of the numbers (n, 2) is 1, else zeros: shape (n, 1)."""
    word, offset = divmod(bit, 64)
    masks: Words = numbers[:, word, None] >> np.uint64(offset) & np.uint64(1)
    return np.negative(masks, out=masks)
