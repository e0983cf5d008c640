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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz import dcf, field, inner_product
from spdz.bound import Bound
from spdz.engine import ClearText, Evaluation, Gate, Recipe
from spdz.field import P
from spdz.gates.masking import integer_mask, local_bits
from spdz.gates.truncation import low_bits
from spdz.types import FieldArray, Shape
from spdz.value import Value

HALF = (P + 1) // 2
"""The inverse of 2 in F_p."""

KIND = "comparison"


@dataclass(frozen=True, slots=True)
class Function:
    """One piecewise linear function, in raw integers.

    Attributes:
        constant: a_0.
        slope: b_0.
        constants: a_1 .. a_k, the jumps of the constant.
        slopes: b_1 .. b_k, the jumps of the slope.
        frac: Fractional bits of the result.
        entry: Largest magnitude of an honest result.
        is_bit: Whether it is 0 or 1.
    """

    constant: int
    slope: int
    constants: tuple[int, ...]
    slopes: tuple[int, ...]
    frac: int
    entry: int
    is_bit: bool = False


@dataclass(frozen=True)
class Piecewise(Gate):
    """Operand: one masked value. The result is one value a function."""

    thresholds: tuple[int, ...]
    functions: tuple[Function, ...]
    bound: int
    """What z - T_i never exceeds."""

    @property
    def _width(self) -> int:
        """Payload elements: with r if any slope jumps."""
        return 2 if any(any(f.slopes) for f in self.functions) else 1

    def deal(self, recipe: Recipe, z: Value) -> list[Value]:
        """Deal sigma/2 (and sigma r/2) and the key."""
        bits, shape, width = local_bits(z, self.bound), z.shape, self._width

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
            shape, bits - 1, width, lambda: (low_bits(integer_mask(z.parts[0], bits), bits - 1), signs())
        )
        return [
            recipe.shared_value(
                f"{KIND} of {bits} bits {self.thresholds} {f}", (z,), shape, *_form(f, shape), is_bit=f.is_bit
            )
            for f in self.functions
        ]

    def evaluate(self, party: Evaluation, z: Value) -> list[Value]:
        """Steps 1 to 3."""
        bits, shape, width = local_bits(z, self.bound), z.shape, self._width
        half = party.authenticated((*shape, width), count=(KIND, prod(shape)))
        roots, key = party.comparison_key(shape, bits - 1, width)
        eps, parts = z.parts[0], len(z.parts) - 1
        n, k = prod(shape), len(self.thresholds)
        points = _minus(eps.reshape(n, 1, 2), _words(self.thresholds))
        outputs = dcf.evaluate(party.index, roots, key, low_bits(points, bits - 1), bits - 1, parts * width)
        halves = np.stack([h for h in half[:parts] if h is not None], axis=-3).reshape(n, 1, parts * width, 2)
        signed = _signed(_top_bit(points, bits)[..., None], field.sub(outputs, halves))
        del outputs
        sums = _Sums(signed.reshape(n, k, parts, width, 2), shape)
        return [self._value(party, z, f, sums) for f in self.functions]

    def _value(self, party: Evaluation, z: Value, f: Function, sums: _Sums) -> Value:
        """Step 3 for one function."""
        eps = z.parts[0]
        jumps, slopes = any(f.constants), any(f.slopes)
        # A jump counts half in public: [z >= T] = 1/2 + ..
        constant = f.constant + sum(f.constants) * HALF
        slope = (f.slope + sum(f.slopes) * HALF) % P
        shares: list[FieldArray] = []
        for j, r in enumerate(z.parts[1:]):
            terms = []
            if slope and r is not None:
                terms.append(field.scale(r, slope))
            if jumps:
                terms.append(sums.of(f.constants, j, 0))
            if slopes:
                terms.append(field.mul(eps, sums.of(f.slopes, j, 0)))
                terms.append(sums.of(f.slopes, j, 1))
            total = terms[0] if terms else field.zeros(z.shape)
            for term in terms[1:]:
                total = field.add(total, term)
            shares.append(total)
        frac, bound = _form(f, z.shape)
        result = Value(party, tuple(shares), z.shape, frac, bound, is_bit=f.is_bit)
        if not constant and not slope:
            return result
        public = np.broadcast_to(field.from_int(constant), eps.shape)
        return party.plus_public(result, field.add(public, field.scale(eps, slope)) if slope else public)

    def clear(self, engine: ClearText, z: Value) -> list[Value]:
        """Look up the piece."""
        raw = np.asarray(z.parts[0])
        piece = np.searchsorted(np.array(self.thresholds, dtype=object), raw.astype(object), side="right")
        results = []
        for f in self.functions:
            constants, slopes = _pieces(f)
            exact = constants[piece] + slopes[piece] * raw.astype(object)
            results.append(engine.value(exact, *_form(f, z.shape), is_bit=f.is_bit))
        return results


class _Sums:
    """Public linear combinations over the thresholds of what the key gave."""

    def __init__(self, signed: FieldArray, shape: Shape) -> None:
        self._signed, self._shape = signed, shape

    def of(self, weights: tuple[int, ...], part: int, payload: int) -> FieldArray:
        """``sum_i weights_i signed_i`` for one part (value or MAC) and one payload."""
        column = self._signed[:, :, part, payload]
        if len(weights) == 1:
            return field.scale(column[:, 0], weights[0]).reshape((*self._shape, 2))
        return inner_product.dot(column, _limbs(weights)).reshape((*self._shape, 2))


def _form(f: Function, shape: Shape) -> tuple[int, Bound]:
    return f.frac, Bound.of_entry(f.entry, shape)


@lru_cache(maxsize=256)
def _limbs(weights: tuple[int, ...]) -> Any:
    return inner_product.limbs(field.from_ints(weights))


@lru_cache(maxsize=64)
def _words(numbers: tuple[int, ...]) -> npt.NDArray[np.uint64]:
    """Integers of either sign as two's complement of 128 bits, shape (k, 2)."""
    packed = b"".join((number % (1 << 128)).to_bytes(16, "little") for number in numbers)
    return np.frombuffer(packed, dtype="<u8").reshape(-1, 2)


@lru_cache(maxsize=64)
def _pieces(f: Function) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Constant and slope of every piece."""
    constants = np.array([f.constant, *f.constants], dtype=object).cumsum()
    slopes = np.array([f.slope, *f.slopes], dtype=object).cumsum()
    return constants, slopes


def _minus(a: FieldArray, b: FieldArray) -> FieldArray:
    """``a - b`` mod 2^128, on words."""
    result = np.asarray(a - b)
    result[..., 1] -= a[..., 0] < b[..., 0]
    return result


def _top_bit(words: FieldArray, bits: int) -> npt.NDArray[np.bool_]:
    """Bit ``bits - 1`` of each element, as booleans."""
    word, offset = divmod(bits - 1, 64)
    return np.asarray(words[..., word] >> np.uint64(offset) & np.uint64(1), dtype=np.bool_)


def _signed(negative: npt.NDArray[np.bool_], a: FieldArray) -> FieldArray:
    """``-a`` where ``negative``, else ``a``."""
    return np.where(negative[..., None], field.neg(a), a)


def piecewise(
    z: Value, thresholds: Sequence[int], *functions: Function, bound: int | None = None
) -> list[Value]:
    """Evaluate piecewise linear functions of a masked value; local.

    Args:
        z: Masked value of any shape.
        thresholds: Ascending raw integers, at least one.
        functions: The functions, all on these thresholds.
        bound: A public bound on |z - T| in raw units, where the caller knows one that is tighter than
            what follows from ``z.bound``.

    Returns:
        One shared value a function, of z's shape.
    """
    largest = max(abs(thresholds[0]), abs(thresholds[-1]))
    gate = Piecewise(tuple(thresholds), functions, z.bound.entry + largest if bound is None else bound)
    result: list[Value] = z.engine.read(gate, z)
    return result
