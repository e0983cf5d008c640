"""What ``python -m spdz tape`` shows of a gallery's tape."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from protocols.memory import in_bytes
from protocols.place_purpose import AnyPurpose, purpose_of
from spdz.gallery import GalleryHeader
from spdz.gallery.status import GalleryStatus

ID_DIGITS = 12
"""Digits shown of a mission's and a tape's id."""


def gallery_facts(path: Path, status: GalleryStatus) -> dict[str, Any]:
    """Everything as JSON; slots are of the pair's first robot and of its second."""
    header, purpose, flight = status.header, _purpose(status.header), status.flight
    facts: dict[str, Any] = {
        "file": str(path),
        "robot": header.name,
        "peer": header.peer,
        "agents": list(header.agents),
        "security": header.security,
        **(purpose.as_json() if purpose else {"program": header.program}),
        "slots": list(header.slots),
        "capacity": list(header.capacity),
        "slots_used": list(status.filled),
        "slots_void": list(status.void),
        "slots_left": list(status.left),
        "pairs_used": status.done[0] * status.done[1],
        "pairs_burnt": status.burnt,
        "pinned": status.pinned,
        "in_flight": flight and [*_ends(flight.rows), *_ends(flight.columns)],
        "bytes": status.size,
        "mission": header.mission[:ID_DIGITS],
        "tape": header.tape[:ID_DIGITS],
        "ledger": status.has_ledger,
        "in_use": status.in_use,
        "destroyed": status.destroyed,
        "rolled_back": status.rolled_back,
    }
    return facts | ({"dealer_command": header.dealer_command} if purpose else {})


def gallery_text(path: Path, status: GalleryStatus, verified: bool) -> str:
    """The same for people."""
    header, purpose = status.header, _purpose(status.header)
    summary = purpose.summary if purpose else "a program of your own"
    step = "" if purpose is None or purpose.reveal == "score" else f" (resolution {purpose.step_text})"
    lines = [
        f"{path}",
        f"  robot     {header.name}, to compare with {header.peer} (pair {' '.join(header.agents)})",
        f"  purpose   a gallery, {summary}{step}, {header.security}",
        *(f"  slots     {_slots(status, owner)}" for owner in (header.party, 1 - header.party)),
        f"  pairs     {_pairs(status)}",
        f"  answers   {_answers(status, purpose)}",
        f"  state     {_state(status)}",
        f"  checked   header, state and ledger, {'and every record' if verified else 'no record (--verify)'}",
        f"  file      {in_bytes(status.size)}, mission {header.mission[:ID_DIGITS]}, "
        f"tape {header.tape[:ID_DIGITS]}",
    ]
    if purpose is not None:
        lines += [f"  note      {purpose.hint}"] if purpose.hint and purpose.reveal == "bit" else []
        lines.append(f"  deal more {header.dealer_command}")
    return printable(lines)


def printable(lines: Iterable[str]) -> str:
    """Lines without anything that a terminal obeys."""
    return "\n".join("".join(c if c.isprintable() else "?" for c in line) for line in lines)


def _purpose(header: GalleryHeader) -> AnyPurpose | None:
    """What a gallery of ours was dealt for; None for programs of the user's own."""
    try:
        return purpose_of(header.program)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _ends(slots: range) -> tuple[int, int]:
    return slots.start, slots.stop


def _slots(status: GalleryStatus, owner: int) -> str:
    used, void = status.filled[owner], status.void[owner]
    holding = f", {void} of them hold nothing" if void else ""
    left = f"{status.left[owner]} of {status.header.capacity[owner]} left"
    return f"of {status.header.agents[owner]}: {left}, {used} used{holding}"


def _pairs(status: GalleryStatus) -> str:
    capacity = status.header.capacity
    used = f"{status.done[0] * status.done[1]} of {capacity[0] * capacity[1]} used"
    if status.burnt is None:
        return f"{used}; how many of them were given up is not known"
    return f"{used}, {status.burnt} of them given up without a result" if status.burnt else used


def _answers(status: GalleryStatus, purpose: AnyPurpose | None) -> str:
    if status.pinned:
        return f"{status.pinned}, and never anything else"
    if purpose is not None and purpose.reveal == "score":
        return "the score, once there is a first pair"
    return "nothing yet: the first threshold that both robots give stays for ever"


def _state(status: GalleryStatus) -> str:
    if status.destroyed:
        return "destroyed after a failed MAC check: deal a new pair of tapes, and ask why it failed"
    if status.in_use:
        return "in use by a process right now"
    if status.burnt is None:
        return "a robot was stopped while it wrote the ledger: run match again, it goes on where it was"
    if status.rolled_back:
        return (
            "the ledger is missing, or an older copy of itself: what was used since stays used; run match "
            "with the whole map"
        )
    if status.flight is not None:
        return f"a run was interrupted in {status.flight}: run match again, it goes on where it was"
    if not any(status.filled):
        return "unused"
    return "ready" if status.left[status.header.party] else "every own slot is used: only the peer can add"
