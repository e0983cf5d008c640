"""The slots of one party as one side holds them in memory, ready to be compared.

For 5,000 vectors of 1,536 numbers this is 61 MB of words, as much of masks (at the owner) and 123 MB of MAC
shares. The arrays have room for every slot, and the system gives them memory as they are filled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from spdz.foundations.stats import Stats
from spdz.foundations.types import IntArray
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Derived, Filled, Terms, fill
from spdz.readings.party import Party
from spdz.readings.records import slot_stream
from spdz.readings.replay import RecordingParty, ReplayingParty
from spdz.readings.streams import RecordStream
from spdz.rounds.coroutine import run_silently
from spdz.rounds.mac_check import MacCheck
from spdz.values.engine import Input
from spdz.values.input_mask import as_elements, field_offsets, offsets
from spdz.values.standing import Standing
from spdz.values.value import Value

AnyParty = TypeVar("AnyParty", bound=Party)

_DELTA = 16
_TOGETHER = 128
"""Slots read at a time."""


class Shelf:
    """One party's slots.

    Args:
        tape: This side's gallery tape.
        terms: What it is for.
        owner: Whose slots.
    """

    def __init__(self, tape: GalleryTape, terms: Terms, owner: int) -> None:
        self.owner, self.capacity = owner, tape.header.capacity[owner]
        self._tape, self._terms = tape, terms
        self._own, self._malicious = tape.header.party == owner, terms.security == "malicious"
        shape = (self.capacity, terms.dim)
        self._eps: IntArray = np.empty(shape, dtype=np.int64)
        self._s: IntArray | None = np.empty(shape, dtype=np.int64) if self._own else None
        self._mac = np.empty((*shape, 2), dtype=np.uint64) if self._malicious else None
        self._columns: list[tuple[Value, tuple[Any, ...]]] | None = None

    def masks(self, slots: Sequence[int]) -> IntArray:
        """The masks s of own slots, shape (n, N)."""
        pads = np.stack([self._tape.slot(self.owner, slot).pad for slot in slots])
        words = np.ascontiguousarray(pads[:, _DELTA : _DELTA + 16 * self._terms.dim]).view("<u8")
        return offsets(words.reshape(len(slots), self._terms.dim, 2)[..., 0], self._terms.word_bits)

    def place(self, slots: Sequence[int], words: IntArray) -> None:
        """What the slots hold: words of shape (n, N)."""
        self._eps[list(slots)] = words

    def read_masks(self, slots: Sequence[int]) -> None:
        """Read the masks of own slots that :meth:`prepare` has not come to yet."""
        if self._s is not None and slots:
            self._s[list(slots)] = self.masks(slots)

    def plain(self, slots: Sequence[int]) -> IntArray:
        """The raw vectors in own slots, shape (n, N)."""
        if not self._own:
            raise ValueError("only the owner knows what a slot holds")
        result = np.empty((len(slots), self._terms.dim), dtype=np.int64)
        for start in range(0, len(slots), _TOGETHER):
            some = slots[start : start + _TOGETHER]
            result[start : start + len(some)] = self._eps[list(some)] - self.masks(some)
        return result

    def party(
        self, slots: Sequence[int], mac_check: MacCheck | None, alpha: int | None, stats: Stats
    ) -> RecordingParty:
        """A party that draws on the records of these slots."""
        return configured(
            RecordingParty(
                self._tape.header.party, self._terms.security, self._stream(slots), mac_check, alpha, stats
            ),
            self._terms,
        )

    async def prepare(self, party: Party, slots: Sequence[int]) -> Any:
        """Fill slots that hold something: read their masks, prepare them and prove them.

        Returns:
            For every slot whether it is proved; None where nothing is.
        """
        terms, index = self._terms, list(slots)
        mask, mac = party.input_mask(Input(self.owner, (len(index), terms.dim), terms.norm))
        words = self._eps[index]
        self.read_masks(slots)
        if self._mac is not None and mac is not None:
            self._mac[index] = mac
        shape = (len(index), terms.dim)
        eps = as_elements(words)
        parts = (eps, mask, mac) if self._malicious else (eps, mask)
        standing = replace(terms.standing(self.owner), eps=words)
        derived, proved = await fill(party, terms, terms.value(party, standing, shape, parts))
        self._keep(index, derived)
        return proved

    def restore(self, slots: Sequence[int], opened: Sequence[bytes], alpha: int | None) -> None:
        """Fill slots that were prepared in an earlier session, from what was opened then."""
        for start in range(0, len(slots), _TOGETHER):
            some = slots[start : start + _TOGETHER]
            index, security = self._tape.header.party, self._terms.security
            party = ReplayingParty(index, security, self._stream(some), None, alpha, Stats())
            party.replay(opened[start : start + _TOGETHER])
            run_silently(self.prepare(configured(party, self._terms), some))

    def words(self, slot: int) -> bytes:
        """What a slot holds, as int64, little-endian."""
        words: bytes = self._eps[slot].astype("<i8", copy=False).tobytes()
        return words

    def standing(self, slots: Sequence[int]) -> Standing:
        """Slots that hold something, in any order, with masks and MAC shares as the tape has them.

        Unlike :meth:`filled` it does not need them to be prepared.
        """
        shape = (len(slots), self._terms.dim)
        known = replace(self._terms.standing(self.owner), eps=self._eps[list(slots)])
        if not slots:
            return replace(known, s=known.words if self._own else None)
        index, security = self._tape.header.party, self._terms.security
        party = configured(Party(index, security, self._stream(slots), None, None, Stats()), self._terms)
        mask, mac = party.input_mask(Input(self.owner, shape, self._terms.norm))
        return replace(known, s=None if mask is None else field_offsets(mask), mac=mac)

    def filled(self, which: range) -> Filled:
        """Consecutive slots, none void, for a comparison."""
        cut = slice(which.start, which.stop)
        mask = None if self._s is None else self._s[cut]
        mac = None if self._mac is None else self._mac[cut]
        standing = replace(self._terms.standing(self.owner), eps=self._eps[cut], s=mask, mac=mac)
        derived = tuple(
            Derived(_cut(value, columns, cut, len(which))) for value, columns in self._columns or ()
        )
        malicious = self._malicious
        return Filled(standing, derived, len(which), lambda: standing.parts(malicious=malicious, dealt=False))

    def _keep(self, index: list[int], derived: Sequence[Derived]) -> None:
        """Copy what was prepared into arrays with room for every slot."""
        if self._columns is None:
            self._columns = [
                (
                    one.value,
                    tuple(
                        None if part is None else np.empty((self.capacity, *part.shape[1:]), dtype=part.dtype)
                        for part in one.value.parts
                    ),
                )
                for one in derived
            ]
        for (_, columns), one in zip(self._columns, derived, strict=True):
            for column, part in zip(columns, one.value.parts, strict=True):
                if column is not None:
                    column[index] = part

    def _stream(self, slots: Sequence[int]) -> RecordStream:
        records = [self._tape.slot(self.owner, slot) for slot in slots]
        pads = np.stack([record.pad for record in records])
        corrections = np.stack([np.frombuffer(record.correction, dtype=np.uint8) for record in records])
        deltas = np.ascontiguousarray(pads[:, :_DELTA]).view("<u8")
        return slot_stream(pads[:, _DELTA:], corrections, deltas, [record.hash_key for record in records])


def _cut(value: Value, columns: tuple[Any, ...], which: slice, count: int) -> Value:
    parts = tuple(None if column is None else column[which] for column in columns)
    form = {"masked": value.masked, "is_bit": value.is_bit, "mask_bits": value.mask_bits, "span": value.span}
    return Value(value.engine, parts, (count, *value.shape[1:]), value.frac, value.bound, **form)  # type: ignore[arg-type]


def configured(party: AnyParty, terms: Terms) -> AnyParty:
    """A party that reads these terms."""
    party.resolution, party.slot_bits = terms.resolution, terms.word_bits
    return party
