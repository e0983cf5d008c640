"""What is checked before a gallery is used: that its tape is for the program, and what is brought to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.foundations.errors import ProtocolViolation, TapeMismatch
from spdz.foundations.types import IntArray
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import GalleryPlan, measure_gallery
from spdz.readings.sections import encode_sections


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
    return encode_sections(terms.sections, array)


def refuse_unproved(terms: Terms, name: str, slots: Sequence[int], proofs: Any) -> None:
    """Refuse vectors of which a norm is not proved.

    Args:
        terms: The gallery's.
        name: The robot whose vectors they are.
        slots: Where they are.
        proofs: For every slot and section whether its norm is an honest one; None where nothing is proved.

    Raises:
        ProtocolViolation: naming robot, slot and section.
    """
    if proofs is None or proofs.all():
        return
    slot, at = (int(number) for number in np.argwhere(~proofs)[0])
    section = terms.sections[at]
    raise ProtocolViolation(
        f"the {section.name} in slot {slots[slot]} of {name} has not a norm between {section.min_norm:g} and "
        f"{section.max_norm:g}: nothing was compared with it"
    )


def pinned_text(plan: GalleryPlan, terms: Terms) -> bytes:
    """What a gallery is pinned to: the fingerprint of what it computes, and the rule in words."""
    return f"{plan.text} {terms.rule}".encode()


def check_rule(pinned: bytes | None, plan: GalleryPlan, terms: Terms) -> None:
    """Refuse another rule than the one that a gallery has answered.

    Raises:
        TapeMismatch: naming both.
    """
    if pinned is not None and pinned.split(b" ", 1)[0] != plan.text.encode():
        raise TapeMismatch(
            f"this gallery answers {pinned_rule(pinned)}, and its masks must never answer another threshold "
            f"or program, such as {terms.rule}: give the same threshold as before, or deal new tapes"
        )


def pinned_rule(pinned: bytes) -> str:
    """The rule in words that a gallery is pinned to."""
    return pinned.decode(errors="replace").partition(" ")[2] or "another program"
