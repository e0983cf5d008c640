"""Who is on a mission, who meets whom, and what a robot grants each of its peers."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from itertools import combinations

from protocols.mission.fields import Table, nearest, shown
from spdz.channels.addresses import parse_address

AUTO = "auto"
"""The address of a robot that the others find on the local network."""

MOST_AGENTS = 1000
_MOST_ID = (1 << 32) - 1  # robot_id is a uint32 in Swarm-SLAM's messages
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,30}")
_EVERYWHERE = ("0.0.0.0", "::")
_MOST_A_MINUTE = 1 << 40


@dataclass(frozen=True, slots=True)
class AgentPlan:
    """One robot.

    Attributes:
        name: Its name, also in its certificate.
        id: The integer that SLAM stacks know it by.
        address: ``host:port`` at which the others reach its one port, or ``auto``.
    """

    name: str
    id: int
    address: str = AUTO

    def as_json(self) -> dict[str, str | int]:
        """As in the file."""
        return {"name": self.name, "id": self.id, "address": self.address}


@dataclass(frozen=True, slots=True)
class Budgets:
    """What a robot grants one peer.

    Attributes:
        strikes: Matches that the peer does not follow with a payload that verifies, before it is refused.
        pairs_per_minute: Pairs of descriptors compared in a minute.
        matches_per_minute: Matches followed up in a minute.
    """

    strikes: int = 3
    pairs_per_minute: int = 1_000_000
    matches_per_minute: int = 60

    def as_json(self) -> dict[str, int]:
        """As in the file."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


def read_agents(root: Table) -> tuple[AgentPlan, ...]:
    """The robots, in the order of the file: the one named first is a pair's party 0.

    Raises:
        PlanError: for fewer than two, or what no robot can have.
    """
    agents: list[AgentPlan] = []
    for number, table in enumerate(root.tables("agents")):
        table.only("name", "id", "address")
        name = table.text("name")
        if not _NAME.fullmatch(name):
            raise table.error(
                "a robot's name is 1 to 31 letters, digits, '_' and '-', the first a letter or a digit, not "
                f"{shown(name)}",
                "name",
            )
        agent = AgentPlan(name, table.whole("id", 0, _MOST_ID, number), table.text("address", AUTO))
        _check_address(table, agent.address)
        for other in agents:
            if other.name.lower() == name.lower():
                raise table.error(f"there is a robot {other.name!r} already (case does not count)", "name")
            if other.id == agent.id:
                raise table.error(
                    f"{other.name} has the id {other.id} already: give every robot its own", "id"
                )
            if other.address == agent.address != AUTO:
                raise table.error(f"{other.name} listens at {other.address} already", "address")
        agents.append(agent)
    if not 2 <= len(agents) <= MOST_AGENTS:
        raise root.error(f"a mission has 2 to {MOST_AGENTS} robots, each under [[agents]], not {len(agents)}")
    return tuple(agents)


def read_pairs(root: Table, agents: tuple[AgentPlan, ...]) -> tuple[tuple[str, str], ...]:
    """Who meets whom: all pairs if the file does not say, each with its party 0 first.

    Raises:
        PlanError: for unknown robots, repeated pairs, and robots that meet nobody.
    """
    names = [agent.name for agent in agents]
    every = tuple(combinations(names, 2))
    if "pairs" not in root:
        return every
    chosen: set[tuple[str, str]] = set()
    listed = root.values["pairs"]
    if not isinstance(listed, list):
        raise root.error(
            f'expected a list such as [["{names[0]}", "{names[1]}"]], not {shown(listed)}', "pairs"
        )
    for number, couple in enumerate(listed):
        if (
            not isinstance(couple, list)
            or len(couple) != 2
            or not all(isinstance(one, str) for one in couple)
        ):
            raise root.error(f"expected two names in quotes, not {shown(couple)}", "pairs", number)
        for name in couple:
            if name not in names:
                raise root.error(f"no robot is called {shown(name)}; {nearest(name, names)}", "pairs", number)
        first, second = sorted(couple, key=names.index)
        if first == second:
            raise root.error(f"{first} does not meet itself", "pairs", number)
        if (first, second) in chosen:
            raise root.error(f"{first} and {second} are a pair already", "pairs", number)
        chosen.add((first, second))
    for name in names:
        if not any(name in couple for couple in chosen):
            raise root.error(f"{name} meets nobody: add a pair, or leave the robot out", "pairs")
    return tuple(couple for couple in every if couple in chosen)


def read_budgets(root: Table) -> Budgets:
    """The budgets; those that the file leaves out are the usual ones."""
    table, usual = root.table("budgets"), Budgets()
    table.only(*(one.name for one in fields(usual)))
    return Budgets(
        strikes=table.whole("strikes", 1, 1000, usual.strikes),
        pairs_per_minute=table.whole("pairs_per_minute", 1, _MOST_A_MINUTE, usual.pairs_per_minute),
        matches_per_minute=table.whole("matches_per_minute", 1, _MOST_A_MINUTE, usual.matches_per_minute),
    )


def _check_address(table: Table, address: str) -> None:
    if address == AUTO:
        return
    try:
        host, port = parse_address(address)
    except ValueError as error:
        raise table.error(f'{error}; or "{AUTO}", to be found on the local network', "address") from error
    if not port:
        raise table.error(f"give the port that the others call, 1 to 65535, not {shown(address)}", "address")
    if host in _EVERYWHERE:
        raise table.error(
            f"the others cannot call {host}: give the address at which they reach this robot", "address"
        )
