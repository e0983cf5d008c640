"""What every tape says of itself: whose it is, what it is for, and how it was dealt."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

from spdz.foundations.types import Json, Security

_HEX = re.compile(r"[0-9a-f]{1,128}")


@dataclass(frozen=True, slots=True)
class Header:
    """The part of a header that tapes of every kind have: public, unchanging, checked in the handshake.

    Attributes:
        mission: Lower-case hex id of the dealing run.
        tape: Lower-case hex id shared by the two tapes of this pair.
        agents: Names of party 0 and party 1.
        party: 0 or 1: whose tape this is.
        security: The security model it was dealt for.
        fingerprint: Hex; what the meter saw of the program.
        program: The program's public parameters, as JSON.

    Raises:
        ValueError: A field is out of range or of the wrong type.
    """

    mission: str
    tape: str
    agents: tuple[str, str]
    party: int
    security: Security
    fingerprint: str
    program: Mapping[str, Json]

    def __post_init__(self) -> None:
        for name in ("mission", "tape", "fingerprint"):
            value = getattr(self, name)
            if not isinstance(value, str) or not _HEX.fullmatch(value):
                raise ValueError(f"{name} must be 1 to 128 lower-case hexadecimal digits, not {value!r}")
        check_integer("party", self.party, 0, 1)
        if self.security not in get_args(Security):
            raise ValueError(f"security must be one of {get_args(Security)}, not {self.security!r}")
        agents = tuple(self.agents)
        if len(agents) != 2 or agents[0] == agents[1]:
            raise ValueError(f"agents must be two different names, not {self.agents!r}")
        if not all(isinstance(name, str) and name and name.isprintable() for name in agents):
            raise ValueError(f"agents must be printable names, not {self.agents!r}")
        try:
            program = json.loads(json.dumps(self.program, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise ValueError(f"program must be JSON: {error}") from error
        if not isinstance(program, dict):
            raise ValueError(f"program must be a JSON object, not {self.program!r}")
        object.__setattr__(self, "agents", agents)
        object.__setattr__(self, "program", program)  # as it will be read back: tuples are lists

    @property
    def name(self) -> str:
        """The robot whose tape this is."""
        return self.agents[self.party]

    @property
    def peer(self) -> str:
        """The robot that has the other tape."""
        return self.agents[1 - self.party]

    def dealing(self, *options: str) -> str:
        """The dealer's command for these robots, with those of the program's parameters among ``options``."""
        words = [f"python -m spdz.dealer --agents {shlex.join(self.agents)}"]
        for key, value in self.program.items():
            if key in options:
                text = "x".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                words.append(f"--{key.replace('_', '-')} {shlex.quote(text)}")
        return f"{' '.join(words)} --security {self.security}"


def check_integer(name: str, value: object, least: int, most: int) -> None:
    """Refuse a header's field that is no integer, or out of range.

    Raises:
        ValueError: naming it.
    """
    if type(value) is not int or not least <= value <= most:
        raise ValueError(f"{name} must be an integer from {least} to {most}, not {value!r}")
