"""What a gallery will deal, draw and send: its terms read by the meter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from spdz.readings.gallery import Filled, Terms, compare, fill
from spdz.readings.meter import Meter
from spdz.readings.symbols import Symbol, digest
from spdz.rounds.coroutine import run_silently
from spdz.values.engine import Input


@dataclass(frozen=True, slots=True)
class RecordPlan:
    """What one slot or one pair takes.

    Attributes:
        pad_bytes: Pseudo-random bytes that each party draws.
        correction_bytes: Stored bytes that each party draws.
        elements_sent: Field elements that each party sends.
        rounds: Exchanges, MAC checks included, of any number of slots or pairs together.
        openings: Rounds among them that open field elements.
        bits_sent: Bits that each party sends.
        repeatable: Whether it may be run again after a break (:attr:`spdz.readings.meter.Meter.repeatable`).
    """

    pad_bytes: tuple[int, int]
    correction_bytes: tuple[int, int]
    elements_sent: tuple[int, int]
    rounds: int
    openings: int
    bits_sent: int
    repeatable: bool


@dataclass(frozen=True, slots=True)
class GalleryPlan:
    """What the meter saw.

    Attributes:
        slots: A slot of party 0, a slot of party 1.
        pair: A pair.
        bits: Whether the results are bits.
        recipe: Hex fingerprint of what must be dealt.
        text: Hex fingerprint of the program with its public constants.
    """

    slots: tuple[RecordPlan, RecordPlan]
    pair: RecordPlan
    bits: bool
    recipe: str
    text: str


def measure_gallery(terms: Terms) -> GalleryPlan:
    """Read the terms with the meter.

    Raises:
        ValueError: if something is dealt that belongs to no one slot or pair, or if what belongs to one
            depends on how many are read at a time.
    """
    plan, single = _measure(terms, 2, 3), _measure(terms, 1, 1)
    if (plan.slots, plan.pair) != (single.slots, single.pair):
        raise ValueError(
            "this program computes something else for one pair than for many: it cannot be dealt"
        )
    return plan


def _measure(terms: Terms, rows: int, columns: int) -> GalleryPlan:
    meters, sides, symbols = [], [], []
    for owner, count in enumerate((rows, columns)):
        meter = _meter(terms, (count,))
        vectors = meter.input_mask(Input(owner, (count, terms.dim), terms.norm))
        derived, _ = run_silently(fill(meter, terms, vectors), meter.on_request)
        sides.append(Filled(terms.standing(owner), derived, count, partial(_known, vectors.parts)))
        meters.append(meter)
    pairs = _meter(terms, (rows, columns))
    run_silently(compare(pairs, terms, sides[0], sides[1]), pairs.on_request)
    for meter in (*meters, pairs):
        symbols += meter.trace
    parts = tuple((one.dim, one.norm, one.squares) for one in terms.sections)
    kind = (terms.security, terms.dim, parts, terms.proves, terms.resolution)
    first, second = (_plan(meter, count) for meter, count in zip(meters, (rows, columns), strict=True))
    return GalleryPlan(
        (first, second),
        _plan(pairs, rows * columns),
        pairs.opened_bits,
        _digest("recipe", kind, symbols),
        _digest("text", kind, symbols),
    )


def _known(parts: tuple[Any, ...]) -> tuple[Any, ...]:
    return parts


def _digest(side: str, kind: object, symbols: list[Symbol]) -> str:
    return digest(f"gallery {side}", kind, *(getattr(symbol, side) for symbol in symbols)).hex()


def _meter(terms: Terms, lead: tuple[int, ...]) -> Meter:
    meter = Meter(terms.security, lead)
    meter.resolution, meter.slot_bits = terms.resolution, terms.word_bits
    return meter


def _plan(meter: Meter, count: int) -> RecordPlan:
    sent = meter.elements_sent
    return RecordPlan(
        (meter.pad_bytes[0], meter.pad_bytes[1]),
        (meter.correction_bytes[0], meter.correction_bytes[1]),
        (sent[0] // count, sent[1] // count),
        meter.rounds,
        meter.openings,
        meter.bits_sent // count,
        meter.repeatable,
    )
