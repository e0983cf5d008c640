"""Names and addresses: every address of a name, names that are not known yet, ports that are not free yet."""

import errno
import os
import re
import socket
import threading

import pytest
from channel_helpers import LONG, SHORT, assert_alive, free_address, meet, ways

from spdz.channels import dialing, listening, tcp
from spdz.channels.addresses import NotYet, parse_address
from spdz.foundations.errors import ChannelError, ChannelTimeout

V4, V6 = "127.0.0.1", "::1"


def has_ipv6():
    try:
        with socket.create_server((V6, 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


needs_ipv6 = pytest.mark.skipif(not has_ipv6(), reason="there is no IPv6 here")


def port_of(address):
    return int(address.rpartition(":")[2])


@pytest.fixture
def names(monkeypatch):
    """Names of a test's own, by name: addresses, or an error, or a function that gives one of these."""
    known = {}
    real = socket.getaddrinfo

    def look_up(host, port, *args, **options):
        found = known.get(host)
        if found is None:
            return real(host, port, *args, **options)
        found = found() if callable(found) else found
        if isinstance(found, Exception):
            raise found
        return [entry for one in found for entry in real(one, port, *args, **options)]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    return known


@pytest.fixture
def second_loopback():
    """Another address of this machine, where the system has one."""
    try:
        socket.create_server(("127.0.0.2", 0)).close()
    except OSError:
        pytest.skip("this machine has one loopback address only")
    return "127.0.0.2"


def in_turn(*answers):
    """A function that gives these answers one after the other, the last one for ever."""
    rest = list(answers)
    return lambda: rest.pop(0) if len(rest) > 1 else rest[0]


def broken_sockets(monkeypatch, method, code, host, seen=None):
    """Let a method of every socket fail for one host; ``init`` stands for making a socket of its family."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET

    class Broken(socket.socket):
        def __init__(self, family_=-1, *args, **options):
            if method == "init" and family_ == family:
                raise OSError(code, os.strerror(code))
            super().__init__(family_, *args, **options)

        def bind(self, where):
            self._fail("bind", where)
            super().bind(where)

        def connect(self, where):
            self._fail("connect", where)
            super().connect(where)

        def _fail(self, name, where):
            if name in method.split() and where[0] == host:
                if seen is not None:
                    seen.append(where)
                raise OSError(code, os.strerror(code))

    monkeypatch.setattr(socket, "socket", Broken)


def assert_they_meet(listen_at, connect_at):
    """Listen at one name with any free port, and connect to another name with that port."""
    a, b = meet(
        lambda _, on_listening: tcp.listen(f"{listen_at}:0", wait=LONG, on_listening=on_listening),
        lambda found: tcp.connect(f"{connect_at}:{port_of(found)}", wait=LONG),
    )
    with a, b:
        assert_alive(a, b)


@pytest.mark.parametrize(
    ("address", "parts"),
    [
        ("localhost:9000", ("localhost", 9000)),
        ("10.0.0.2:1", ("10.0.0.2", 1)),
        ("[::1]:9000", ("::1", 9000)),
    ],
)
def test_addresses_are_host_and_port(address, parts):
    assert parse_address(address) == parts


@pytest.mark.parametrize(
    "address",
    ["", "host", "host:", ":9000", "host:-1", "host:65536", "host:९", "::1:9000", "[]:1", "ho\x1b[2Jst:1"],
)
def test_malformed_addresses_are_refused(address):
    for meeting in (tcp.listen, tcp.connect):
        with pytest.raises(ValueError, match=r"address|host"):
            meeting(address, wait=LONG)


# --- every address of a name


@needs_ipv6
@pytest.mark.parametrize("connect_at", [V4, "[::1]", "robot"])
def test_a_name_is_listened_on_at_all_its_addresses(names, connect_at):
    names["robot"] = [V6, V4, V4]
    assert_they_meet("robot", connect_at)


@needs_ipv6
@pytest.mark.parametrize("listen_at", [V4, "[::1]"])
def test_a_name_is_called_at_all_its_addresses(names, listen_at):
    names["robot"] = [V6, V4]
    assert_they_meet(listen_at, "robot")


@needs_ipv6
def test_the_wildcard_of_ipv6_takes_ipv4_too():
    assert_they_meet("[::]", V4)


@pytest.mark.parametrize(
    ("method", "code"), [("init", errno.EAFNOSUPPORT), ("bind connect", errno.EADDRNOTAVAIL)]
)
@pytest.mark.parametrize(("listen_at", "connect_at"), [("robot", V4), (V4, "robot"), ("robot", "robot")])
def test_addresses_that_the_machine_does_not_have_are_left_out(
    names, monkeypatch, method, code, listen_at, connect_at
):
    names["robot"] = [V6, V4]
    broken_sockets(monkeypatch, method, code, V6)
    assert_they_meet(listen_at, connect_at)


def test_a_port_that_is_taken_at_one_address_only_is_not_chosen(names, monkeypatch):
    names["robot"] = [V4, "127.0.0.2"]
    tries = []
    real = listening._bind

    def bind(target, port, alone):
        if target[1][0] == V4:
            return real(target, port, alone)
        tries.append(port)
        if len(tries) < 3:
            raise OSError(errno.EADDRINUSE, "taken")
        return real((target[0], (V4, 0)), 0, alone)

    monkeypatch.setattr(listening, "_bind", bind)
    with listening.open_listener("robot:0") as listener:
        first, second = listener.sockets
        assert tries[2] == first.getsockname()[1]
        assert listener.fileno() == max(first.fileno(), second.fileno())
    assert len(set(tries)) == 3


def test_every_address_that_is_listened_on_is_told(names, second_loopback):
    names["robot"] = [V4, second_loopback]
    told = []
    with pytest.raises(ChannelTimeout):
        tcp.listen("robot:0", wait=SHORT, on_event=told.append)
    (sentence,) = told
    assert re.fullmatch(r"listening on 127\.0\.0\.1:(\d+) and 127\.0\.0\.2:\1 for the other robot", sentence)


@pytest.mark.parametrize("code", [errno.EIO, errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL, errno.ENETUNREACH])
def test_no_bare_error_of_the_system_gets_out(monkeypatch, code):
    broken_sockets(monkeypatch, "bind connect", code, V4)
    with pytest.raises(ChannelError, match=r"cannot listen on 127\.0\.0\.1:0: "):
        tcp.listen(f"{V4}:0", wait=SHORT)
    with pytest.raises(ChannelTimeout, match=r"nobody answered at 127\.0\.0\.1:1 "):
        tcp.connect(f"{V4}:1", wait=SHORT)


# --- what is not there yet


@pytest.mark.parametrize("code", [socket.EAI_AGAIN, socket.EAI_NONAME])
def test_a_callers_name_may_become_known_later_and_may_move(names, code):
    names["robot"] = in_turn(socket.gaierror(code, "not known"), ["127.0.0.2"], [V4])
    assert_they_meet(V4, "robot")


@pytest.mark.parametrize("code", [socket.EAI_AGAIN, socket.EAI_NONAME])
def test_a_listeners_name_may_become_known_later(names, code):
    names["robot"] = in_turn(socket.gaierror(code, "not known"), [V4])
    assert_they_meet("robot", V4)


def test_a_name_that_stays_unknown_is_told(names):
    names["robot"] = socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    with pytest.raises(ChannelTimeout, match=r"robot cannot be resolved: Name or service not known"):
        tcp.connect("robot:1", wait=SHORT)
    with pytest.raises(ChannelError, match="robot cannot be resolved"):
        tcp.listen("robot:1", wait=SHORT)


def test_what_can_never_be_a_name_is_told_at_once(names):
    names["robot"] = UnicodeError("label too long")
    with pytest.raises(ChannelError, match="label too long") as caught:
        tcp.connect("robot:1", wait=LONG)
    assert not isinstance(caught.value, ChannelTimeout)


def test_a_resolver_that_hangs_does_not_extend_the_wait(names):
    over = threading.Event()
    names["robot"] = lambda: over.wait(LONG) and [V4]
    try:
        with pytest.raises(ChannelTimeout, match="the resolver does not answer"):
            tcp.connect("robot:1", wait=SHORT)
        assert not over.is_set()
    finally:
        over.set()


def test_an_address_that_swallows_packets_leaves_time_for_the_next(names, monkeypatch):
    names["robot"] = ["127.0.0.2", V4]
    asleep = []

    class Swallowing(socket.socket):
        def connect(self, where):
            if where[0] == "127.0.0.2":
                asleep.append(self.gettimeout())
                raise TimeoutError("timed out")
            super().connect(where)

    monkeypatch.setattr(socket, "socket", Swallowing)
    a, b = meet(
        lambda _, on_listening: tcp.listen(f"{V4}:0", wait=LONG, on_listening=on_listening),
        lambda found: tcp.connect(f"robot:{port_of(found)}", wait=4.0),
    )
    with a, b:
        assert_alive(a, b)
    assert max(asleep) <= 2.0


@pytest.fixture
def silent_port(second_loopback):
    """A port of the second loopback address where connections are taken and nothing is ever said."""
    with socket.create_server((second_loopback, 0)) as listener:
        yield listener.getsockname()[1]


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_an_address_that_takes_the_call_and_stalls_leaves_time_for_the_next(
    folders, names, silent_port, kind
):
    names["robot"] = ["127.0.0.2", V4]
    listen, connect = ways(kind, folders)
    a, b = meet(
        lambda _, on_listening: listen(f"{V4}:{silent_port}", wait=LONG, on_listening=on_listening),
        lambda _: connect(f"robot:{silent_port}", wait=LONG, timeout=2 * SHORT),
    )
    with a, b:
        assert_alive(a, b)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_an_address_that_took_a_call_and_stalled_is_called_again(folders, names, silent_port, kind):
    names["robot"] = in_turn(["127.0.0.2"], [V4])
    listen, connect = ways(kind, folders)
    told = []
    a, b = meet(
        lambda _, on_listening: listen(f"{V4}:{silent_port}", wait=LONG, on_listening=on_listening),
        lambda _: connect(f"robot:{silent_port}", wait=LONG, timeout=2 * SHORT, on_event=told.append),
    )
    with a, b:
        assert_alive(a, b)
    assert len(told) == 1
    assert told[0].startswith(f"nobody answers at robot:{silent_port} yet (")
    assert "was not finished within 0.5 s" in told[0]


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_stall_that_lasts_is_a_timeout_that_says_so(folders, silent_port, kind):
    _, connect = ways(kind, folders)
    with pytest.raises(
        ChannelTimeout, match=r"the (TLS handshake|greeting of plain TCP) was not finished within"
    ):
        connect(f"127.0.0.2:{silent_port}", wait=3 * SHORT, timeout=SHORT)


@pytest.mark.parametrize(
    ("left", "timeout", "shares"),
    [(60.0, 30.0, [20.0, 29.0, 30.0]), (1.0, 30.0, [5.0, 5.0, 30.0]), (60.0, 2.0, [2.0, 2.0, 2.0])],
)
def test_a_handshake_leaves_time_for_the_addresses_behind_it(monkeypatch, left, timeout, shares):
    seen, now = [], [0.0]
    monkeypatch.setattr(dialing, "_connect", lambda target, seconds: None)
    monkeypatch.setattr(dialing.time, "monotonic", lambda: now[0])

    def stall(sock, seconds):
        seen.append(seconds)
        now[0] += 2.0
        raise ChannelTimeout("stalled")

    with pytest.raises(NotYet, match="stalled"):
        dialing._try_each([None] * 3, left, timeout, stall)
    assert seen == shares


@pytest.mark.parametrize("code", [errno.EADDRINUSE, errno.EADDRNOTAVAIL])
def test_an_address_may_become_free_later(monkeypatch, code):
    fails = [code] * 2
    real = listening._bind

    def bind(*args, **options):
        if fails:
            raise OSError(fails.pop(), "not yet")
        return real(*args, **options)

    monkeypatch.setattr(listening, "_bind", bind)
    assert_they_meet(V4, V4)
    assert not fails


def test_an_address_in_use_is_told():
    with (
        socket.create_server((V4, 0)) as taken,
        pytest.raises(ChannelError, match=r"cannot listen on .* in use"),
    ):
        tcp.listen(f"{V4}:{taken.getsockname()[1]}", wait=SHORT)


def test_a_port_that_is_not_allowed_is_told_at_once(monkeypatch):
    seen = []
    broken_sockets(monkeypatch, "bind", errno.EACCES, V4, seen)
    with pytest.raises(ChannelError, match="ermission denied"):
        tcp.listen(f"{V4}:1", wait=LONG)
    assert len(seen) == 1


def test_nobody_there_is_a_timeout():
    with pytest.raises(ChannelTimeout, match=r"nobody answered .* is the other robot listening"):
        tcp.connect(free_address(), wait=SHORT)
    with pytest.raises(
        ChannelTimeout, match=r"the other robot did not connect .*is it started with connect="
    ):
        tcp.listen("127.0.0.1:0", wait=SHORT)
