"""What becomes of a ledger that is behind its mark: it was restored from a backup, or lost.

What the mark remembers and the ledger does not know was sent, or may have been, and can be neither repeated
nor replaced:

- Slots filled since, of either party, are void: their bytes are unknown here. (The peer could send its own
  once more, but the pairs with them that matter most are used already; it fills other slots.)
- Slots whose note is lost are void: under another note their masks would show a second value.
- Pairs used since are burnt, and so is a strip in flight that the ledger has not heard of. One that it
  knows stays in flight: with the bytes of all its slots at hand it is the same again.
- What was void is void, the text is pinned, and destroyed stays destroyed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from spdz.gallery.heads import extended, first_head
from spdz.gallery.mark import Mark, Side
from spdz.gallery.runs import joined, runs_of, slots_in
from spdz.gallery.strip import Strip, between, grown

Digests: TypeAlias = Sequence[bytes | None]
"""What :func:`spdz.gallery.heads.digest_of` makes of slots 0, 1, ...; None for void ones."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """How to bring a ledger up to its mark.

    Attributes:
        mark: The record to store, in a step after the mark's last.
        void: Slots to make void, of party 0 and of party 1; some of them are past the ledger's.
        burnt: Strips to burn, in order.
    """

    mark: Mark
    void: tuple[list[int], list[int]]
    burnt: list[Strip]


def recovery(ledger: Mark, digests: tuple[Digests, Digests], mark: Mark) -> Recovery:
    """What to do about a ledger behind its mark.

    Args:
        ledger: The ledger's record.
        digests: Of the slots it holds, of party 0 and of party 1; None for void ones.
        mark: The mark, with a higher sequence number.

    Raises:
        ValueError: The ledger is not of the mark's past.
    """
    if not mark.follows(ledger):
        raise ValueError("the ledger holds what its mark does not know")
    sides, void = [], []
    for owner, (have, want) in enumerate(zip(ledger.sides, mark.sides, strict=True)):
        known = _without(digests[owner], set(slots_in(want.void)))
        if have.filled == want.filled and _head(mark.tape, owner, known) != want.head:
            raise ValueError(f"the ledger's slots of party {owner} are not those of its mark")
        side, lost = _recovered(mark.tape, owner, have, want, digests[owner])
        sides.append(side)
        void.append(lost)
    done, flight = mark.done, mark.flight
    burnt = between(ledger.done, done)
    if flight is not None and flight != ledger.flight:
        burnt.append(flight)
        done, flight = grown(done, flight), None
    recovered = replace(mark, sides=(sides[0], sides[1]), done=done, flight=flight)
    return Recovery(recovered, (void[0], void[1]), burnt)


def check_ahead(ledger: Mark, digests: tuple[Digests, Digests], mark: Mark) -> None:
    """See that a ledger that is not behind its mark can have become of it.

    Raises:
        ValueError: It cannot: the two are of different histories.
    """
    if not ledger.follows(mark):
        raise ValueError("the mark holds what the ledger does not know")
    for owner, (now, then) in enumerate(zip(ledger.sides, mark.sides, strict=True)):
        void_since = set(slots_in(now.void)) - set(slots_in(then.void))
        if void_since & set(range(then.filled)):
            continue  # the digests of then are gone
        if _head(mark.tape, owner, digests[owner][: then.filled]) != then.head:
            raise ValueError(f"the ledger's slots of party {owner} are not those of its mark")


def _recovered(tape: str, owner: int, have: Side, want: Side, digests: Digests) -> tuple[Side, list[int]]:
    lost_notes = set(slots_in(want.noted)) - set(slots_in(have.noted))
    void = joined(want.void, [(have.filled, want.filled)], runs_of(lost_notes))
    lost = sorted(set(slots_in(void)) - set(slots_in(have.void)))
    held = _without([*digests, *[None] * (want.filled - have.filled)], set(lost))
    return Side(want.filled, _head(tape, owner, held), void, want.noted), lost


def _head(tape: str, owner: int, digests: Digests) -> bytes:
    return extended([first_head(tape, owner)], digests)[-1]


def _without(digests: Digests, void: set[int]) -> list[bytes | None]:
    return [None if slot in void else digest for slot, digest in enumerate(digests)]
