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
    """The part of an agent's records that is about its own keyframes.

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
        records, new = self._records, []
        with records.transaction():
            held = records.all("SELECT payload FROM keyframes WHERE id = ?", keyframe.id)
            if held and held != [(keyframe.payload,)]:
                raise ValueError(f"there is a keyframe {keyframe.id} already, with another payload")
            if not held:
                records.run(
                    "INSERT INTO keyframes VALUES (?, ?, ?)", keyframe.id, keyframe.stamp, keyframe.payload
                )
            for gallery, one in described.items():
                digest = digest_of(one.raw)
                there = records.all(
                    "SELECT digest FROM vectors WHERE gallery = ? AND keyframe = ?", gallery, keyframe.id
                )
                if there and there != [(digest,)]:
                    raise ValueError(f"keyframe {keyframe.id} has another descriptor {gallery!r} already")
                if not there:
                    vector = np.asarray(one.vector, dtype="<f8").tobytes()
                    records.run(
                        "INSERT INTO vectors (gallery, keyframe, digest, vector) VALUES (?, ?, ?, ?)",
                        gallery, keyframe.id, digest, vector,
                    )  # fmt: skip
                    new.append(gallery)
        return new

    def get(self, number: int, gallery: str) -> Keyframe | None:
        """A keyframe with its vector for one gallery; None if there is none of that number."""
        rows = self._records.all(
            "SELECT stamp, payload, vector FROM keyframes LEFT JOIN vectors ON keyframe = id AND gallery = ? "
            "WHERE id = ?", gallery, number,
        )  # fmt: skip
        if not rows:
            return None
        stamp, payload, vector = rows[0]
        return Keyframe(
            number, None if vector is None else np.frombuffer(vector, dtype="<f8"), payload, stamp
        )

    def count(self, gallery: str) -> int:
        """How many keyframes a gallery has been given."""
        return int(self._records.all("SELECT count(*) FROM vectors WHERE gallery = ?", gallery)[0][0])

    def waiting(
        self, peer: str, gallery: str, besides: Iterable[bytes] = (), most: int = 1 << 30
    ) -> list[Waiting]:
        """Keyframes that are in no slot of a gallery, in the order in which they came.

        Args:
            peer: With whom.
            gallery: Its name.
            besides: Digests of vectors that a session brings already, each as often as it does.
            most: How many to look for.
        """
        rows = self._records.all(
            "SELECT keyframe, vector, digest FROM vectors WHERE gallery = ?1 AND keyframe NOT IN "
            "(SELECT keyframe FROM slots WHERE peer = ?2 AND gallery = ?1 AND keyframe IS NOT NULL) "
            "ORDER BY place LIMIT ?3", gallery, peer, most,
        )  # fmt: skip
        brought, found = Counter(besides), []
        for keyframe, vector, digest in rows:
            if brought[digest]:
                brought[digest] -= 1
                continue
            found.append(Waiting(keyframe, np.frombuffer(vector, dtype="<f8"), digest))
        return found

    def slots(self, peer: str, gallery: str) -> dict[int, int | None]:
        """Which keyframe is in which own slot, as far as it is known."""
        return dict(
            self._records.all(
                "SELECT slot, keyframe FROM slots WHERE peer = ? AND gallery = ?", peer, gallery
            )
        )

    def place(self, peer: str, gallery: str, slots: Mapping[int, bytes], lost: Iterable[int]) -> None:
        """Remember which keyframes are in new slots, by what the ledger says is in them.

        Args:
            peer: With whom.
            gallery: Its name.
            slots: New slots in ascending order, with the digests of the vectors in them.
            lost: Slots that hold nothing any more.
        """
        records = self._records
        with records.transaction():
            for slot in lost:
                records.run(
                    "DELETE FROM slots WHERE peer = ? AND gallery = ? AND slot = ?", peer, gallery, slot
                )
            if not slots:
                return
            unplaced: dict[bytes, list[int]] = {}
            for one in self.waiting(peer, gallery):
                unplaced.setdefault(one.digest, []).append(one.keyframe)
            for slot, digest in slots.items():
                keyframe = unplaced[digest].pop(0) if unplaced.get(digest) else None
                records.run("INSERT OR REPLACE INTO slots VALUES (?, ?, ?, ?)", peer, gallery, slot, keyframe)
