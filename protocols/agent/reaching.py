"""How an agent meets its peers: one port for those that call, and the addresses of those that it calls."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from protocols.agent.desk import Desk
from protocols.agent.discovery import Discovery
from protocols.mission import Folder
from spdz.channels import Channel
from spdz.channels.addresses import parse_address
from spdz.channels.port import Port, dial
from spdz.foundations.errors import ChannelError, ChannelTimeout
from spdz.tape.header import Header

AUTO = "auto"
ANYWHERE = "0.0.0.0:0"
_CALL = 2.0
"""Seconds that one call may take: between calls the agent looks whether it is to end."""
_TAKE = 5.0


class Reaching:
    """Connections to all peers.

    Args:
        folder: The robot's.
        desk: The agent's.
        listen: Where to listen; the plan's address if None.
        peers: Where peers listen, in place of the plan's addresses.

    Raises:
        ValueError: for addresses of robots that are no peers, or malformed ones.
        ChannelError: if it can never be listened there.
    """

    def __init__(self, folder: Folder, desk: Desk, listen: str | None, peers: Mapping[str, str]) -> None:
        self._folder, self._desk = folder, desk
        mission, robot = folder.mission, folder.robot
        names = mission.peers(robot)
        plan = {agent.name: agent.address for agent in mission.agents}
        self._answers = {name for name in names if _answers(plan, robot, name)}
        for name, address in peers.items():
            if name not in names:
                raise ValueError(f"{name!r:.40} is no peer of {robot}; its peers are {', '.join(names)}")
            if name in self._answers:
                raise ValueError(
                    f"{name} calls {robot}, not the other way round: tell {name} where {robot} listens"
                )
            parse_address(address)
        self._addresses = {name: peers.get(name, plan[name]) for name in names}
        own = plan[robot] if listen is None else listen
        self._port: Port | None = None
        self._discovery: Discovery | None = None
        if self._answers:
            self._port = Port(
                ANYWHERE if own == AUTO else own,
                folder.path,
                sorted(self._answers),
                [gallery.name for gallery in mission.galleries],
                timeout=desk.timeout,
                on_event=lambda text: desk.tell("port", text),
            )
        announced = bool(self._answers) and plan[robot] == AUTO
        sought = [name for name in names if name not in self._answers and self._addresses[name] == AUTO]
        if announced or sought:
            try:
                self._discovery = Discovery(
                    folder.mission_id,
                    robot,
                    self._own_port(),
                    names,
                    lambda text: desk.tell("discovery", text),
                )
            except ValueError as error:
                if sought:
                    self.close()
                    raise ValueError(
                        f"{error}; or say where {sought[0]} listens: --peer {sought[0]}=HOST:PORT"
                    ) from error
                desk.tell("discovery", f"peers do not find {robot} by themselves: {error}")

    @property
    def addresses(self) -> list[str]:
        """Where this robot listens."""
        return [] if self._port is None else list(self._port.addresses)

    def of(self, peer: str, gallery: str) -> _Way:
        """How to reach one peer for one gallery."""
        return _Way(self, peer, gallery)

    def close(self) -> None:
        """Stop listening and looking."""
        for part in (self._discovery, self._port):
            if part is not None:
                part.close()

    def is_called(self, peer: str, gallery: str) -> bool:
        """Whether a peer waits with another call for a gallery."""
        return self._port is not None and peer in self._answers and self._port.is_called(peer, gallery)

    def reach(self, peer: str, gallery: str, credentials: Path) -> Channel:
        """Meet a peer, or raise ChannelTimeout after a few seconds."""
        desk = self._desk
        if self._port is not None and peer in self._answers:
            return self._port.take(peer, gallery, _TAKE, desk.stop)
        address = self._addresses[peer]
        if address != AUTO or self._discovery is None:
            return self._dial(address, credentials, peer, gallery)
        found = self._discovery.address_of(peer)
        if found is None:
            desk.stop.wait(_CALL)
            raise ChannelTimeout(f"{peer} has not been found on the local network: is its agent running?")
        try:
            return self._dial(found, credentials, peer, gallery)
        except ChannelError:
            self._discovery.failed(peer, found)
            raise

    def _dial(self, address: str, credentials: Path, peer: str, gallery: str) -> Channel:
        desk = self._desk
        return dial(address, credentials, peer, gallery, wait=_CALL, timeout=desk.timeout, stop=desk.stop)

    def _own_port(self) -> int | None:
        deadline = time.monotonic() + 1.0
        while self._port is not None and not self._port.addresses and time.monotonic() < deadline:
            time.sleep(0.01)
        addresses = self.addresses
        return int(addresses[0].rpartition(":")[2]) if addresses else None


def _answers(plan: Mapping[str, str], robot: str, peer: str) -> bool:
    """Whether a peer calls this robot: who comes first is called, unless only the second has an address."""
    order, fixed = list(plan), plan[robot] != AUTO
    if fixed == (plan[peer] != AUTO):
        return order.index(robot) < order.index(peer)
    return fixed


class _Way:
    """The way to one peer for one gallery."""

    def __init__(self, reaching: Reaching, peer: str, gallery: str) -> None:
        self._reaching, self._peer, self._gallery = reaching, peer, gallery

    def is_called(self) -> bool:
        """Whether the peer waits with another call."""
        return self._reaching.is_called(self._peer, self._gallery)

    def __call__(self, header: Header, credentials: Path) -> Channel:
        """Meet it."""
        return self._reaching.reach(self._peer, self._gallery, credentials)
