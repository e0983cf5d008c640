"""The part of a tape that changes: cursor, chain and alpha, in two alternating slots.

At rest exactly one slot holds a state and the other holds zeros. A step from state s to s+1 is

1. write s+1 into the zero slot;  2. sync;  3. write zeros over s;  4. sync.

Crash cases, for a crash anywhere (a sector may hold old, new or torn bytes until it is synced):

- up to 2: s is whole; the other slot is zeros, torn, or s+1. Loading takes s, or s+1 if that is whole.
- from 2 to 4: s+1 is whole; the other slot is s, torn, or zeros. Loading takes s+1.
- after 4: s is nowhere in the file.

Either is right, since the caller hands out nothing of s before step 4. Loading finishes what was
interrupted: it syncs what it has read (after a killed process, s+1 may be in memory only) before it wipes the
other slot. So neither slot is ever overwritten while the other is not durable, and damage to the one slot
that is left cannot bring an older state back: it is an error.

As far as the disk allows: flash storage and journaling file systems may keep old copies of a sector.
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

from spdz.tape.durable import sync, write_at
from spdz.tape.envelope import DIGEST, SECTOR

_SLOT = struct.Struct("<QQ?7x32s16s")
_ZEROS = bytes(SECTOR)


@dataclass(frozen=True, slots=True)
class State:
    """What a tape has left.

    Attributes:
        cursor: The first unused job.
        chain: Its 32-byte ratchet state; zeros once destroyed.
        alpha: This party's 16-byte share of the MAC key; zeros once destroyed.
        destroyed: Whether the tape was destroyed.
    """

    cursor: int
    chain: bytes = field(repr=False)
    alpha: bytes = field(repr=False)
    destroyed: bool = False

    @classmethod
    def wiped(cls, cursor: int) -> State:
        """A destroyed tape's state, without secrets."""
        return cls(cursor, bytes(32), bytes(16), destroyed=True)


def encode_slot(state: State, sequence: int, binding: bytes) -> bytes:
    """One slot: a whole sector. ``binding`` is the header's digest, so that no other tape's slot fits."""
    body = _SLOT.pack(sequence, state.cursor, state.destroyed, state.chain, state.alpha)
    return (body + _slot_digest(body, binding)).ljust(SECTOR, b"\0")


def _decode_slot(slot: bytes, binding: bytes) -> tuple[int, State] | None:
    body = slot[: _SLOT.size]
    if slot[_SLOT.size : _SLOT.size + DIGEST] != _slot_digest(body, binding):
        return None
    sequence, cursor, destroyed, chain, alpha = _SLOT.unpack(body)
    return sequence, State(cursor, chain, alpha, destroyed)


def latest_slot(slots: Sequence[bytes], binding: bytes) -> tuple[int, State, int] | None:
    """Sequence number, state and place of the latest whole slot; None if neither is whole."""
    whole = [
        (*decoded, which)
        for which, slot in enumerate(slots)
        if (decoded := _decode_slot(slot, binding)) is not None
    ]
    return max(whole, key=lambda entry: entry[0]) if whole else None


def _slot_digest(body: bytes, binding: bytes) -> bytes:
    return hashlib.blake2b(binding + body, digest_size=DIGEST, person=b"spdz-tape-state").digest()


class StateSlots:
    """The two slots of one open file.

    Args:
        descriptor: The tape file, open for reading and writing.
        offset: Where the first slot begins.
        binding: The header's digest.
    """

    def __init__(self, descriptor: int, offset: int, binding: bytes) -> None:
        self._descriptor = descriptor
        self._offsets = (offset, offset + SECTOR)
        self._binding = binding
        self._sequence = 0
        self._current = 0

    def load(self) -> State | None:
        """Read the latest state and finish an interrupted step; None if neither slot is whole."""
        slots = [os.pread(self._descriptor, SECTOR, offset) for offset in self._offsets]
        latest = latest_slot(slots, self._binding)
        if latest is None:
            return None
        self._sequence, state, self._current = latest
        if slots[1 - self._current] != _ZEROS:
            sync(self._descriptor)
            self._wipe(1 - self._current)
        return state

    def store(self, state: State) -> None:
        """Replace the state; on return the new one is on the disk and the old one is not."""
        target = 1 - self._current
        slot = encode_slot(state, self._sequence + 1, self._binding)
        write_at(self._descriptor, self._offsets[target], slot)
        sync(self._descriptor)
        self._sequence, self._current = self._sequence + 1, target
        self._wipe(1 - target)

    def _wipe(self, which: int) -> None:
        write_at(self._descriptor, self._offsets[which], _ZEROS)
        sync(self._descriptor)
