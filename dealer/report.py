"""Plans for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from dealer.plan import Impossible, TilePlan
from protocols.catalog import Purpose
from protocols.memory import in_bytes
from spdz.types import Security

_COLUMNS = (
    ("tile", 11),
    ("jobs", 10),
    ("at once", 8),
    ("rounds", 9),
    ("sent", 10),
    ("tape", 10),
    ("deal", 9),
    ("RAM deal", 10),
    ("RAM match", 10),
)


def as_json(
    plans: Sequence[TilePlan | Impossible], picked: TilePlan, why: str, purpose: Purpose, security: Security
) -> Iterator[str]:
    """One object a tile."""
    for plan in plans:
        fields = {**purpose.as_json(), "security": security, **asdict(plan)}
        for name in ("dealing_seconds", "link_seconds"):
            if fields.get(name) is not None:
                fields[name] = round(fields[name], 3)
        if isinstance(plan, TilePlan):
            fields["picked"] = plan.tile == picked.tile
        if fields.get("picked"):
            fields["reason"] = why
        yield json.dumps(fields)


def as_text(
    plans: Sequence[TilePlan | Impossible],
    picked: TilePlan,
    why: str,
    purpose: Purpose,
    security: Security,
    total: int,
    pairs: int,
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
            f"{plan.jobs:,}",
            f"{plan.together}",
            f"{plan.rounds:,}",
            in_bytes(max(plan.bytes_sent)),
            in_bytes(max(plan.tape_bytes)),
            _seconds(plan.dealing_seconds),
            in_bytes(plan.dealing_memory),
            in_bytes(plan.matching_memory),
        )
        row = "".join(f"{cell:>{width}}" for cell, (_, width) in zip(cells, _COLUMNS, strict=True))
        yield ("* " if plan.tile == picked.tile else "  ") + row
    yield f"* {picked.tile[0]}x{picked.tile[1]}: {why}"
    yield (
        f"with it: {picked.comparisons:,} comparisons in {picked.jobs:,} jobs for each of {pairs} pair(s) of "
        f"robots, tapes of {in_bytes(total)} in all"
    )
    yield (
        "at once: jobs that share rounds. sent, tape: the larger of both robots', exact. deal: estimated "
        "from single jobs, without the disk. RAM: estimates beside the interpreter's 60 MB"
    )
    yield "nothing was written"


def _seconds(estimate: float | None) -> str:
    if estimate is None:
        return "-"
    return f"{estimate:.2g} s" if estimate < 100 else f"{estimate:,.0f} s"
