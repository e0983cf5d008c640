"""Finding peers on the local network by multicast DNS (RFC 6762, 6763), with the package ``zeroconf``.

A robot announces ``_spdz._tcp.local.`` with the mission's id and its own name, and collects what others of
the same mission announce. None of that is protected: whoever is on the network can read it, and can announce
any name. So an address is a hint: TLS decides who is there (:mod:`spdz.channels.port`), and an address that
turns out wrong falls behind the others (:mod:`protocols.agent.sightings`).

A thread of its own does everything, so that neither a network that is missing nor one that floods delays
anybody. When an interface comes, goes or gets another address, all is announced anew.
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any

from protocols.agent.sightings import Sightings
from spdz.channels.telling import Teller, harmless, ignore
from spdz.session.handshake import PROTOCOL_VERSION

SERVICE = "_spdz._tcp.local."
_LOOK_SECONDS = 5.0
"""How often the interfaces are looked at, and the pause after a failure."""
_ASK_MILLISECONDS = 500
"""How long an announcement that came without its address is asked about."""
_QUESTIONS = 16
"""Security limit: announcements that wait to be asked about; one more, and the oldest is forgotten."""
_END_SECONDS = 2.0
_AGAIN = 60.0
"""Seconds before a peer that seems to move is told of again."""
_LOOPBACK = 3
_MISSION_ID = re.compile("[0-9a-f]{1,64}")


class Discovery:
    """Announces this robot and looks for its peers.

    Args:
        mission_id: Id of the dealing run, in hexadecimal digits; announcements of others are ignored.
        robot: This robot's name.
        port: What it listens on, at every address; None announces nothing.
        peers: Names of the robots to look for.
        on_event: Called with a sentence when a peer is found, and when the reason changes why nobody can be.
            By the discovery's thread, which waits for it meanwhile.
        interfaces: Addresses of the interfaces to use; all of them if None.

    Raises:
        ValueError: if an argument is malformed, or the package ``zeroconf`` is not installed.
    """

    def __init__(
        self,
        mission_id: str,
        robot: str,
        port: int | None,
        peers: Collection[str],
        on_event: Callable[[str], None] = ignore,
        *,
        interfaces: Sequence[str] | None = None,
    ) -> None:
        if not _MISSION_ID.fullmatch(mission_id):
            raise ValueError(f"a mission's id is 1 to 64 lower-case hexadecimal digits, not {mission_id!r}")
        if port is not None and not 1 <= port <= 65535:
            raise ValueError(f"a port to announce is 1 to 65535, not {port!r}")
        self._zeroconf, self._ifaddr = _libraries()
        self._mission, self._robot, self._port, self._interfaces = mission_id, robot, port, interfaces
        self._peers = frozenset(peers) - {robot}
        self._sightings = Sightings(self._peers)
        self._on_event = harmless(on_event)
        self._teller = Teller(self._on_event, _AGAIN)
        self._told: dict[str, tuple[str, float]] = {}  # by peer: which address, and when
        self._questions: deque[str] = deque(maxlen=_QUESTIONS)
        self._closing, self._news = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"discovery of {robot}", daemon=True)
        self._thread.start()

    def address_of(self, peer: str) -> str | None:
        """Where to try to reach a peer next, as ``host:port``; None if nobody has said.

        Raises:
            ValueError: if it is not one of the peers.
        """
        self._require(peer)
        return self._sightings.first(peer)

    def failed(self, peer: str, address: str) -> None:
        """Note that a peer was not behind an address: :meth:`address_of` gives the others first.

        Raises:
            ValueError: if it is not one of the peers.
        """
        self._require(peer)
        self._sightings.failed(peer, address)

    def close(self) -> None:
        """Withdraw the announcement and stop looking; safe to call twice. What was found stays known."""
        self._closing.set()
        self._news.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(_END_SECONDS)

    def _require(self, peer: str) -> None:
        if peer not in self._peers:
            raise ValueError(f"{peer!r} is no robot that is looked for: {', '.join(sorted(self._peers))}")

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                self._look()
            except Exception as error:  # no network, say: the library has errors of many kinds
                why = str(error) or type(error).__name__
                self._teller.tell(
                    "cannot look for robots on the local network yet", f" ({why}); trying again"
                )
                self._closing.wait(_LOOK_SECONDS)

    def _look(self) -> None:
        """Announce and browse until this machine has other addresses."""
        own = self._own_addresses()
        with contextlib.closing(self._open()) as network:
            if self._port is not None:
                network.register_service(self._announcement(own), cooperating_responders=True)
            self._zeroconf.ServiceBrowser(network, SERVICE, handlers=[self._heard])
            self._teller.tell(f"looking on the local network for {', '.join(sorted(map(repr, self._peers)))}")
            until = time.monotonic() + _LOOK_SECONDS
            while not self._closing.is_set():
                self._news.wait(max(0.0, until - time.monotonic()))
                self._news.clear()
                self._ask(network)
                self._tell_who_was_found()
                if time.monotonic() >= until:
                    until = time.monotonic() + _LOOK_SECONDS
                    if self._own_addresses() != own:
                        return

    def _open(self) -> Any:
        versions, network = self._zeroconf.IPVersion, self._zeroconf.Zeroconf
        if self._interfaces is not None:
            return network(interfaces=list(self._interfaces))
        try:
            return network(ip_version=versions.All)
        except OSError:  # IPv6 is switched off
            return network(ip_version=versions.V4Only)

    def _own_addresses(self) -> list[str]:
        """What to announce, the best first; the loopback address where there is nothing else."""
        if self._interfaces is not None:
            return list(self._interfaces)
        adapters = self._ifaddr.get_adapters()
        found = {ip.ip if ip.is_IPv4 else ip.ip[0] for adapter in adapters for ip in adapter.ips}
        ordered = sorted(
            {str(address).partition("%")[0] for address in found}, key=lambda text: (_rank(text), text)
        )
        return [text for text in ordered if _rank(text) < _LOOPBACK] or ordered

    def _announcement(self, addresses: Sequence[str]) -> Any:
        label = f"{self._robot}-{self._mission[:8]}"
        return self._zeroconf.ServiceInfo(
            SERVICE,
            f"{label}.{SERVICE}",
            port=self._port,
            properties={"mission": self._mission, "robot": self._robot, "version": str(PROTOCOL_VERSION)},
            server=f"{label}.local.",
            parsed_addresses=list(addresses),
        )

    def _heard(self, *, zeroconf: Any, service_type: str, name: str, state_change: Any) -> None:
        """Called by a thread of the library, which whatever a stranger announces must not end."""
        with contextlib.suppress(Exception):
            if state_change is self._zeroconf.ServiceStateChange.Removed:
                self._sightings.gone(name)
                return
            info = self._zeroconf.ServiceInfo(service_type, name)
            if info.load_from_cache(zeroconf):  # an announcement brings everything along
                self._note(info)
            else:
                self._questions.append(name)
            self._news.set()

    def _ask(self, network: Any) -> None:
        while self._questions and not self._closing.is_set():
            with contextlib.suppress(Exception):  # as in _heard
                info = network.get_service_info(SERVICE, self._questions.popleft(), _ASK_MILLISECONDS)
                if info is not None:
                    self._note(info)

    def _note(self, info: Any) -> None:
        """Remember where a peer is said to be; ignores all others, and other missions."""
        properties = info.properties
        peer = (properties.get(b"robot") or b"").decode("ascii", "replace")
        if properties.get(b"mission") != self._mission.encode() or peer not in self._peers:
            return
        addresses = [text for text in info.parsed_scoped_addresses() if _rank(text) <= _LOOPBACK]
        where = [f"[{text}]" if ":" in text else text for text in sorted(addresses, key=_rank)]
        if info.port:
            self._sightings.seen(peer, info.name, [f"{host}:{info.port}" for host in where])

    def _tell_who_was_found(self) -> None:
        now = time.monotonic()
        for peer in sorted(self._peers):
            address = self._sightings.first(peer)
            told, when = self._told.get(peer, ("", -math.inf))
            if address is not None and address != told and now >= when + _AGAIN:
                self._told[peer] = (address, now)
                self._on_event(f"{peer} is announced at {address} on the local network")


def _rank(address: str) -> int:
    """The order in which kinds of addresses are tried; those above _LOOPBACK are nobody's."""
    parsed = ipaddress.ip_address(address.partition("%")[0])
    if parsed.is_multicast or parsed.is_unspecified:
        return _LOOPBACK + 1
    if parsed.is_loopback:
        return _LOOPBACK
    return 2 if parsed.is_link_local else int(parsed.version == 6)


def _libraries() -> tuple[Any, Any]:
    """The package zeroconf, and ifaddr, which it depends on.

    Raises:
        ValueError: if it is not installed.
    """
    try:
        import ifaddr
        import zeroconf
    except ImportError as error:
        raise ValueError(
            "finding robots on the local network takes the package zeroconf, which is missing: "
            "pip install zeroconf, or give the robots' addresses"
        ) from error
    # Without a handler of the program's, Python writes what zeroconf logs to the terminal, tracebacks too.
    logging.getLogger("zeroconf").addHandler(logging.NullHandler())
    return zeroconf, ifaddr
