"""What of a gallery is refused before anything is dealt, and the memory that it takes."""

from __future__ import annotations

from math import prod

from dealer.gallery import SLOTS_TOGETHER, TILES_BYTES
from protocols.memory import in_bytes, require_memory
from spdz.gallery.format import MAX_PAIR_BYTES, MAX_SLOT_BYTES, GalleryHeader
from spdz.readings.gallery import Terms, fill
from spdz.readings.gallery_plan import GalleryPlan
from spdz.readings.meter import Meter
from spdz.rounds.coroutine import run_silently
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.session.comparing import CELL_BYTES
from spdz.session.strips import STRIP_PAIRS
from spdz.values.engine import Input

_FIXED_MEMORY = 32 << 20  # chunks in which keys are made, and buffers
_PAD_MEMORY = 6.5  # times both pads: expanded, reduced, split into limbs for their products
_CORRECTION_MEMORY = 3.0  # times both corrections: made, joined, and one copy sealed
_OPERAND_MEMORY = 300  # bytes an element of what was prepared and is multiplied: limbs in floats
_WORD = 8


def check_plan(plan: GalleryPlan) -> None:
    """Refuse what no gallery's tape holds.

    Raises:
        ValueError: saying what to do instead.
    """
    pair, slot = max(plan.pair.correction_bytes), max(max(one.correction_bytes) for one in plan.slots)
    if pair > MAX_PAIR_BYTES or slot > MAX_SLOT_BYTES:
        raise ValueError(
            f"a pair of descriptors would take {in_bytes(pair)} of tape and a descriptor {in_bytes(slot)}; a "
            f"gallery holds at most {in_bytes(MAX_PAIR_BYTES)} and {in_bytes(MAX_SLOT_BYTES)}: deal for "
            "shorter descriptors, a smaller max_norm, or another score (docs/scores.md)"
        )


def check_memory(terms: Terms, header: GalleryHeader) -> None:
    """Refuse a gallery that this machine cannot deal.

    Raises:
        ValueError: naming the need, and what is there.
    """
    require_memory(gallery_memory(terms, header)[0], "dealing this gallery", "deal fewer slots")


def gallery_memory(terms: Terms, header: GalleryHeader) -> tuple[int, int]:
    """Memory to deal a gallery, and what a robot needs to match with all slots filled.

    In bytes beside the interpreter's own, estimates from above; the factors were measured on NumPy 2.
    """
    masked, every = _prepared(terms)
    slots, (rows, columns) = sum(header.capacity), header.bands.sizes
    tile = max(1, rows * columns * header.pair_correction)
    width = min(header.capacity[1], columns * max(1, TILES_BYTES // tile))  # of what is dealt at a time
    some, pairs = min(SLOTS_TOGETHER, max(header.capacity)), rows * width
    pads = max(some * max(header.slot_pad), pairs * header.pair_pad)
    corrections = max(some * max(header.slot_correction), pairs * header.pair_correction)
    kept = slots * (_WORD * terms.dim + ELEMENT_BYTES * masked)
    work = 2 * (_PAD_MEMORY * pads + _CORRECTION_MEMORY * corrections) + _OPERAND_MEMORY * width * masked
    dealing = _FIXED_MEMORY + 2 * kept + int(work)
    # Words and MAC shares of every slot, masks of the own ones; three parts of what was prepared.
    shelf = slots * (_WORD * terms.dim + 3 * ELEMENT_BYTES * every)
    shelf += max(header.capacity) * _WORD * terms.dim
    if terms.security == "malicious":
        shelf += slots * ELEMENT_BYTES * terms.dim
    matching = int(pairs_together(header) * (3 * header.pair_correction + _PAD_MEMORY * header.pair_pad))
    return dealing, _FIXED_MEMORY + shelf + matching


def pairs_together(header: GalleryHeader) -> int:
    """Most pairs that robots compare at a time, unless a row or a column has more."""
    most = max(1, min(STRIP_PAIRS, CELL_BYTES // max(1, header.pair_correction)))
    return min(header.capacity[0] * header.capacity[1], most)


def _prepared(terms: Terms) -> tuple[int, int]:
    """Elements that are prepared of a descriptor: masked ones, and all."""
    meter = Meter(terms.security, (1,))
    meter.resolution, meter.slot_bits = terms.resolution, terms.word_bits
    vectors = meter.input_mask(Input(0, (1, terms.dim), terms.norm))
    derived, _ = run_silently(fill(meter, terms, vectors))
    values = [one.value for one in derived]
    return sum(prod(v.shape) for v in values if v.masked), sum(prod(v.shape) for v in values)
