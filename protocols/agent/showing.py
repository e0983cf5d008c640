"""Two robots that have a match show each other what they saw: the exchange after a True bit.

1. Both say which of the wanted pairs are True in their *own* durable results and will be shown, and which of
   the peer's slots they have not seen. Nothing is shown on the peer's word.
2. Both promise, by a digest, what they will show: who has seen the other's half cannot make its own of it.
3. Both open the descriptors under MAC (:meth:`spdz.session.GallerySession.reveal`): what comes is the very
   vector that was compared.
4. Then the payloads, over the same TLS session, to this peer alone.

Neither side can be held to be as good as the other: who sends second can stop. A half that does not come is
the agent's to name (:mod:`protocols.agent.link`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from protocols.agent.keyframe import MAX_ID, Keyframe, is_stamp
from protocols.agent.matches import Pair
from protocols.agent.saying import MOST_PAIRS, read_slots
from spdz.foundations.errors import ProtocolViolation
from spdz.session import GallerySession

MAX_PAYLOAD = 8 << 20
"""Most bytes of a keyframe's payload."""
_HEAD = 4096


def show(
    session: GallerySession,
    wanted: Sequence[Pair],
    trusted: Collection[Pair],
    seen: Collection[int],
    own: Callable[[int], Keyframe],
    capacity: tuple[int, int],
    later: bool,
    agreed: Callable[[Sequence[Pair], bool], None],
    promised: Callable[[Mapping[int, str]], None],
) -> dict[int, Keyframe]:
    """Run the exchange for some matches; both sides call it with the same pairs.

    Args:
        session: The connected gallery.
        wanted: Pairs (own slot, peer's slot) that either side wants, at most 2 MOST_PAIRS.
        trusted: Those that this side's durable results say are True, and that it shows its half of.
        seen: The peer's slots that need not be shown again.
        own: Gives what this side shows of one of its slots.
        capacity: Slots of this side and of the peer.
        later: Whether this side would show more, and the peer owes it too much for now.
        agreed: Called, before anything is shown, with the pairs that both sides show their halves of, and
            whether the peer would show more later.
        promised: Called, before anything is shown, with digests of what the peer shows, by its slots; raises
            :class:`ProtocolViolation` if it has promised anything else before.

    Returns:
        What the peer has shown, by its slots.

    Raises:
        ProtocolViolation: if the peer shows anything else.
        SpdzError: as any session.
    """
    mine = [pair for pair in wanted if pair in trusted]
    lack = sorted({theirs for _, theirs in mine} - set(seen))
    note: dict[str, Any] = {"true": sorted(_in_order(mine, session.party)), "lack": lack, "later": later}
    answer = session.exchange_note(note)
    if set(answer) != set(note) or type(answer["later"]) is not bool:
        raise ProtocolViolation("the peer's agent sent a malformed note on matches")
    told = answer["true"]
    both = (
        [pair for pair in mine if list(_ordered(pair, session.party)) in told]
        if isinstance(told, list)
        else []
    )
    agreed(both, answer["later"])
    lacking = set(read_slots(answer["lack"], 2 * MOST_PAIRS, capacity[0]))
    showing = sorted({slot for slot, _ in both} & lacking)
    expected = sorted({theirs for _, theirs in both} & set(lack))
    if not showing and not expected:
        return {}
    packed = [_pack(own(slot)) for slot in showing]
    digests = [_digest(session.party, slot, frame) for slot, frame in zip(showing, packed, strict=True)]
    promises = _read_promises(session.exchange_note({"sha256": list(digests)}), expected)
    promised(promises)
    vectors = session.reveal(showing, expected)
    frames = session.swap(packed, most=len(expected) * (MAX_PAYLOAD + _HEAD))
    if len(frames) != len(expected):
        raise ProtocolViolation(f"the peer shows {len(frames)} keyframes instead of {len(expected)}")
    for slot, frame in zip(expected, frames, strict=True):
        if _digest(1 - session.party, slot, frame) != promises[slot]:
            raise ProtocolViolation("the peer shows another keyframe than it has promised")
    shown = {slot: _unpack(frame) for slot, frame in zip(expected, frames, strict=True)}
    return {slot: Keyframe(one.id, vectors[slot], one.payload, one.stamp) for slot, one in shown.items()}


def _in_order(pairs: Sequence[Pair], party: int) -> list[list[int]]:
    """Pairs as (slot of party 0, slot of party 1), as both sides write them."""
    return [list(_ordered(pair, party)) for pair in pairs]


def _ordered(pair: Pair, party: int) -> Pair:
    return pair if party == 0 else (pair[1], pair[0])


def _digest(party: int, slot: int, frame: bytes) -> str:
    """What a side promises before it sees the other's half; it cannot give the other's promise back."""
    label = f"spdz keyframe of party {party} slot {slot}: ".encode()
    return hashlib.sha256(label + hashlib.sha256(frame).digest()).hexdigest()


def _read_promises(note: Mapping[str, Any], expected: Sequence[int]) -> dict[int, str]:
    digests = note["sha256"] if set(note) == {"sha256"} else None
    if not isinstance(digests, list) or len(digests) != len(expected):
        raise ProtocolViolation("the peer's agent sent a malformed note on what it shows")
    if not all(isinstance(one, str) and len(one) == 64 for one in digests):
        raise ProtocolViolation("the peer's agent sent a malformed note on what it shows")
    return dict(zip(expected, digests, strict=True))


def _pack(keyframe: Keyframe) -> bytes:
    head = json.dumps({"id": keyframe.id, "stamp": keyframe.stamp}).encode()
    return len(head).to_bytes(4, "little") + head + keyframe.payload


def _unpack(frame: bytes) -> Keyframe:
    size = int.from_bytes(frame[:4], "little")
    try:
        if not 0 < size <= _HEAD or len(frame) < 4 + size:
            raise ValueError
        head = json.loads(frame[4 : 4 + size])
        number, stamp = head["id"], head["stamp"]
        good = type(number) is int and 0 <= number <= MAX_ID and set(head) == {"id", "stamp"}
        if not good or not (stamp is None or (type(stamp) in (int, float) and is_stamp(stamp))):
            raise ValueError
    except (ValueError, TypeError, KeyError, RecursionError):
        raise ProtocolViolation("the peer shows a keyframe whose description cannot be read") from None
    if len(frame) - 4 - size > MAX_PAYLOAD:
        raise ProtocolViolation("the peer shows a larger payload than there may be")
    return Keyframe(number, None, frame[4 + size :], None if stamp is None else float(stamp))
