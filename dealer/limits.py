"""What is refused before anything is dealt: jobs too large for a frame, or for this machine."""

from __future__ import annotations

from protocols.memory import require_memory
from spdz.channels.frames import MAX_FRAME
from spdz.readings.meter import Plan
from spdz.rounds.wire import ELEMENT_BYTES

_FIXED_MEMORY = 16 << 20  # the chunks in which keys are made
_PAD_MEMORY = 6.5  # times both pads: expanded, reduced, split into limbs for their products
_CORRECTION_MEMORY = 2.0  # times both corrections: made, joined, and one copy sealed


def dealing_memory(plan: Plan) -> int:
    """Memory that dealing one job takes beside the interpreter's own, in bytes, an estimate from above.

    The factors were measured on NumPy 2 (peak resident memory, all scores); a test keeps the estimate between
    the truth and three times the truth. Jobs are dealt one after the other, so their number does not matter.
    """
    pads, corrections = sum(plan.pad_bytes), sum(plan.correction_bytes)
    return _FIXED_MEMORY + int(_PAD_MEMORY * pads + _CORRECTION_MEMORY * corrections)


def check_job(plan: Plan) -> None:
    """Refuse a job that could not be sent or dealt.

    Raises:
        ValueError: saying what it needs, what there is, and what to do.
    """
    if (largest := ELEMENT_BYTES * max(plan.elements_sent)) > MAX_FRAME:
        raise ValueError(
            f"one job could need frames of {largest >> 20} MB, above the limit of {MAX_FRAME >> 20} MB: deal "
            "for smaller tiles"
        )
    require_memory(dealing_memory(plan), "dealing one job")
