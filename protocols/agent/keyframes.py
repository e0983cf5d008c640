"""The keyframes of this robot as its agent keeps them, and which slot of which gallery each is in."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from protocols.agent.keyframe import Keyframe
from protocols.agent.records import Records
from spdz.foundations.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Described:
    """A keyframe's vector for one gallery, checked.

    Attributes:
        vector: Shape (N,), as it was given.
        raw: The same as quantised.
    """

    vector: FloatArray = field(repr=False)
    raw: IntArray = field(repr=False)


@dataclass(frozen=True, slots=True)
class Waiting:
    """A keyframe that is in no slot yet.

    Attributes:
        keyframe: Its number.
        vector: Shape (N,).
        digest: Of the vector as quantised.
    """

    keyframe: int
    vector: FloatArray = field(repr=False)
    digest: bytes = field(repr=False)


def digest_of(raw: IntArray) -> bytes:
    """What a quantised vector is found again by."""
    return hashlib.sha256(np.ascontiguousarray(raw, dtype="<i8").tobytes()).digest()


class Keyframes:
    """The keyframes in an agent's records.

    Args:
        records: The open records.
    """

    def __init__(self, records: Records) -> None:
        self._records = records

    def add(self, keyframe: Keyframe, described: Mapping[str, Described]) -> list[str]:
        """Keep a keyframe, durably; the same one again changes nothing.

        Returns:
            The galleries in which it is new.

        Raises:
            ValueError: if another keyframe has its number.
            RecordsError: if it cannot be written; then nothing of it is kept.
        """
        records, number, new = self._records, keyframe.id, []
        with records.transaction():
            held = records.all("SELECT payload FROM keyframes WHERE id = ?", number)
            if held and held != [(keyframe.payload,)]:
                raise ValueError(f"there is a keyframe {number} already, with another payload")
            if not held:
                records.run(
                    "INSERT INTO keyframes VALUES (?, ?, ?)", number, keyframe.stamp, keyframe.payload
                )
            for gallery, one in described.items():
                digest, where = digest_of(one.raw), (gallery, number)
                there = records.all("SELECT digest FROM vectors WHERE gallery = ? AND keyframe = ?", *where)
                if there and there != [(digest,)]:
                    raise ValueError(f"there is a keyframe {number} already, with another {gallery}")
                if not there:
                    vector = np.asarray(one.vector, dtype="<f8").tobytes()
                    columns = "(gallery, keyframe, digest, vector)"
                    records.run(f"INSERT INTO vectors {columns} VALUES (?, ?, ?, ?)", *where, digest, vector)
                    new.append(gallery)
        return new

    def get(self, number: int, gallery: str) -> Keyframe | None:
        """A keyframe with its vector for one gallery; None if there is none of that number."""
        rows = self._records.all(
            "SELECT stamp, payload, vector FROM keyframes LEFT JOIN vectors ON keyframe = id AND gallery = ? "
            "WHERE id = ?",
            *(gallery, number),
        )
        for stamp, payload, vector in rows:
            array = None if vector is None else np.frombuffer(vector, dtype="<f8")
            return Keyframe(number, array, payload, stamp)
        return None

    def count(self, gallery: str) -> int:
        """How many keyframes a gallery has been given."""
        return int(self._records.all("SELECT count(*) FROM vectors WHERE gallery = ?", gallery)[0][0])


class Slots:
    """Which keyframe is in which own slot of one gallery with one peer.

    Args:
        records: The open records.
        peer: The other robot.
        gallery: The gallery.
    """

    def __init__(self, records: Records, peer: str, gallery: str) -> None:
        self._records, self._gallery, self._link = records, gallery, records.link(peer, gallery)

    def known(self) -> dict[int, int | None]:
        """The keyframe in every slot; None where the records of it were lost."""
        return dict(self._records.all("SELECT slot, keyframe FROM slots WHERE link = ?", self._link))

    def waiting(self, besides: Iterable[bytes] = (), most: int = 1 << 30) -> list[Waiting]:
        """Keyframes that are in no slot, in the order in which they came.

        Args:
            besides: Digests of vectors that a session brings already, each as often as it does.
            most: How many to look for.
        """
        brought, found = Counter(besides), list[Waiting]()
        rows = self._records.all(
            "SELECT keyframe, vector, digest FROM vectors WHERE gallery = ? AND keyframe NOT IN "
            "(SELECT keyframe FROM slots WHERE link = ? AND keyframe IS NOT NULL) ORDER BY place LIMIT ?",
            *(self._gallery, self._link, most + brought.total()),
        )
        for keyframe, vector, digest in rows:
            if brought[digest]:
                brought[digest] -= 1
            elif len(found) < most:
                found.append(Waiting(keyframe, np.frombuffer(vector, dtype="<f8"), digest))
        return found

    def place(self, slots: Mapping[int, bytes], lost: Iterable[int]) -> None:
        """Remember which keyframes are in new slots, by what the ledger says is in them.

        Args:
            slots: New slots in ascending order, with the digests of the vectors in them.
            lost: Slots that hold nothing any more.
        """
        records = self._records
        with records.transaction():
            for slot in lost:
                records.run("DELETE FROM slots WHERE link = ? AND slot = ?", self._link, slot)
            unplaced: dict[bytes, list[int]] = {}
            for one in self.waiting() if slots else []:
                unplaced.setdefault(one.digest, []).append(one.keyframe)
            for slot, digest in slots.items():
                keyframe = unplaced[digest].pop(0) if unplaced.get(digest) else None
                records.run("INSERT OR REPLACE INTO slots VALUES (?, ?, ?)", self._link, slot, keyframe)
