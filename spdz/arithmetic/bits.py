"""Elements as integers: their bits, shifts and ranges."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spdz.foundations.types import FieldArray


def is_below(numbers: FieldArray, bits: int) -> npt.NDArray[np.bool_]:
    """Which elements are below ``2^bits``."""
    word, offset = divmod(bits, 64)
    above = numbers[..., word] >> np.uint64(offset)
    if word == 0:
        above = above | numbers[..., 1]
    return np.asarray(above == 0)


def shifted(a: FieldArray, by: int) -> FieldArray:
    """``a >> by``."""
    words, bits = divmod(by, 64)
    result = np.zeros(a.shape, dtype=np.uint64)
    low, high = a[..., 0], a[..., 1]
    if words:
        np.right_shift(high, np.uint64(bits), out=result[..., 0])
        return result
    if bits == 0:
        return a
    np.right_shift(low, np.uint64(bits), out=result[..., 0])
    result[..., 0] |= high << np.uint64(64 - bits)
    np.right_shift(high, np.uint64(bits), out=result[..., 1])
    return result


def low_bits(a: FieldArray, bits: int) -> FieldArray:
    """The lowest ``bits`` bits."""
    masks = [(1 << min(64, max(0, bits - 64 * word))) - 1 for word in (0, 1)]
    return a & np.array(masks, dtype=np.uint64)
