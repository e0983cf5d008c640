"""The MAC check: were all opened values what the dealer's MAC key says?

Every opened z comes with this party's share m_i of alpha z. With ``sigma_i = m_i - alpha_i z`` honest
parties have ``sigma_0 + sigma_1 = 0`` everywhere. Steps:

1. ``k_i = (-1)^i sigma_i``, all of them as canonical bytes: honest parties hold the same string.
2. Send ``h_i = H("mac-check", session, check number, transcript, i, k_i)``.
3. Accept if and only if the peer's message equals the same hash with 1 - i over the *own* k_i.

Cost: one round, 16 bytes, whatever was opened. Security (random-oracle model): a cheat e in an opened
value passes only if the cheater guesses alpha_i e, one in p; the hash tells it nothing else, so it can
neither learn alpha from a failed check nor echo our message back (the party number is hashed). sigma
itself is never sent: ``sigma_0 + sigma_1 = -alpha e`` would tell a cheater alpha. The functionality is
Damgard et al., "Practical covertly secure MPC for dishonest majority", ESORICS 2013, figure 8, with the
commitment replaced by the equality of hashes, which two parties allow.

There is one check at a time for all that a session has opened, never two under one alpha: see "Rushing
at SPDZ", IEEE S&P 2025.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar
from typing import Protocol as Interface

import numpy as np

from spdz.arithmetic import field
from spdz.arithmetic.weighted import bilinear
from spdz.foundations.errors import MacCheckFailed, Wrapped
from spdz.foundations.types import Block, Buffer, FieldArray
from spdz.rounds.coroutine import Check, Exchange, Post, Protocol, Take

T = TypeVar("T")


class Collapsed(Interface):
    """MAC shares of an array (R, C) of openings that are cheaper to weigh than to write out."""

    def weighed(self, u: FieldArray, v: FieldArray) -> int:
        """sum_jk u_j v_k m_jk mod p, for weights of shape (R,) and (C,)."""


ELEMENT_BYTES = 16
DIGEST_BYTES = 16
"""A hash is cut to 128 bits: as hard to guess as alpha, and nobody gains by a collision of its own making."""


class MacCheck:
    """Everything that one party has opened and not yet checked, and the transcript so far."""

    def __init__(self, alpha: int, party: int, session: bytes) -> None:
        """Args: this party's share of the MAC key, its number, and the session id."""
        self._alpha, self._party = alpha, party
        self._prefix = hashlib.sha256(b"spdz mac-check" + hashlib.sha256(session).digest())
        self._opened: list[tuple[FieldArray, FieldArray | Collapsed] | Block | bytes] = []
        self._same: bytes | None = None
        self._begun: Any = None  # what message() has hashed before i and k_i, which expected() begins with
        self._transcript = hashlib.sha256(b"spdz transcript")
        self._checks = 0
        self._failed = False

    def __repr__(self) -> str:
        return f"<MacCheck of party {self._party}: {len(self._opened)} unchecked openings>"

    @property
    def pending(self) -> bool:
        """Whether anything opened is unchecked."""
        return bool(self._opened)

    def record(self, opened: FieldArray, mac: FieldArray | Collapsed) -> None:
        """Remember an opened array and this party's MAC shares of it."""
        self._opened.append((opened, mac))
        self._same = None

    def record_same(self, count: int, same: bytes) -> None:
        """Remember the k_i of so many opened elements, which the caller has computed."""
        self._opened.append(b"elements" + count.to_bytes(8, "little") + same)
        self._same = None

    def record_bits(self, sigma: Block) -> None:
        """Remember what must be the same blocks at both parties if the bits opened are right."""
        self._opened.append(sigma)
        self._same = None

    def absorb(self, sent: Sequence[Buffer], received: Buffer) -> None:
        """Add one round to the transcript, party 0's message first."""
        self._begun = None
        if self._party == 1:
            self._transcript.update(received)
        for part in sent:
            self._transcript.update(part)
        if self._party == 0:
            self._transcript.update(received)

    def message(self) -> bytes:
        """Step 2: this party's hash. Repeating it before :meth:`verify` gives the same bytes."""
        self._begun = self._digest()
        return self._hash(self._party, self._begun.copy())

    def expected(self) -> bytes:
        """The hash that an honest peer sends."""
        begun, self._begun = self._begun, None
        return self._hash(1 - self._party, begun)

    def verify(self, received: Buffer, expected: bytes | None = None) -> None:
        """Step 3; on success everything opened so far counts as checked.

        Args:
            received: The peer's hash.
            expected: :meth:`expected`, where that was made while the peer's was on its way.

        Raises:
            MacCheckFailed: if the peer's hash is another one. The object refuses all further use.
        """
        expected = self.expected() if expected is None else expected
        if self._failed or not hmac.compare_digest(expected, received):
            self._failed = True
            raise MacCheckFailed(
                "an opened value does not carry a valid MAC: the peer cheated, or the connection was "
                "tampered with; nothing was output, and this tape must not be used again"
            )
        self._checks += 1
        self._opened.clear()
        self._same = self._begun = None

    def _hash(self, party: int, begun: Any = None) -> bytes:
        if self._same is None:
            self._same = self._same_at_both()
        digest = begun or self._digest()
        digest.update(party.to_bytes(1, "little") + self._same)
        message: bytes = digest.digest()[:DIGEST_BYTES]
        return message

    def _digest(self) -> Any:
        digest = self._prefix.copy()
        digest.update(self._checks.to_bytes(8, "little") + self._transcript.digest())
        return digest

    def _same_at_both(self) -> bytes:
        """Step 1: a digest of k_i, every opening with its kind and size."""
        digest = hashlib.sha256()
        for index, entry in enumerate(self._opened):
            if isinstance(entry, bytes):
                digest.update(entry)
                continue
            if not isinstance(entry, tuple):
                kind, count, same = b"bits", len(entry), entry.tobytes()
            elif isinstance(entry[1], np.ndarray):
                opened, mac = entry[0], entry[1]
                sigma = field.sub(mac, field.scale(opened, self._alpha))
                kind, count = b"elements", opened.size // 2
                same = (sigma if self._party == 0 else field.neg(sigma)).tobytes()
            else:
                kind, count = b"collapsed", entry[0].size // 2
                same = self._collapsed(index, entry[0], entry[1]).to_bytes(16, "little")
            digest.update(kind + count.to_bytes(8, "little") + same)
        return digest.digest()

    def _collapsed(self, index: int, opened: FieldArray, mac: Collapsed) -> int:
        """sum_jk u_j v_k sigma_jk, signed as sigma is; the weights are known only now."""
        rows, columns = opened.shape[:2]
        seed = b"spdz collapse" + self._digest().digest() + index.to_bytes(8, "little")
        stream = hashlib.shake_256(seed).digest(ELEMENT_BYTES * (rows + columns))
        weights = field.from_blocks(np.frombuffer(stream, dtype="<u8").reshape(-1, 2))
        u, v = weights[:rows], weights[rows:]
        total = (mac.weighed(u, v) - self._alpha * bilinear(u, opened, v)) % field.P
        return total if self._party == 0 else -total % field.P


def unrecorded() -> MacCheckFailed:
    """What to raise where nothing would record what is opened."""
    return MacCheckFailed("nothing is opened in the malicious mode without a check that records it")


def left_unchecked() -> MacCheckFailed:
    """What to raise where a protocol has ended and left openings unchecked."""
    return MacCheckFailed("the protocol ended with unchecked openings; nothing was output")


def _checked(
    mac_check: MacCheck, post: Callable[[Exchange], None] | None
) -> Generator[Exchange, memoryview, None]:
    """One check."""
    request = Exchange([mac_check.message()], DIGEST_BYTES, 0, is_check=True)
    _send(request, post)
    expected = mac_check.expected()
    mac_check.verify((yield request), expected)


def _send(request: Exchange, post: Callable[[Exchange], None] | None) -> None:
    if post is not None:
        post(request)
        request.is_posted = True


def drive(
    protocol: Protocol[T], mac_check: MacCheck | None, post: Callable[[Exchange], None] | None = None
) -> Generator[Exchange, memoryview, T]:
    """Turn a protocol into a sequence of frames: checks become exchanges, and rounds are transcribed.

    Args:
        protocol: The coroutine to run.
        mac_check: The session's check, or None in semi-honest mode.
        post: Sends what an exchange sends, so that the protocol goes on while it travels; without it all is
            sent when the reply is asked for.

    Raises:
        MacCheckFailed: when a check fails, or when the protocol ends with unchecked openings.
        Wrapped: when an opened number may have wrapped, and carries a valid MAC.
    """
    reply: memoryview | None = None
    posted: Exchange | None = None
    try:
        while True:
            try:
                request = protocol.send(reply)
            except Wrapped:
                if mac_check is not None and mac_check.pending:  # chance, or a lie?
                    yield from _checked(mac_check, post)
                raise
            reply = None
            if isinstance(request, Check):
                if mac_check is not None:
                    yield from _checked(mac_check, post)
                continue
            if isinstance(request, Post):
                posted = request
                _send(posted, post)
                continue
            if isinstance(request, Take):
                if posted is None:
                    raise ValueError("nothing was posted whose reply could be taken")
                request, posted = posted, None
            reply = yield request
            if mac_check is not None:
                mac_check.absorb(request.payload, reply)
    except StopIteration as done:
        if mac_check is not None and mac_check.pending:
            raise left_unchecked() from None
        result: T = done.value
        return result
    finally:
        protocol.close()
