"""A party that remembers what was opened for each slot, and one that reads it again without a peer.

What a party computes for a slot depends on the slot's record, on its words, and on what was opened meanwhile,
which is public. So with that at hand a slot is prepared again after a restart, and nothing is opened twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spdz.foundations.errors import TapeDamaged
from spdz.foundations.types import Block, FieldArray
from spdz.readings.party import Party
from spdz.rounds.coroutine import exchange
from spdz.values.value import Value


class RecordingParty(Party):
    """A party that keeps what was opened, slot by slot."""

    _opened: list[npt.NDArray[Any]] | None = None

    def notes(self, slots: int) -> list[bytes]:
        """For each of so many slots the bytes that :class:`ReplayingParty` takes."""
        opened = [np.ascontiguousarray(one) for one in self._opened or []]
        return [b"".join(one[slot].tobytes() for one in opened) for slot in range(slots)]

    async def open(self, *values: Value) -> list[FieldArray]:
        """As :meth:`Party.open`."""
        arrays = await super().open(*values)
        self._opened = [*(self._opened or []), *arrays]
        return arrays


class ReplayingParty(Party):
    """A party that is told what was opened; bits that were checked are True.

    Nothing is exchanged, but it suspends where it did then, so that lanes draw and read in the same order.
    """

    _notes: Sequence[bytes] = ()
    _at = 0

    def replay(self, notes: Sequence[bytes]) -> None:
        """Take the notes of the slots that this party reads."""
        self._notes = notes

    async def open(self, *values: Value) -> list[FieldArray]:
        """What was opened then."""
        arrays = []
        for value in values:
            size = 16 * int(np.prod(value.shape[1:], dtype=np.int64))
            pieces = [note[self._at : self._at + size] for note in self._notes]
            if any(len(piece) != size for piece in pieces):
                raise TapeDamaged("the ledger remembers less of a slot than was opened for it")
            self._at += size
            arrays.append(np.frombuffer(b"".join(pieces), dtype=np.uint64).reshape((*value.shape, 2)))
        await exchange([], 0, 0)
        return arrays

    async def open_bits(self, shares: Block, delta: Block, n: int) -> npt.NDArray[np.bool_]:
        """The proofs that these slots have passed."""
        await exchange([], 0, 0)
        return np.ones(n, dtype=np.bool_)
