"""The handshake: do the two tapes belong together, and where do both sides start?

One exchange of a JSON object a session. Every difference is told in words, in both security modes, before
anything is consumed. The session id is a hash of both messages: nonces, mission, pair, tape, cursors and
program fingerprint.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import dataclass
from typing import Any

from spdz.foundations.errors import ProtocolViolation, TapeMismatch
from spdz.gallery.format import GalleryHeader
from spdz.tape import Tape

PROTOCOL_VERSION = 1


@dataclass(frozen=True, slots=True)
class Hello:
    """One side's message."""

    version: int
    mission: str
    tape: str
    agents: tuple[str, str]
    party: int
    security: str
    fingerprint: str
    program: dict[str, Any]
    jobs: int
    cursor: int
    nonce: str

    @classmethod
    def of(cls, tape: Tape) -> Hello:
        """What this side says of its tape."""
        header = tape.header
        return cls(
            PROTOCOL_VERSION,
            header.mission,
            header.tape,
            header.agents,
            header.party,
            header.security,
            header.fingerprint,
            dict(header.program),
            header.jobs,
            tape.cursor,
            secrets.token_hex(16),
        )

    @classmethod
    def of_gallery(cls, header: GalleryHeader) -> Hello:
        """What this side says of its gallery: its pairs are its jobs, and there is no cursor."""
        pairs = header.capacity[0] * header.capacity[1]
        return cls(
            PROTOCOL_VERSION,
            header.mission,
            header.tape,
            header.agents,
            header.party,
            header.security,
            header.fingerprint,
            {**header.program, "slots": list(header.slots)},
            pairs,
            0,
            secrets.token_hex(16),
        )

    def encode(self) -> bytes:
        """As canonical JSON."""
        return canonical({name: getattr(self, name) for name in self.__slots__})

    @classmethod
    def decode(cls, message: bytes) -> Hello:
        """Read the peer's message, which may be anything.

        Raises:
            ProtocolViolation: if it is not a well-formed greeting.
        """
        fields = read_object(message)
        if fields.get("version") != PROTOCOL_VERSION:
            raise TapeMismatch(
                f"the peer speaks protocol version {shown(fields.get('version'), 8)}, this side "
                f"{PROTOCOL_VERSION}: install the same release on both robots"
            )
        kinds: dict[str, type] = dict.fromkeys(("mission", "tape", "security", "fingerprint", "nonce"), str)
        kinds |= dict.fromkeys(("version", "party", "jobs", "cursor"), int)
        well_formed = all(type(fields.get(name)) is kind for name, kind in kinds.items())
        numbers = [fields[name] for name, kind in kinds.items() if kind is int] if well_formed else []
        well_formed = well_formed and all(0 <= number < 1 << 63 for number in numbers)
        agents, program = fields.get("agents"), fields.get("program")
        if (
            not well_formed
            or set(fields) != set(cls.__slots__)
            or not isinstance(program, dict)
            or not isinstance(agents, list)
            or [type(agent) for agent in agents] != [str, str]
        ):
            raise ProtocolViolation("the peer's greeting is malformed")
        return cls(**{**fields, "agents": (agents[0], agents[1])})


def canonical(fields: dict[str, Any]) -> bytes:
    """JSON with one spelling."""
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def read_object(message: bytes) -> dict[str, Any]:
    """Parse a peer's JSON object, with every failure a :class:`ProtocolViolation`."""
    try:
        fields = json.loads(message, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise ProtocolViolation("the peer sent a control message that is not JSON") from None
    if not isinstance(fields, dict):
        raise ProtocolViolation("the peer sent a control message that is not a JSON object")
    return fields


def _refuse(constant: str) -> None:
    raise ValueError("NaN and infinity are not JSON")


def compare(own: Hello, peer: Hello) -> None:
    """Refuse a peer whose tape does not belong to ours.

    Raises:
        TapeMismatch: naming everything that differs.
    """
    differences = [
        f"{what}: {shown(mine)} here, {shown(theirs)} there"
        for what, mine, theirs in (
            ("security", own.security, peer.security),
            ("robots", " and ".join(own.agents), " and ".join(peer.agents)),
            *(
                (name, own.program.get(name), peer.program.get(name))
                for name in sorted(own.program)
                if name != "shapes"
            ),
            ("number of jobs", own.jobs, peer.jobs),
            ("dealing run (mission)", own.mission, peer.mission),
            ("tape pair", own.tape, peer.tape),
            ("program fingerprint", own.fingerprint, peer.fingerprint),
        )
        if mine != theirs
    ]
    if own.program != peer.program and not differences:
        differences.append("other parameters of the program")
    if peer.party != 1 - own.party:
        differences.append(f"both sides hold the tape of party {own.party} ({own.agents[own.party]})")
    if differences:
        raise TapeMismatch(
            "the two tapes do not belong together (" + "; ".join(differences) + "). Give both robots the "
            "folders that one run of `python -m spdz.dealer` wrote"
        )


def session_id(own: Hello, peer: Hello) -> bytes:
    """A hash of both greetings, party 0's first."""
    first, second = sorted((own, peer), key=lambda hello: hello.party)
    return hashlib.sha256(b"spdz session" + first.encode() + b"\0" + second.encode()).digest()


def shown(value: object, length: int = 40) -> str:
    """A value from a header or a peer, fit for an error message: nothing that a terminal would obey."""
    text = "".join(character for character in str(value)[: 4 * length] if character.isprintable())
    return text if len(text) <= length else text[: length - 3] + "..."
