"""What is checked before a gallery is used: that its tape is for the program, and what is brought to it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.fixed_point import encode
from spdz.foundations.errors import TapeMismatch
from spdz.foundations.types import IntArray
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import GalleryPlan, measure_gallery


def checked_plan(tape: GalleryTape, terms: Terms) -> GalleryPlan:
    """The meter's plan of the terms, held against the tape.

    Raises:
        TapeMismatch: if the tape was dealt for something else.
    """
    plan = measure_gallery(terms)
    if plan.recipe != tape.header.fingerprint or terms.security != tape.header.security:
        raise TapeMismatch("this gallery was dealt for another program: run the one that it was dealt for")
    return plan


def quantised(terms: Terms, descriptors: npt.ArrayLike) -> IntArray:
    """Check and quantise descriptors of shape (n, N).

    Raises:
        ValueError: for descriptors that do not suit the gallery.
    """
    array = np.asarray(descriptors)
    if array.ndim != 2 or array.shape[1] != terms.dim:
        raise ValueError(f"descriptors are an array of shape (n, {terms.dim}), not {array.shape}")
    if not len(array):
        return np.empty((0, terms.dim), dtype=np.int64)
    return encode(array, max_norm=terms.program.max_norm, min_norm=terms.min_norm)
