"""Plans for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, islice

from dealer.plan import LINK_BYTES, LINK_ROUND, Impossible, TilePlan
from dealer.words import counted, each_pair, in_seconds
from protocols.catalog import Purpose
from protocols.memory import in_bytes
from spdz.foundations.types import Security

_COLUMNS = (
    ("tile", 11),
    ("jobs", 12),
    ("spare", 8),
    ("sent", 10),
    ("radio", 10),
    ("tape", 10),
    ("deal", 9),
    ("memory", 10),
)
_LEGEND = (
    "the columns, for one pair of robots:",
    "  jobs    for all meetings; beside them spare ones for interruptions",
    "  sent    in one meeting, by the robot that sends more; exact, without TLS and TCP",
    f"  radio   time of one meeting, at {LINK_BYTES * 8 / 1e6:.0f} Mbit/s for both robots together and "
    f"{LINK_ROUND * 1e3:.0f} ms a round",
    "  tape    the larger of both files, spare jobs included; exact",
    "  deal    time to deal here, estimated from single jobs, without the disk",
    "  memory  of a robot in a meeting, estimated, beside the interpreter's 60 MB",
)
_NAMED = 3  # couples of robots that a sentence names


@dataclass(frozen=True, slots=True)
class Wanted:
    """What was asked for.

    Attributes:
        agents: The robots' names.
        maps: Descriptors of the first and of the second robot of a pair; None where comparisons were counted.
        meetings: How many times such maps meet.
        interruptions: How many there shall be room for.
    """

    agents: Sequence[str]
    maps: tuple[int, int] | None
    meetings: int
    interruptions: int

    @property
    def pairs(self) -> int:
        """Pairs of robots."""
        return len(self.agents) * (len(self.agents) - 1) // 2


def enough_for(plan: TilePlan, wanted: Wanted) -> str:
    """What the dealt jobs suffice for, whose map is which, and what lies beyond."""
    lost = f"an interruption costs up to {counted(plan.lost_jobs, 'job')}"
    most = counted(wanted.interruptions, "interruption")
    room = (
        f"with up to {most} in all ({lost}; {plan.spare_jobs:,} spare)"
        if wanted.interruptions
        else f"and no interruption ({lost}; --spare S deals for S of them)"
    )
    if wanted.maps is None:
        jobs = counted(plan.meeting_jobs, "job")
        return f"enough for {jobs} of {plan.tile[0]} x {plan.tile[1]} comparisons, {room}"
    m, k = wanted.maps
    couples = [f"{m} of {a} x {k} of {b}" for a, b in islice(combinations(wanted.agents, 2), _NAMED)]
    more = " (and so on for the other pairs)" if wanted.pairs > _NAMED else ""
    return (
        f"enough for {counted(wanted.meetings, 'meeting')} of at most {', '.join(couples)} descriptors"
        f"{more}, {room}; "
        "a larger map costs a whole row of tiles more"
    )


def as_json(
    plans: Sequence[TilePlan | Impossible], picked: TilePlan, why: str, purpose: Purpose, security: Security
) -> Iterator[str]:
    """One object a tile."""
    for plan in plans:
        fields = {**purpose.as_json(), "security": security, **asdict(plan)}
        if isinstance(plan, TilePlan):
            fields |= {"interrupted_seconds": plan.interrupted_seconds, "picked": plan.tile == picked.tile}
        for name in ("dealing_seconds", "link_seconds", "interrupted_seconds"):
            if fields.get(name) is not None:
                fields[name] = round(fields[name], 3)
        if fields.get("picked"):
            fields["reason"] = why
        yield json.dumps(fields)


def as_text(
    plans: Sequence[TilePlan | Impossible],
    picked: TilePlan,
    why: str,
    purpose: Purpose,
    security: Security,
    wanted: Wanted,
    total: int,
) -> Iterator[str]:
    """A table, the picked tile and what the columns mean; ``total`` is what all robots' tapes take."""
    opened = "the candidate bit" if purpose.reveal == "bit" else "the score"
    yield (
        f"plan: {purpose.score} of {purpose.dim}-D descriptors of norm at most {purpose.max_norm:g}, "
        f"{opened}, {security}; for a pair of robots"
    )
    yield "  " + "".join(f"{title:>{width}}" for title, width in _COLUMNS)
    for plan in plans:
        size = f"{plan.tile[0]}x{plan.tile[1]}"
        if isinstance(plan, Impossible):
            yield f"  {size:>11}  impossible: {plan.reason}"
            continue
        cells = (
            size,
            f"{plan.jobs - plan.spare_jobs:,}",
            f"{plan.spare_jobs:,}",
            in_bytes(max(plan.bytes_sent)),
            in_seconds(plan.link_seconds),
            in_bytes(max(plan.tape_bytes)),
            "-" if plan.dealing_seconds is None else in_seconds(plan.dealing_seconds),
            in_bytes(plan.matching_memory),
        )
        row = "".join(f"{cell:>{width}}" for cell, (_, width) in zip(cells, _COLUMNS, strict=True))
        yield ("* " if plan.tile == picked.tile else "  ") + row
    yield f"* {picked.tile[0]}x{picked.tile[1]}: {why}"
    yield (
        f"with it: {counted(picked.comparisons, 'comparison')} in {counted(picked.jobs, 'job')} "
        f"{each_pair(wanted.pairs)}, tapes of {in_bytes(total)} in all; dealing needs "
        f"{in_bytes(picked.dealing_memory)} of memory"
    )
    yield enough_for(picked, wanted)
    yield from _LEGEND
    yield "nothing was written"
