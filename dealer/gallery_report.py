"""Plans of galleries for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import combinations, islice

from dealer.gallery_plan import GalleryCost
from dealer.words import in_seconds
from protocols.catalog import GalleryPurpose
from protocols.memory import in_bytes
from protocols.place_purpose import AnyPurpose
from spdz.foundations.types import Security
from spdz.session.meeting import PREPARED

_NAMED = 3  # couples of robots that a sentence names
_WIDTHS = (18, 14, 12, 16, 16)


def enough_for(agents: Sequence[str], slots: tuple[int, int]) -> str:
    """Whose slots are which."""
    m, k = slots
    couples = [f"{m:,} of {a} x {k:,} of {b}" for a, b in islice(combinations(agents, 2), _NAMED)]
    more = " (and so on for the other pairs)" if len(agents) > _NAMED else ""
    return f"enough for {', '.join(couples)} descriptors{more}, over as many meetings as it takes"


def as_json(cost: GalleryCost, purpose: AnyPurpose, security: Security, total: int) -> str:
    """One object."""
    fields = {**purpose.as_json(), "security": security, **asdict(cost), "mission_bytes": total}
    for name in ("dealing_seconds", "matching_seconds"):
        value = getattr(cost, name)
        fields[name] = None if value is None else round(value, 6)
    (first, first_seconds), (second, second_seconds) = (cost.one_more(owner) for owner in (0, 1))
    fields["one_more_bytes"] = (first, second)
    fields["one_more_seconds"] = (first_seconds, second_seconds)
    return json.dumps(fields)


def as_text(
    cost: GalleryCost, purpose: AnyPurpose, security: Security, agents: Sequence[str], total: int
) -> Iterator[str]:
    """A table, and what its rows mean; ``total`` is what all robots' tapes take."""
    yield f"plan: a gallery of {_what(purpose)}, {security}; for a pair of robots"
    yield _row("", "a descriptor", "a pair", f"all {cost.slots[0]}x{cost.slots[1]}", "one more")
    sent = max(cost.one_more(0)[0], cost.one_more(1)[0])
    yield _row(
        "sent",
        in_bytes(max(cost.descriptor_bytes)),
        in_bytes(cost.pair_bytes),
        in_bytes(max(cost.bytes_sent)),
        in_bytes(sent),
    )
    yield _row(
        "tape",
        in_bytes(max(cost.descriptor_tape_bytes)),
        in_bytes(cost.pair_tape_bytes),
        in_bytes(max(cost.tape_bytes)),
        in_bytes(max(cost.descriptor_tape_bytes) + max(cost.slots) * cost.pair_tape_bytes),
    )
    if cost.seconds is not None and cost.dealing_seconds is not None and cost.matching_seconds is not None:
        one, most = cost.seconds, max(cost.slots)
        yield _row(
            "deal",
            _time(one.deal_descriptor),
            _time(one.deal_pair),
            _time(cost.dealing_seconds),
            _time(one.deal_descriptor + most * one.deal_pair),
        )
        yield _row(
            "match",
            _time(one.fill),
            _time(one.compare),
            _time(cost.matching_seconds),
            _time(one.fill + most * one.compare),
        )
    first, second = cost.tape_bytes
    yield f"tapes of {first:,} and {second:,} bytes, {in_bytes(total)} for all robots"
    yield (
        f"memory: {in_bytes(cost.dealing_memory)} to deal, {in_bytes(cost.matching_memory)} of a robot with "
        "all slots filled, estimated, beside the interpreter's 60 MB"
    )
    yield _rounds(cost)
    lost = [
        *(["the slots that were being prepared"] if cost.slots_lost else []),
        *([f"the pairs that were under way, at most {cost.pairs_together:,}"] if cost.pairs_lost else []),
    ]
    yield f"an interruption costs {' and '.join(lost) or 'nothing: what was under way is repeated'}"
    yield enough_for(agents, cost.slots)
    yield "the rows:"
    yield "  sent   by the robot that sends more; exact, without frames, agreements and checks"
    yield f"  tape   of the larger file; exact; {cost.capacity[0]} x {cost.capacity[1]} slots are dealt"
    yield "  deal   time of one core here, measured on a small gallery in memory, without the disk"
    yield "  match  the same for one robot, without the line"
    yield f"one more: a further descriptor against {max(cost.slots)} of the other robot"
    yield "nothing was written"


def _rounds(cost: GalleryCost) -> str:
    """How many rounds a step takes: one to send, and then groups of descriptors and strips of pairs."""
    prepare, compare = cost.rounds
    further = [
        *([f"{prepare} for each further {PREPARED} descriptors of a robot"] * (prepare > 0)),
        f"{compare} for each further {cost.pairs_together:,} pairs",
    ]
    return (
        f"a step takes {1 + prepare + compare} rounds where one robot brings something, "
        f"{1 + prepare + 2 * compare} where both do; {' and '.join(further)}"
    )


def _what(purpose: AnyPurpose) -> str:
    step = "exact" if purpose.resolution is None else f"to {purpose.step_text}"
    if not isinstance(purpose, GalleryPurpose):
        return f"{purpose.summary} ({step})"
    opened = f"the candidate bit ({step})" if purpose.reveal == "bit" else "the score"
    norms = f"norm {purpose.min_norm:g} to {purpose.max_norm:g}"
    return f"{purpose.score} of {purpose.dim}-D descriptors of {norms}, {opened}"


def _row(*cells: str) -> str:
    first, *rest = (f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))
    return "  " + cells[0].ljust(8) + "".join(rest) if first else ""


def _time(seconds: float) -> str:
    for unit, size in (("us", 1e6), ("ms", 1e3)):
        if seconds * size < 999.5:
            return f"{seconds * size:.3g} {unit}"
    return in_seconds(seconds)
