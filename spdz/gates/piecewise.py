"""Piecewise linear functions of a masked value: comparison, absolute value, segment tables, all local.

For public thresholds T_1 < .. < T_k a function is ``f(z) = a_0 + b_0 z + sum_i [z >= T_i] (a_i + b_i z)``.
With ``c = z + 2^(b-1) + rho`` (:mod:`spdz.gates.masking`) and ``c_i = c - T_i mod 2^b``:

1. z - T_i is a signed b-bit number, whose sign is ``top(c_i) xor top(rho) xor [low(c_i) < low(rho)]``, where
   top is bit b - 1 and low the rest. So one DCF key with threshold low(rho), evaluated at every low(c_i),
   serves all thresholds. Its payload is ``sigma = 1 - 2 top(rho)`` and, where there are slopes, ``sigma r``.
2. With ``s_i = 1 - 2 top(c_i)`` and B_i, R_i the key's outputs, ``[z >= T_i] = 1/2 + s_i (B_i - sigma/2)``
   and ``[z >= T_i] r = r/2 + s_i (R_i - sigma r/2)``; sigma/2 and sigma r/2 are dealt.
3. ``[z >= T_i] (a_i + b_i z)`` with ``z = c + r`` (c public) is linear in these two.

Cost: no round. A DCF key of b - 1 levels an entry of z, whatever the number of thresholds and of functions.
Sources: Boyle, Gilboa, Ishai, "Secure computation with preprocessing via function secret sharing", TCC 2019;
Boyle et al., EUROCRYPT 2021; one key at many public points as in Storrier et al., "Grotto: screaming fast
(2+1)-PC or Z_2^n via (2,2)-DPFs", CCS 2023. Secure against malicious parties: the payload carries its MAC,
and a wrong evaluation is an additive error that the check catches. For z out of range (which only a cheating
peer can cause) the result is some function of z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from math import prod

import numpy as np
import numpy.typing as npt

from spdz.arithmetic import field
from spdz.arithmetic.bits import low_bits
from spdz.arithmetic.unreduced import weigh, words
from spdz.dcf import Keys
from spdz.foundations.types import FieldArray, IntArray
from spdz.gates.masking import dealt_integer_mask, in_place, integer_mask
from spdz.gates.pieces import HALF, Pieces
from spdz.values.engine import ClearText, Evaluation, Gate, Recipe
from spdz.values.value import Value

KIND = "comparison"


@dataclass(frozen=True, slots=True)
class Piecewise(Gate):
    """Operand: one masked value. The result is one value a function."""

    pieces: Pieces

    def _in_place(self, z: Value) -> tuple[Value, int]:
        """For z - T_i of either sign."""
        return in_place(z, z.bound.entry + self.pieces.farthest)

    def deal(self, recipe: Recipe, z: Value) -> list[Value]:
        """Deal sigma/2 (and sigma r/2) and the key."""
        (z, bits), shape, width = self._in_place(z), z.shape, self.pieces.width

        def signs() -> FieldArray:
            """Sigma, sigma r: shape S + (width, 2)."""
            r = z.parts[0]
            one = np.broadcast_to(field.from_int(1), r.shape)
            both = np.stack([one, r][:width], axis=-2)
            return _signed(_top_bit(integer_mask(r, bits), bits)[..., None], both)

        recipe.authenticated(
            (*shape, width), lambda: field.scale(signs(), HALF), of=(z,), count=(KIND, prod(shape))
        )
        recipe.comparison_key(
            shape,
            bits - 1,
            width,
            lambda: (low_bits(dealt_integer_mask(z.parts[0], bits), bits - 1), signs()),
        )
        kind = f"{KIND} of {bits} bits {self.pieces}"
        return [
            recipe.shared_value(f"{kind} {i}", (z,), shape, *f.form(shape), is_bit=f.is_bit)
            for i, f in enumerate(self.pieces.functions)
        ]

    def evaluate(self, party: Evaluation, z: Value) -> list[Value]:
        """Steps 1 to 3."""
        pieces, (z, bits), shape = self.pieces, self._in_place(z), z.shape
        width = pieces.width
        half = party.authenticated((*shape, width), count=(KIND, prod(shape)))
        keys = party.comparison_key(shape, bits - 1, width)
        shares = len(z.parts) - 1
        halves = party.ring.call(_columns, None, width, *half[:shares])
        sums_shape = (len(pieces.jumps), shares, width, *shape)
        sums = party.ring.unreduced(_sums, sums_shape, pieces, bits, z.parts[0], keys, halves)
        return [self._value(party, z, i, sums) for i in range(len(pieces.functions))]

    def _value(self, party: Evaluation, z: Value, i: int, sums: FieldArray) -> Value:
        """Step 3 for one function."""
        f, (jump, slope_jump), (constant, slope) = (
            self.pieces.functions[i],
            self.pieces.rows[i],
            self.pieces.public[i],
        )
        ring, eps, totals = party.ring, z.parts[0], []

        def part(*key: int) -> FieldArray:
            chosen: FieldArray = ring.index(sums, (*key, ...))
            return chosen

        for j, r in enumerate(z.parts[1:]):
            terms = [] if r is None or not slope else [ring.scale(r, slope)]
            if jump is not None:
                terms.append(part(jump, j, 0))
            if slope_jump is not None:
                terms += [ring.product(eps, part(slope_jump, j, 0)), part(slope_jump, j, 1)]
            totals.append(reduce(ring.add, terms) if terms else ring.zeros(z.shape))
        result = Value(party, tuple(totals), z.shape, *f.form(z.shape), is_bit=f.is_bit)
        if slope:
            result = party.plus_public(result, ring.scale(eps, slope))
        return party.plus_public(result, ring.constant(constant)) if constant else result

    def clear(self, engine: ClearText, z: Value) -> list[Value]:
        """Look up the piece."""
        raw = np.asarray(z.parts[0]).astype(object)
        thresholds, functions = self.pieces.clear
        piece = np.searchsorted(thresholds, raw, side="right")
        return [
            engine.value(constants[piece] + slopes[piece] * raw, *f.form(z.shape), is_bit=f.is_bit)
            for f, (constants, slopes) in zip(self.pieces.functions, functions, strict=True)
        ]


def _columns(width: int, *halves: FieldArray) -> IntArray:
    """Shares of sigma/2 (and sigma r/2) as words, shape (shares width, n, 1, 4)."""
    columns = [words(share.reshape(-1, width, 2)).swapaxes(0, 1) for share in halves]
    return np.concatenate(columns)[:, :, np.newaxis]


def _sums(pieces: Pieces, bits: int, eps: FieldArray, keys: Keys, halves: IntArray) -> IntArray:
    """Steps 1 and 2: the weighted sums over the thresholds, as words (jumps, columns, n, 4)."""
    points = _minus(eps.reshape(-1, 1, 2), pieces.words, bits)
    return weigh(pieces.weights, _signs(points, bits), keys.sums(points), halves, keys.sum_bits)


def _minus(a: FieldArray, b: FieldArray, bits: int) -> FieldArray:
    """``a - b`` mod 2^64 for up to 64 bits, one word, else mod 2^128."""
    if bits <= 64:
        return np.asarray(a[..., :1] - b[..., :1])
    result = np.asarray(a - b)
    result[..., 1] -= a[..., 0] < b[..., 0]
    return result


def _signs(numbers: FieldArray, bits: int) -> IntArray:
    """-1 where bit ``bits - 1`` is set, else 1."""
    word, offset = divmod(bits - 1, 64)
    on_top = numbers[..., word] << np.uint64(63 - offset)
    signs: IntArray = on_top.view(np.int64) >> np.int64(63)
    signs |= np.int64(1)
    return signs


def _top_bit(words: FieldArray, bits: int) -> npt.NDArray[np.bool_]:
    """Bit ``bits - 1`` of each element, as booleans."""
    word, offset = divmod(bits - 1, 64)
    return np.asarray(words[..., word] >> np.uint64(offset) & np.uint64(1), dtype=np.bool_)


def _signed(negative: npt.NDArray[np.bool_], a: FieldArray) -> FieldArray:
    """``-a`` where ``negative``, else ``a``."""
    return np.where(negative[..., None], field.neg(a), a)


def piecewise(z: Value, pieces: Pieces) -> list[Value]:
    """Evaluate piecewise linear functions of a masked value; local.

    Args:
        z: Masked value of any shape.
        pieces: The functions.

    Returns:
        One shared value a function, of z's shape.
    """
    result: list[Value] = z.engine.read(Piecewise(pieces), z)
    return result
