"""Run a gallery's steps for both parties in this process, in lock-step: to time them, and in tests.

What networked robots do with their tapes and a line between them happens here with streams of records and
nothing in between; programs, parties and checks are the same.
"""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import Any

from spdz.foundations.errors import Unsent
from spdz.foundations.stats import Stats
from spdz.foundations.types import FieldArray, IntArray
from spdz.local import lock_step
from spdz.readings.gallery import Derived, Filled, Terms, compare, fill
from spdz.readings.party import Party
from spdz.readings.streams import RecordStream
from spdz.rounds.mac_check import MacCheck
from spdz.values import input_mask
from spdz.values.engine import Input
from spdz.values.standing import Standing

Streams = tuple[RecordStream, RecordStream]
"""What party 0 and party 1 draw."""

Both = tuple[Filled, Filled]
"""The same slots as party 0 and as party 1 know them."""


class Couple:
    """Two parties of one gallery.

    Args:
        terms: The gallery's.
        alphas: Either party's share of the MAC key; None in semi-honest mode.

    Attributes:
        stats: What either has sent so far.
    """

    def __init__(self, terms: Terms, alphas: tuple[int, int] | None) -> None:
        session = secrets.token_bytes(32)
        self._terms, self._alphas = terms, alphas or (None, None)
        self._checks = [
            None if alpha is None else MacCheck(alpha, index, session)
            for index, alpha in enumerate(self._alphas)
        ]
        self.stats = (Stats(), Stats())

    def fill(self, owner: int, data: IntArray, streams: Streams) -> tuple[Both, Any]:
        """Mask one party's vectors, prepare them and prove their norms.

        Args:
            owner: Whose they are.
            data: Quantised vectors, shape (n, N).
            streams: What was dealt for n slots.

        Returns:
            The slots as either party knows them, and whether each norm is proved.

        Raises:
            Unsent: if the mask of a slot does not suit its vector, which happens once in 2^16 times.
        """
        terms, source = self._terms, Input(owner, data.shape, self._terms.norm)
        parties = [self._party(index, stream) for index, stream in enumerate(streams)]
        masks = [party.input_mask(source) for party in parties]
        own = masks[owner][0]
        if own is None:
            raise ValueError("the owner of a slot has its mask")
        s = input_mask.field_offsets(own)
        words = data + s
        if not input_mask.inside(words, terms.word_bits, terms.entry).all():
            raise Unsent("the mask of a slot does not suit its vector: deal anew")
        slots = []
        for party, (_, mac) in zip(parties, masks, strict=True):
            own_s = s if party.index == owner else None
            slots.append(_Slots(party, terms, replace(terms.standing(owner), eps=words, s=own_s, mac=mac)))
        done = lock_step([side.prepare() for side in slots], self._checks, self.stats)
        first, second = (side.filled() for side in slots)
        return (first, second), done

    def compare(self, rows: Both, columns: Both, streams: Streams) -> Any:
        """Compare party 0's slots with party 1's: what both learn, shape (R, C)."""
        protocols = [
            compare(self._party(index, stream), self._terms, rows[index], columns[index])
            for index, stream in enumerate(streams)
        ]
        return lock_step(protocols, self._checks, self.stats)

    def _party(self, index: int, stream: RecordStream) -> Party:
        alpha = self._alphas[index]
        party = Party(index, self._terms.security, stream, self._checks[index], alpha, self.stats[index])
        party.resolution, party.slot_bits = self._terms.resolution, self._terms.word_bits
        return party


class _Slots:
    """Slots of one owner, at one party."""

    def __init__(self, party: Party, terms: Terms, vectors: Standing) -> None:
        self._party, self._terms, self._vectors = party, terms, vectors
        self._derived: tuple[Derived, ...] = ()

    async def prepare(self) -> Any:
        """Prepare and prove; returns what is proved."""
        parts = tuple(None if part is None else self._flat(part) for part in self._parts())
        vectors = self._terms.value(self._party, self._vectors, (len(self._vectors), self._terms.dim), parts)
        self._derived, proved = await fill(self._party, self._terms, vectors)
        return proved

    def filled(self) -> Filled:
        """What is known now."""
        return Filled(self._vectors, self._derived, len(self._vectors), self._parts)

    def _parts(self) -> tuple[Any, ...]:
        return self._vectors.parts(malicious=self._terms.security == "malicious", dealt=False)

    def _flat(self, part: FieldArray) -> FieldArray:
        """Without the other party's axis."""
        return part[:, 0] if self._vectors.owner == 0 else part[0]
