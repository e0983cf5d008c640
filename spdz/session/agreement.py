"""What the two sides of a session tell each other in public, and the MAC check that binds them to it.

Every control message becomes part of the session id, which every hash of the MAC check begins with
(:mod:`spdz.rounds.mac_check`). So two robots that were told different things never pass a check together.
"""

from __future__ import annotations

import hashlib
from typing import Any

from spdz.channels import Channel, FrameKind
from spdz.foundations.errors import MacCheckFailed, OutOfStep, PeerAborted, ProtocolViolation, TapeMismatch
from spdz.foundations.types import Json
from spdz.rounds.mac_check import MacCheck
from spdz.session.handshake import canonical, read_object, shown


class Agreement:
    """One side's end of the conversation.

    Args:
        channel: The connected channel.
        party: 0 or 1.
        session: The session id of the handshake.
        alpha: This party's share of the MAC key; None in semi-honest mode.

    Attributes:
        mac_check: The check for what is opened next; None in semi-honest mode, and before the first message.
    """

    def __init__(self, channel: Channel, party: int, session: bytes, alpha: int | None) -> None:
        self.mac_check: MacCheck | None = None
        self._channel, self._party, self._id, self._alpha = channel, party, session, alpha
        self._program: tuple[str, int] | None = None

    def control(self, message: dict[str, Json], *keys: str) -> dict[str, Any]:
        """Swap one JSON object; the peer's must have exactly these keys.

        Raises:
            OutOfStep: if it has others.
            PeerAborted: if it has ended (:meth:`end`).
            ProtocolViolation: if it is no JSON object.
            ChannelError: if the connection fails.
        """
        if self.mac_check is not None and self.mac_check.pending:
            raise MacCheckFailed("openings were left unchecked before a control message; nothing was output")
        own = canonical(message)
        reply = bytes(self._channel.exchange(FrameKind.CONTROL, [own], None))
        first, second = (own, reply) if self._party == 0 else (reply, own)
        texts = b"".join(hashlib.sha256(text).digest() for text in (first, second))
        self._id = hashlib.sha256(b"spdz agreement" + self._id + texts).digest()
        if self._alpha is not None:
            self.mac_check = MacCheck(self._alpha, self._party, self._id)
        fields = read_object(reply)
        if "end" in fields and "end" not in keys:
            raise PeerAborted("the other robot has ended: it makes no further step")
        if set(fields) != set(keys):
            raise OutOfStep(
                "the peer is at another step: both robots must make the same calls in the same order"
            )
        return fields

    def end(self, number: int) -> dict[str, Any]:
        """Tell the peer that nothing more comes after so many steps, and be told the same."""
        return self.control({"end": number}, "end")

    def note(self, note: dict[str, Json]) -> dict[str, Any]:
        """Swap one small JSON object of the caller's."""
        answer = self.control({"note": note}, "note")["note"]
        if not isinstance(answer, dict):
            raise ProtocolViolation("the peer's note is not a JSON object")
        return answer

    def program(self, text: str, jobs: int, program: object) -> None:
        """Agree on the program with its public constants, whenever they change.

        Args:
            text: The plan's fingerprint of it.
            jobs: How many of its jobs run next.
            program: What an error message calls by its name.

        Raises:
            TapeMismatch: if the peer runs something else.
        """
        call = (text, jobs)
        if call == self._program:
            return
        title = str(getattr(program, "__name__", program))
        peer = self.control({"text": text, "jobs": jobs, "title": title[:120]}, "text", "jobs", "title")
        if (peer["text"], str(peer["jobs"])) != (text, str(jobs)):
            raise TapeMismatch(
                f"the peer runs something else: {jobs} x {title[:120]} here, {shown(peer['jobs'], 8)} x "
                f"{shown(peer['title'], 120)} there; give both robots the same threshold and program"
            )
        self._program = call
