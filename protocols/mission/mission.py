"""A mission's plan as one object: read from a file, checked, and written down again the same everywhere."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from protocols.mission.descriptors import DescriptorPlan, read_descriptors
from protocols.mission.errors import PlanError
from protocols.mission.fields import Table, nearest
from protocols.mission.galleries import GalleryPlan, places_as_json, read_galleries
from protocols.mission.source import Source, read_toml
from protocols.mission.team import AgentPlan, Budgets, read_agents, read_budgets, read_pairs
from spdz.foundations.types import SECURITIES, Json, Security

T = TypeVar("T")

_LONGEST_NAME = 64
_FIELDS = ("name", "security", "pairs", "agents", "descriptors", "places", "budgets")


@dataclass(frozen=True, slots=True)
class Mission:
    """A mission.

    Attributes:
        name: For people; may be empty.
        security: The security model of everything.
        agents: The robots; of a pair the one that comes first is party 0.
        descriptors: All descriptors.
        galleries: What is dealt once a pair: the descriptors in no place, and the places.
        pairs: Who meets whom, party 0 first.
        budgets: What a robot grants each of its peers.
    """

    name: str
    security: Security
    agents: tuple[AgentPlan, ...]
    descriptors: tuple[DescriptorPlan, ...]
    galleries: tuple[GalleryPlan, ...]
    pairs: tuple[tuple[str, str], ...]
    budgets: Budgets

    @classmethod
    def load(cls, path: str | Path) -> Mission:
        """Read ``mission.toml``.

        Raises:
            PlanError: naming file, line, field, what came and what is allowed.
        """
        values, source = read_toml(Path(path))
        return _read(Table(source, (), values))

    @classmethod
    def from_json(cls, values: Json, file: str = "") -> Mission:
        """Read what :meth:`as_json` gave.

        Args:
            values: The object.
            file: Where it comes from, for messages.

        Raises:
            PlanError: if it is no mission.
        """
        if not isinstance(values, dict):
            raise PlanError("expected a mission as a JSON object", file=file)
        return _read(Table(Source(file), (), values))

    def as_json(self) -> dict[str, Json]:
        """Every field, as in the file; always in the same order."""
        return {
            "name": self.name,
            "security": self.security,
            "pairs": [list(couple) for couple in self.pairs],
            "agents": [agent.as_json() for agent in self.agents],
            "descriptors": {one.name: one.as_json() for one in self.descriptors},
            "places": places_as_json(self.galleries),
            "budgets": self.budgets.as_json(),
        }

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, as hex: two plans that mean the same have the same."""
        return hashlib.sha256(canonical(self.as_json())).hexdigest()

    def peers(self, name: str) -> list[str]:
        """Whom a robot meets, in the plan's order.

        Raises:
            ValueError: if there is no such robot.
        """
        self.agent(name)
        others = {one for couple in self.pairs if name in couple for one in couple} - {name}
        return [agent.name for agent in self.agents if agent.name in others]

    def agent(self, name: str) -> AgentPlan:
        """A robot by its name.

        Raises:
            ValueError: if there is none.
        """
        return _by_name("robot", name, {one.name: one for one in self.agents})

    def descriptor(self, name: str) -> DescriptorPlan:
        """A descriptor by its name.

        Raises:
            ValueError: if there is none.
        """
        return _by_name("descriptor", name, {one.name: one for one in self.descriptors})

    def gallery(self, name: str) -> GalleryPlan:
        """A gallery by its name.

        Raises:
            ValueError: if there is none.
        """
        return _by_name("gallery", name, {one.name: one for one in self.galleries})


def canonical(values: Json) -> bytes:
    """JSON in one spelling: no spaces, ASCII, the fields in the order that they have."""
    return json.dumps(values, separators=(",", ":"), allow_nan=False).encode()


def _by_name(what: str, name: str, known: Mapping[str, T]) -> T:
    if name not in known:
        raise ValueError(f"the plan has no {what} {name!r}; {nearest(name, list(known))}")
    return known[name]


def _read(root: Table) -> Mission:
    root.only(*_FIELDS)
    name = root.text("name", "")
    if len(name) > _LONGEST_NAME or not name.isprintable():
        raise root.error(f"a mission's name has at most {_LONGEST_NAME} printable characters", "name")
    security: Any = root.choice("security", SECURITIES, "malicious")
    agents = read_agents(root)
    names = [agent.name for agent in agents]
    descriptors = read_descriptors(root, names)
    return Mission(
        name=name,
        security=security,
        agents=agents,
        descriptors=descriptors,
        galleries=read_galleries(root, descriptors, names),
        pairs=read_pairs(root, agents),
        budgets=read_budgets(root),
    )
