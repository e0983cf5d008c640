"""Robots find each other on the local network; one that lies, floods or is not there harms nobody."""

import builtins
import enum
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from channel_helpers import LONG
from port_helpers import until

from protocols.agent import discovery
from protocols.agent.discovery import SERVICE, Discovery

MISSION = "0a1b" * 8


# --- a network that the test plays


class State(enum.Enum):
    Added, Removed, Updated = range(3)


class Info:
    """A service as the library has it: ``known`` stands for what came with the announcement."""

    def __init__(self, service, name, *, port=0, properties=None, server="", parsed_addresses=()):
        if not name.endswith(service):
            raise RuntimeError("no such type")
        self.name, self.port, self.server, self.addresses = name, port, server, list(parsed_addresses)
        self.properties = {
            key.encode(): value if isinstance(value, bytes) else value.encode()
            for key, value in (properties or {}).items()
        }

    def parsed_scoped_addresses(self):
        return self.addresses

    def load_from_cache(self, network):
        known = network.known.get(self.name)
        if known is not None:
            self.__dict__ |= known.__dict__
        return known is not None


class Network:
    """Takes the place of the library's ``Zeroconf``, browser included; what it lacks, nobody may use."""

    fails = ()
    opened = ()

    def __init__(self, *, interfaces=None, ip_version=None):
        if Network.fails:
            raise Network.fails.pop(0)
        self.interfaces, self.ip_version = interfaces, ip_version
        self.known, self.asked, self.announced, self.closed = {}, {}, [], False
        self.questions = []
        Network.opened.append(self)

    def register_service(self, info, *, cooperating_responders):
        assert cooperating_responders
        self.announced.append(info)

    def get_service_info(self, service, name, milliseconds):
        self.questions.append(name)
        return self.asked.get(name)

    def close(self):
        self.closed = True

    def browse(self, handlers):
        (self.handler,) = handlers

    def tell(self, name, state):
        self.handler(zeroconf=self, service_type=SERVICE, name=name, state_change=state)

    def announce(self, robot="bob", addresses=("10.0.0.2",), *, port=9000, mission=MISSION, name=None):
        """Somebody announces a robot; returns the name under which it is announced."""
        name = f"{name or robot}.{SERVICE}"
        properties = {"mission": mission, "robot": robot, "version": "1"}
        state = State.Updated if name in self.known else State.Added
        self.known[name] = Info(SERVICE, name, port=port, properties=properties, parsed_addresses=addresses)
        self.tell(name, state)
        return name


def adapters(*addresses):
    """What the system has, as the library tells it."""
    return [
        SimpleNamespace(
            ips=[
                SimpleNamespace(is_IPv4=":" not in a, ip=a if ":" not in a else (a, 0, 0)) for a in addresses
            ]
        )
    ]


@pytest.fixture
def network(monkeypatch):
    """A played network; ``network.adapters`` is what this machine has."""
    Network.fails, Network.opened = [], []
    here = SimpleNamespace(
        adapters=adapters("10.0.0.1", "127.0.0.1"), opened=Network.opened, fails=Network.fails
    )
    library = SimpleNamespace(
        Zeroconf=Network,
        ServiceInfo=Info,
        ServiceBrowser=lambda network, service, *, handlers: network.browse(handlers),
        ServiceStateChange=State,
        IPVersion=SimpleNamespace(All="all", V4Only="v4"),
    )
    monkeypatch.setattr(
        discovery, "_libraries", lambda: (library, SimpleNamespace(get_adapters=lambda: here.adapters))
    )
    monkeypatch.setattr(discovery, "_LOOK_SECONDS", 0.02)
    return here


@pytest.fixture
def start(network):
    """Starts alice's discovery on it; returns it and the network that it opened."""
    started = []

    def begin(*, port=8000, **options):
        started.append(Discovery(MISSION, "alice", port, ["bob", "carol", "alice"], **options))
        until(lambda: network.opened and hasattr(network.opened[-1], "handler"))
        return started[-1], network.opened[-1]

    yield begin
    for one in started:
        one.close()
        assert not one._thread.is_alive()


def test_a_robot_announces_its_name_its_mission_and_where_it_listens(network, start):
    network.adapters = adapters("fe80::1%3", "127.0.0.1", "fd00::1", "::1", "10.0.0.1")
    _, opened = start()
    (info,) = opened.announced
    assert info.name == f"alice-0a1b0a1b.{SERVICE}"
    assert info.port == 8000
    assert info.properties == {b"mission": MISSION.encode(), b"robot": b"alice", b"version": b"1"}
    assert info.addresses == ["10.0.0.1", "fd00::1", "fe80::1"]
    assert opened.ip_version == "all"


def test_without_a_network_the_loopback_address_is_announced(network, start):
    network.adapters = adapters("::1", "127.0.0.1")
    assert start()[1].announced[0].addresses == ["127.0.0.1", "::1"]


def test_a_robot_that_does_not_listen_announces_nothing(start):
    assert start(port=None)[1].announced == []


def test_only_the_interfaces_that_are_given_are_used(start):
    _, opened = start(interfaces=["10.0.0.7"])
    assert (opened.interfaces, opened.announced[0].addresses) == (["10.0.0.7"], ["10.0.0.7"])


def test_a_peer_is_found_where_it_is_announced(start):
    one, opened = start()
    assert one.address_of("bob") is None
    opened.announce("bob", ["fe80::2%eth0", "127.0.0.1", "fd00::2", "10.0.0.2", "224.0.0.1", "0.0.0.0"])
    found = []
    while (address := one.address_of("bob")) not in found:
        found.append(address)
        one.failed("bob", address)
    assert found == ["10.0.0.2:9000", "[fd00::2]:9000", "[fe80::2%eth0]:9000", "127.0.0.1:9000"]
    assert one.address_of("carol") is None


@pytest.mark.parametrize(
    "other",
    [
        {"mission": "ffff" * 8},
        {"mission": ""},
        {"robot": "dave"},
        {"robot": "alice"},
        {"robot": "BOB"},
        {"port": 0},
        {"addresses": []},
        {"addresses": ["nonsense"]},
    ],
)
def test_what_is_not_about_a_peer_of_this_mission_is_ignored(start, other):
    one, opened = start()
    opened.announce(**other)
    opened.announce("carol")
    assert one.address_of("bob") is None and one.address_of("carol") == "10.0.0.2:9000"


@pytest.mark.parametrize(
    "properties", [{}, {"mission": b"\xff" * 32, "robot": b"\xff"}, {"mission": MISSION}]
)
def test_an_announcement_without_sense_is_ignored(start, properties):
    one, opened = start()
    name = f"bob.{SERVICE}"
    opened.known[name] = Info(SERVICE, name, port=1, properties=properties, parsed_addresses=["10.0.0.2"])
    opened.tell(name, State.Added)
    opened.tell("no such type", State.Added)
    opened.announce("bob", ["10.0.0.3"], name="another")
    assert one.address_of("bob") == "10.0.0.3:9000"


def test_a_stranger_with_a_peers_name_does_not_hide_the_peer(start):
    one, opened = start()
    opened.announce("bob", ["10.0.0.66"], name="stranger")
    opened.announce("bob", ["10.0.0.2"])
    assert one.address_of("bob") == "10.0.0.66:9000"
    one.failed("bob", "10.0.0.66:9000")
    assert one.address_of("bob") == "10.0.0.2:9000"
    opened.announce("bob", ["10.0.0.67"], name="stranger")
    assert one.address_of("bob") == "10.0.0.2:9000"


def test_an_address_that_changed_is_followed(start):
    one, opened = start()
    opened.announce("bob", ["10.0.0.2"])
    opened.announce("bob", ["10.0.0.3", "10.0.0.2"])
    assert one.address_of("bob") == "10.0.0.3:9000"


def test_a_peer_that_is_withdrawn_is_still_tried_after_the_others(start):
    one, opened = start()
    name = opened.announce("bob", ["10.0.0.2"])
    opened.announce("bob", ["10.0.0.3"], name="again")
    opened.tell(name, State.Removed)
    assert one.address_of("bob") == "10.0.0.3:9000"
    one.failed("bob", "10.0.0.3:9000")
    assert one.address_of("bob") == "10.0.0.2:9000"


def test_an_announcement_without_its_address_is_asked_about(start):
    one, opened = start()
    name = f"bob.{SERVICE}"
    properties = {"mission": MISSION, "robot": "bob"}
    opened.asked[name] = Info(SERVICE, name, port=9, properties=properties, parsed_addresses=["10.0.0.2"])
    opened.tell(f"silent.{SERVICE}", State.Added)
    opened.tell(name, State.Added)
    until(lambda: one.address_of("bob") == "10.0.0.2:9")


@pytest.mark.parametrize("wrong", [{"robot": "dave"}, {"robot": "bob", "addresses": ["nonsense"]}, None])
def test_an_answer_without_sense_ends_nothing(network, start, wrong):
    one, opened = start()

    def answer(service, name, milliseconds):
        if wrong is None:
            raise RuntimeError("a name that the library refuses")
        opened.questions.append(name)
        properties = {"mission": MISSION, "robot": wrong["robot"]}
        addresses = wrong.get("addresses", ["10.0.0.2"])
        return Info(SERVICE, name, port=9, properties=properties, parsed_addresses=addresses)

    opened.get_service_info = answer
    opened.tell(f"odd.{SERVICE}", State.Added)
    until(lambda: not one._questions)
    time.sleep(0.05)
    assert len(network.opened) == 1 and not opened.closed


def test_a_flood_of_empty_announcements_is_asked_about_a_few_times_and_hides_nobody(start):
    one, opened = start()
    entered, leave = threading.Event(), threading.Event()

    def slow(service, name, milliseconds):
        opened.questions.append(name)
        entered.set()
        leave.wait(LONG)

    opened.get_service_info = slow
    opened.tell(f"first.{SERVICE}", State.Added)
    assert entered.wait(LONG)
    for k in range(1000):
        opened.tell(f"flood {k}.{SERVICE}", State.Added)
    opened.announce("bob")
    assert one.address_of("bob") == "10.0.0.2:9000"
    leave.set()
    until(lambda: not one._questions)
    assert len(opened.questions) <= 1 + discovery._QUESTIONS


# --- what is told


def test_a_peer_is_told_of_once(start, monkeypatch):
    told = []
    _, opened = start(on_event=told.append)
    for k in range(50):
        opened.announce("bob", [f"10.0.0.{2 + k % 3}"])
        time.sleep(0.001)
    until(lambda: len(told) == 2)
    time.sleep(0.05)
    assert told[0] == "looking on the local network for 'bob', 'carol'"
    assert len(told) == 2 and told[1].startswith("bob is announced at 10.0.0.")


def test_a_peer_that_moved_is_told_of_later(start, monkeypatch):
    monkeypatch.setattr(discovery, "_AGAIN", 0.05)
    told = []
    _, opened = start(on_event=told.append)
    for address in ("10.0.0.2", "10.0.0.3"):
        opened.announce("bob", [address])
        until(lambda address=address: f"bob is announced at {address}:9000 on the local network" in told)


# --- a network that is not there


def test_a_network_that_is_not_there_is_tried_again_and_told_once(network):
    told = []
    network.fails += [error(19, "No such device") for error in (OSError, RuntimeError) for _ in range(4)]
    one = Discovery(MISSION, "alice", 1, ["bob"], told.append)
    until(lambda: network.opened and hasattr(network.opened[-1], "handler"))
    one.close()
    assert told[0] == (
        "cannot look for robots on the local network yet ([Errno 19] No such device); trying again"
    )
    assert len([text for text in told if text.startswith("cannot look")]) == 1
    assert told[-1].startswith("looking ")


def test_without_ipv6_there_is_ipv4(network, start):
    network.fails.append(OSError(97, "Address family not supported by protocol"))
    _, opened = start()
    assert opened.ip_version == "v4"


def test_another_address_of_this_machine_is_announced_anew(network, start):
    one, opened = start()
    opened.announce("bob")
    network.adapters = adapters("10.0.5.1")
    until(lambda: len(network.opened) == 2 and network.opened[1].announced)
    assert opened.closed and network.opened[1].announced[0].addresses == ["10.0.5.1"]
    assert one.address_of("bob") == "10.0.0.2:9000"


def test_an_error_of_whoever_is_told_ends_nothing(start):
    def broken(text):
        raise RuntimeError(text)

    one, opened = start(on_event=broken)
    opened.announce("bob")
    time.sleep(0.05)
    assert one._thread.is_alive() and not opened.closed


def test_closing_withdraws_the_announcement_and_keeps_what_was_found(start):
    one, opened = start()
    opened.announce("bob")
    one.close()
    one.close()
    assert opened.closed and not one._thread.is_alive()
    assert one.address_of("bob") == "10.0.0.2:9000"


def test_closing_does_not_wait_for_the_next_look(monkeypatch, start):
    monkeypatch.setattr(discovery, "_LOOK_SECONDS", 10 * LONG)
    one, _ = start()
    one.close()
    assert not one._thread.is_alive()


# --- arguments


def test_a_missing_library_is_told_with_the_command_that_installs_it(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "zeroconf":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.delitem(sys.modules, "zeroconf", raising=False)
    with pytest.raises(ValueError, match="pip install zeroconf, or give the robots' addresses"):
        Discovery(MISSION, "alice", 1, ["bob"])


@pytest.mark.parametrize(
    ("mission", "port", "message"),
    [("", 1, "mission's id"), ("x" * 65, 1, "mission's id"), ("\x1b", 1, "mission's id"), ("a", 0, "65535")],
)
def test_bad_arguments_are_refused(mission, port, message):
    with pytest.raises(ValueError, match=message):
        Discovery(mission, "alice", port, ["bob"])


def test_a_robot_that_is_not_looked_for_is_not_asked_for(start):
    one, _ = start()
    for ask in (one.address_of, lambda peer: one.failed(peer, "10.0.0.2:1")):
        with pytest.raises(ValueError, match=r"'dave' is no robot that is looked for: bob, carol"):
            ask("dave")


# --- the library, over the loopback interface


@pytest.fixture
def multicast():
    """The loopback interface, where the library can hear itself there."""
    zeroconf = pytest.importorskip("zeroconf")
    heard = threading.Event()
    try:
        with (
            zeroconf.Zeroconf(interfaces=["127.0.0.1"]) as one,
            zeroconf.Zeroconf(interfaces=["127.0.0.1"]) as two,
        ):
            service = "_spdz-test._tcp.local."
            zeroconf.ServiceBrowser(two, service, handlers=[lambda **change: heard.set()])
            info = zeroconf.ServiceInfo(service, f"x.{service}", port=1, parsed_addresses=["127.0.0.1"])
            one.register_service(info, cooperating_responders=True)
            if not heard.wait(3):
                pytest.skip("multicast does not come back on the loopback interface here")
    except OSError as error:
        pytest.skip(f"multicast is not possible here: {error}")
    return ["127.0.0.1"]


def test_two_robots_find_each_other_and_one_of_another_mission_does_not(multicast):
    told = []
    robots = [
        Discovery(MISSION, "alice", 9001, ["bob"], told.append, interfaces=multicast),
        Discovery(MISSION, "bob", 9002, ["alice"], interfaces=multicast),
        Discovery("ffff" * 8, "bob", 9003, ["alice"], interfaces=multicast),
    ]
    try:
        until(lambda: robots[0].address_of("bob") == "127.0.0.1:9002")
        until(lambda: robots[1].address_of("alice") == "127.0.0.1:9001")
        time.sleep(0.1)
        assert robots[2].address_of("alice") is None
        robots[0].failed("bob", "127.0.0.1:9002")
        assert robots[0].address_of("bob") == "127.0.0.1:9002"  # there is no other
    finally:
        for one in robots:
            one.close()
    until(lambda: "bob is announced at 127.0.0.1:9002 on the local network" in told)
